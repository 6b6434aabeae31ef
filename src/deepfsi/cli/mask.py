"""Command of a static pattern: the file that a photomask is made of."""

from pathlib import Path
from typing import Annotated

import typer

from deepfsi.cli import common, options, paths


def mask(
    file: Annotated[Path, typer.Argument(help="design file of scenes that pass a pattern")],
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="photomask: .svg (polygons, binary patterns) or .png"),
    ],
    pixel: Annotated[
        float, typer.Option(help="side of a pixel on the mask, micrometres: that of a scene there")
    ],
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Write the static pattern that scenes pass for a photomask, with its scale.

    In an .svg, polygons mark what is open, in micrometres; a .png has a dot for each pixel. Learn
    the design with --levels 2 for a binary pattern.

    Example: deepfsi mask passing.safetensors --pixel 5 -o pattern.svg
    """
    from deepfsi.hardware.patterns import write_photomask

    file = paths.check_design(file)
    paths.check_file(out, (".svg", ".png"), force)
    pattern = write_photomask(file, out, pixel)
    rows, columns = pattern.shape
    open_share = float(pattern.mean())
    if as_json:
        size = [rows * pixel, columns * pixel]
        said = {"design": str(file), "mask": str(out), "pixels": [rows, columns]}
        common.print_json("mask", {**said, "pixel_um": pixel, "um": size, "open": open_share})
        return
    print(
        f"{rows} x {columns} pixels of {pixel:g} µm, {rows * pixel:g} x {columns * pixel:g} µm in "
        f"all, {open_share:.1%} open\nphotomask: {out}"
    )

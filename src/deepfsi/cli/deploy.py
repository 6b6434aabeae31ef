"""Commands that take a design to its camera: export."""

from pathlib import Path
from typing import Annotated

import typer

from deepfsi.cli.common import check_writable
from deepfsi.errors import InputError


def export(
    file: Annotated[
        Path, typer.Argument(help="design file, or a folder of patterns that `dmd export` wrote")
    ],
    onnx: Annotated[bool, typer.Option("--onnx", help="as an ONNX graph")] = False,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="the design's name with .onnx unless given")
    ] = None,
) -> None:
    """Write the classifier of a design as a file that runs without this package.

    Counts and budget in, class probabilities out; all scaling is inside. `dmd export` writes the
    masks.

    Example: deepfsi export digits.safetensors --onnx -o digits.onnx
    """
    from deepfsi.artifact import Design
    from deepfsi.export import to_onnx
    from deepfsi.files import write_atomically

    if not onnx:
        raise InputError("a design can be exported as an ONNX graph: add --onnx")
    target = out or file.with_suffix(".onnx")
    if target.is_dir():
        raise InputError(f"{target} is a folder: give a file name ending in .onnx")
    check_writable(target.parent)
    if file.is_dir():
        from deepfsi.hardware.dmd import check_patterns

        design = Design.load(file / "design.safetensors").as_shown(check_patterns(file))
    else:
        design = Design.load(file)
    write_atomically(target, to_onnx(design))
    shape = f"(batch, 2, {design.masks})" if len(design.rails) == 2 else f"(batch, {design.masks})"
    print(
        f"in: counts {shape}, photons (batch,)\n"
        f"out: probabilities (batch, {len(design.classes)})\nsaved: {target}"
    )

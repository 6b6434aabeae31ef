"""Image scans of a microscope: photons of lines and pixels from a photon file with markers."""

import io
from pathlib import Path
from typing import Annotated

import typer

from deepfsi.base import InputError
from deepfsi.cli import common, options, paths

MARKER = "marker input, 0 to 3; that of the header unless given"


def camera_scan(
    file: Annotated[Path, typer.Argument(help="PicoQuant .ptu file of an image scan")],
    out: Annotated[Path, typer.Option("--out", "-o", help="counts of the lines, .npz")],
    pixels: Annotated[int, typer.Option(min=1, help="equal pixels of a line")] = 1,
    inputs: options.Inputs = None,
    line_start: Annotated[
        int | None, typer.Option(min=0, max=3, help=f"start of a line: {MARKER}")
    ] = None,
    line_end: Annotated[
        int | None, typer.Option(min=0, max=3, help=f"end of a line: {MARKER}")
    ] = None,
    frame: Annotated[
        int | None, typer.Option(min=0, max=3, help=f"start or end of a frame: {MARKER}")
    ] = None,
    figure: Annotated[Path | None, typer.Option(help="picture of the frames, .png")] = None,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Count the photons of an image scan between its markers, in lines or pixels.

    Lines that lack a marker are left out and named, as are frames of an unusual number of lines.

    Example: deepfsi camera scan leaf.ptu --pixels 256 -o leaf.npz --figure leaf.png
    """
    paths.check_file(out, (".npz",), force)
    if figure is not None:
        paths.check_file(figure, paths.PICTURES, force)
    import numpy as np

    from deepfsi.base import write_atomically
    from deepfsi.hardware.photons import ScanMarkers, count_scan

    if figure is not None and pixels == 1:
        raise InputError("a picture needs pixels: give --pixels, 2 or more, or leave --figure out")
    numbers = [each - 1 for each in inputs or (1,)]
    markers = ScanMarkers(line_start, line_end, frame)
    with common.progress("lines", quiet=as_json) as report:
        found = count_scan(file, markers, pixels, numbers, report)
    content = io.BytesIO()
    np.savez_compressed(
        content,
        counts=found.counts,
        frame=found.frame,
        starts_s=found.starts_s,
        ends_s=found.ends_s,
    )
    write_atomically(out, content.getvalue())
    if figure is not None:
        from deepfsi.report import pictures_figure

        names = [f"frame {number + 1}" for number in range(len(found.frames))]
        common.save_figure(pictures_figure(found.frames, names), figure)
    sizes = np.bincount(found.frame).tolist()
    summary = {
        "counts": str(out),
        "photons": int(found.counts.sum()),
        "lines": len(found.frame),
        "frames": len(sizes),
        "pixels": pixels,
        "lines_of_frames": sizes,
        "faults": list(found.faults),
    }
    if as_json:
        common.print_json("camera.scan", summary)
        return
    for fault in found.faults:
        print(fault)
    print(
        f"{common.several(summary['frames'], 'frame')}, "
        f"{common.several(summary['lines'], 'line')} of {common.several(pixels, 'pixel')}\n"
        f"{summary['photons']} photons between the markers of lines\ncounts: {out}"
    )
    if figure is not None:
        print(f"drawn: {figure}")

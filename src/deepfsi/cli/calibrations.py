"""Calibration of a camera: pictures of spots to show, and the fit to what it saw of them."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from deepfsi.cli import common, options, paths


def camera_spots(
    out: Annotated[Path, typer.Option("--out", "-o", help="folder for the pictures, new")],
    size: Annotated[str, typer.Option(help="pixels of the display, HEIGHTxWIDTH")] = "32x32",
    side: Annotated[int, typer.Option(min=1, help="pixels of a spot; larger is brighter")] = 2,
    as_json: options.Json = False,
) -> None:
    """Write the pictures that calibrate a camera: bright spots, all white, all black.

    Show them to the camera with the patterns of `deepfsi dmd export hadamard`, count, and give the
    run to `deepfsi camera calibrate`.

    Example: deepfsi camera spots --size 32x32 -o spots
    """
    paths.check_new_folder(out)
    from deepfsi.laboratory.calibration import write_spots

    pictures = write_spots(out, options.size_of(size) or (32, 32), side)
    common.print_pictures("camera.spots", pictures, out, as_json)


def camera_calibrate(
    folder: options.Run,
    spots: Annotated[Path, typer.Option(help="the pictures that were shown")],
    out: Annotated[Path, typer.Option("--out", "-o", help="folder for calibration.json")],
    as_json: options.Json = False,
) -> None:
    """Fit the camera's view to a run of the spots: position, blur, flat field, dark counts.

    `deepfsi design --view` then trains on what the camera sees. Of several detectors, the cells
    that each sees are written to detectors.npy, for `deepfsi design --detectors`.

    Example: deepfsi camera calibrate run_spots --spots spots -o calibration
    """
    paths.check_folder(out)
    from deepfsi.laboratory.calibration import calibrate

    found, path, where = calibrate(folder, spots, out)
    if as_json:
        about = found.model_dump(mode="json", exclude={"flat"})
        common.print_json(
            "camera.calibrate",
            {
                "calibration": str(path),
                **about,
                "detectors": where and str(where),
                "warnings": found.doubts,
            },
        )
        return
    print(
        f"{found.spots} of {found.shown} spots, {found.residual:.2f} cells from the fit (rms); the "
        f"view is known to {found.error:.2f} cells at the display's corners\n"
        f"dark {found.dark:.4g} counts/s, ambient {found.ambient:.4g} counts/s\ncalibration: {path}"
    )
    if where is not None:
        print(f"cells of each detector: {where}")
    for doubt in found.doubts:
        print(f"deepfsi: warning: {doubt}", file=sys.stderr)

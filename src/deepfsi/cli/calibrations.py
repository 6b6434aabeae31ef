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
    from deepfsi.hardware.calibration import write_spots

    pictures = write_spots(out, options.size_of(size) or (32, 32), side)
    common.print_pictures("camera.spots", pictures, out, as_json)


def camera_calibrate(
    folder: options.Run,
    spots: Annotated[Path, typer.Option(help="the pictures that were shown")],
    out: Annotated[Path, typer.Option("--out", "-o", help="folder for calibration.json")],
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Fit the camera's view to a run of the spots: position, blur, flat field, dark counts.

    `deepfsi design --view` then trains on what the camera sees. Of several detectors, the cells
    that each sees are written to detectors.npy, for `deepfsi design --detectors`.

    Example: deepfsi camera calibrate run_spots --spots spots -o calibration
    """
    paths.check_folder(out)
    paths.check_free(out / "calibration.json", force)
    from deepfsi.lab import calibrate

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


def camera_check(
    folder: options.Run,
    keep: Annotated[
        Path | None,
        typer.Option(
            help="acquisition folder of scenes with the same patterns, with which what is found "
            "is kept: `camera classify` then refuses the run if the reference did not fit"
        ),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Say how scenes lie on the device, from a run of the reference target: before data are taken.

    Put reference.png of the folder of patterns in the place of the scenes, alone and on black,
    record a pass and count it; a design that looks several times shows it with `camera live`. If
    orientation, scale, shift or rotation differ from those of the masks, the target is blurred, or
    the counts do not show them, the exit code is 1.

    Example: deepfsi camera check run_reference
    """
    paths.check_there(folder, "an acquisition folder, with photons.ptu in it")
    from deepfsi.hardware.counting import ReferenceVerdict
    from deepfsi.lab import check_view

    with common.progress("reference", quiet=as_json) as report:
        found = check_view(folder, report)
    if keep is not None:
        ReferenceVerdict(reference=str(folder), fits=found.fits, reasons=found.reasons).keep(keep)
    if as_json:
        common.print_json(
            "camera.check",
            {
                "fits": found.fits,
                "doubt": found.doubt,
                "orientation": {
                    name: {"flip": each.flip, "rotate": each.rotate}
                    for name, each in (("exported", found.exported), ("found", found.layout))
                },
                "scale": found.scale,
                "shift": list(found.shift),
                "rotation": found.rotation,
                "blur": found.blur,
                "blur_error": found.blur_error,
                "errors": list(found.errors),
            },
        )
    else:
        for what, words, departs in found.findings:
            print(f"{what}: {words}{': too far' if departs and what != 'orientation' else ''}")
        fits = "the scenes lie as the masks do" if found.fits else "the scenes do not fit the masks"
        print(found.doubt or fits)
    if not found.fits:
        raise typer.Exit(1)

"""Commands of a camera, of the patterns on its device, and of scenes to show to it."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from deepfsi.base.errors import InputError
from deepfsi.base.files import new_folder
from deepfsi.base.models import Count, Seconds, WholeNumber
from deepfsi.camera.camera import PRESETS, Camera
from deepfsi.camera.device import find_device
from deepfsi.camera.layout import DmdLayout
from deepfsi.cli import fields
from deepfsi.cli.command import Command
from deepfsi.cli.terminal import Outcome, Terminal
from deepfsi.counting.recording import Recording
from deepfsi.datasets.display import read_display, write_display
from deepfsi.datasets.load import load_dataset
from deepfsi.designfile.design_file import find_design
from deepfsi.lab.calibration import SCAN_NAMES, calibrate, scan_rails, write_spots
from deepfsi.lab.design_data import camera_of, design_rails
from deepfsi.lab.registration import check_view, write_reference
from deepfsi.patterns.folder import Patterns


class DescribeCamera(Command):
    """Without a camera it is the preset dmd, one micromirror device with one detector.

    Example: deepfsi camera describe my-lab.toml
    """

    source: str = fields.argument(
        "camera: a preset (dmd, dmd-2x2, dmd-4x4, two-arm, paper), a TOML file, a design file, or "
        "a folder of patterns or of a run; default: dmd",
        "[source]",
        default="dmd",
    )

    def run(self, terminal: Terminal) -> Outcome:
        name = self.source
        if name in PRESETS or name.lower().endswith(".toml") or not Path(name).exists():
            camera = Camera.load(name)
        else:
            camera = camera_of(Path(name))
        return Outcome(
            {
                "camera": camera.model_dump(mode="json"),
                "budget": camera.budget,
                "dark_counts": camera.dark_counts,
                "shortest_share": camera.shortest_share,
            },
            [camera.describe()],
        )


class CalibrateCamera(Command):
    """For `deepfsi design --view`, which then trains on what the camera sees.

    Example: deepfsi camera calibrate run_spots --spots scan/spots -o calibration
    """

    folder: fields.RunFolder
    spots: Path = fields.option("pictures that were shown: spots, in the folder of the scan", ...)
    out: Annotated[Path, fields.Output()] = fields.option("folder for calibration.json", ...)
    force: fields.Force = False

    def run(self, terminal: Terminal) -> Outcome:
        fields.Output((".json",)).check(self.out / "calibration.json", self.force)
        run = Recording.read(self.folder)
        shown = read_display(self.spots)
        calibration = calibrate(shown, run, run.read_counts().check_photons(self.folder))
        file = calibration.save(self.out)
        return Outcome(
            {
                "calibration": str(file),
                **calibration.model_dump(mode="json", exclude={"flat"}),
                "warnings": calibration.doubts,
            },
            [
                *(f"warning: {doubt}" for doubt in calibration.doubts),
                *calibration.lines(),
                f"calibration: {file}",
            ],
        )


class CheckView(Command):
    """The exit code is 1 where the target is turned, shifted, scaled, blurred or not seen.

    Put reference.png of the folder of patterns in the place of the scenes, alone and on black,
    record a pass and count it; for adaptive masks, with patterns of `deepfsi dmd export hadamard`.

    Example: deepfsi camera check run_reference
    """

    folder: fields.RunFolder

    def run(self, terminal: Terminal) -> Outcome:
        with terminal.progress("reference") as report:
            fit = check_view(self.folder, report)
        return Outcome(fit.as_dict(), fit.lines(), failed=not fit.fits)


# patterns of a micromirror device


class ExportPatterns(Command):
    """Without options, the design's camera gives device, region and exposure; else it is a DLP7000.

    Give the --flip and --rotate that `camera check` names. A calibration needs no design: deepfsi
    dmd export hadamard --size 32x32 -o scan. Its folder spots has the pictures to show.

    Example: deepfsi dmd export one-dmd.safetensors --dmd dlp7000 --exposure 10ms -o patterns
    """

    file: Path = fields.argument("design file; or raster or hadamard, to calibrate with")
    settings: Annotated[
        dict[str, Any], fields.camera_options("camera", "exposure", "region", "stretch")
    ]
    dmd: str | None = fields.option(str(Camera.model_fields["device"].description))
    out: fields.NewFolder = fields.option("folder for the patterns, new", ...)
    size: fields.HeightWidth | None = fields.option("cells of raster or hadamard; default: 32x32")
    detectors: Annotated[int, Field(ge=1, le=64)] | None = fields.option(
        "number of detectors during raster or hadamard; default: 1"
    )
    dwell: Seconds | None = fields.option(
        "mean picture time, settling included, such as 44us; default: by the exposure, or 1ms"
    )
    flip: bool = fields.option("exchange left and right of the masks, before --rotate", False)
    rotate: int = fields.option("turn the masks, degrees clockwise: 0, 90, 180, 270", 0)
    invert: bool = fields.option("write 0 for a mirror that sends light to the detector", False)
    kind: str | None = fields.option(
        "npy, raw (packed bits), bmp, or planes (24 frames a picture); default: the device's",
        alias="format",
    )

    def run(self, terminal: Terminal) -> Outcome:
        if str(self.file) in SCAN_NAMES:
            source = self.file
            rails = scan_rails(str(source), self.size or (32, 32), self.detectors or 1)
        else:
            source = find_design(self.file)
            if self.size or self.detectors:
                raise InputError(
                    f"--size and --detectors are for {' and '.join(SCAN_NAMES)}: {source} has its "
                    "cells and detectors; leave them out"
                )
            rails = design_rails(source)
        told = {} if self.dmd is None else {"device": self.dmd}
        camera = camera_of(source, self.settings | told)
        device = camera.device or find_device("dlp7000")
        turned = self.model_dump(include={"flip", "rotate", "invert"})
        layout = DmdLayout.model_validate(camera.layout.model_dump() | turned)
        dwell = rails.picture_s(device, camera.exposure) if self.dwell is None else self.dwell
        planned = Patterns.from_rails(
            rails,
            device,
            dwell,
            format=self.kind or ("planes" if device.packed else "npy"),  # type: ignore[arg-type]
            layout=layout,
        )
        with new_folder(self.out) as draft, terminal.progress("patterns") as report:
            patterns = planned.fill(draft, report)
            write_reference(patterns.manifest, draft)
            if str(source) in SCAN_NAMES:
                write_spots(draft / "spots")
        return _patterns_in(self.out, patterns)


class CheckPatterns(Command):
    """A frame that is missing or not as it was written is named, and the exit code is 2.

    Example: deepfsi dmd check patterns
    """

    folder: fields.PatternFolder

    def run(self, terminal: Terminal) -> Outcome:
        with terminal.progress("frames") as report:
            patterns = Patterns.read(self.folder).check(report)
        return _patterns_in(self.folder, patterns)


def _patterns_in(folder: Path, patterns: Patterns) -> Outcome:
    content = {"patterns": str(folder), **patterns.as_dict()}
    return Outcome(content, [*patterns.lines(), f"patterns: {folder}"])


# scenes


class DataExport(Command):
    """They are drawn at random from each class.

    Example: deepfsi data export mnist --per-class 2 -o images
    """

    name: str = fields.argument("name of a data set, folder of images or .npz file")
    out: fields.NewFolder = fields.option("folder for the pictures, new", ...)
    per_class: Count = fields.option("test scenes of each class", 1)
    seed: WholeNumber = fields.option("seed of their choice", 0)
    size: fields.Size = None

    def run(self, terminal: Terminal) -> Outcome:
        scenes = load_dataset(self.name, size=self.size)
        written = write_display(scenes, self.out, self.per_class, self.seed)
        return Outcome({"folder": str(self.out), "pictures": [str(path) for path in written]})

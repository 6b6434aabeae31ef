"""Commands of the micromirror device: patterns written and checked, and the devices by name."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.models.strict import WholeNumber
from deepfsi.camera.device import find_device
from deepfsi.camera.layout import DmdLayout
from deepfsi.cli import fields
from deepfsi.cli.command import Command
from deepfsi.cli.terminal import Outcome, Terminal

if TYPE_CHECKING:
    from deepfsi.hardware.patterns.folder import Patterns


class ExportPatterns(Command):
    """`deepfsi dmd export`.

    Device, region and exposure are those of the design's camera unless given; a DLP7000 where it
    has none. Cells are square. Where `camera check` finds that your camera shows scenes turned or
    flipped, export again with the --flip and --rotate that it names.

    A calibration needs no design: deepfsi dmd export hadamard --size 32x32 -o scan

    Example: deepfsi dmd export one-dmd.safetensors --device dlp7000 --exposure 10ms -o patterns
    """

    file: Path = fields.argument("design file; or raster or hadamard, to calibrate with")
    settings: Annotated[
        dict[str, Any], fields.run_options("device", "exposure", "region", "stretch")
    ]
    out: Annotated[Path, fields.Output(new=True)] = fields.required("folder for the patterns, new")
    size: fields.HeightWidth | None = fields.option(
        "cells of raster or hadamard, HEIGHTxWIDTH; 32x32 unless given"
    )
    detectors: Annotated[int, Field(ge=1, le=64)] | None = fields.option(
        "number of detectors during raster or hadamard, so that `camera calibrate` finds the cells "
        "of each; 1 unless given"
    )
    shortest: fields.Time | None = fields.option(
        "shortest picture time of the device; its own unless given"
    )
    settle: fields.Time | None = fields.option(
        "time for its mirrors to settle; its own unless given"
    )
    dwell: fields.Time | None = fields.hidden(
        "mean picture time of a frame, settling included, such as 1ms or 44us; what the camera's "
        "exposure takes unless given, or 1ms"
    )
    selection: str = fields.option(
        "mirrors of a grey cell: ordered (low discrepancy) or random", "ordered"
    )
    seed: WholeNumber = fields.option("seed of a random selection", 0)
    flip: bool = fields.flag("exchange left and right of the masks, before --rotate")
    rotate: int = fields.option(
        "turn the masks on the device, degrees clockwise: 0, 90, 180, 270", 0
    )
    invert: bool = fields.flag(
        "write 0 for a mirror that sends light to the detector, and 1 for OFF"
    )
    kind: str | None = fields.option(
        "npy or raw (packed bits), png or bmp (one a frame), or planes (24 frames a picture); what "
        "the device takes unless given",
        alias="format",
    )

    def run(self, terminal: Terminal) -> Outcome:
        """Patterns that were written, on which device and for how long."""
        from deepfsi.hardware.calibration.reference import write_reference
        from deepfsi.hardware.calibration.scans import SCAN_NAMES, scan_rails
        from deepfsi.hardware.patterns.folder import FrameSettings, export_patterns
        from deepfsi.lab.setup import camera_of, design_rails

        if str(self.file) in SCAN_NAMES:
            source = self.file
            rails = scan_rails(str(source), self.size or (32, 32), self.detectors or 1)
        else:
            source = fields.check_design_file(self.file)
            self._check_of_design()
            rails = design_rails(source)
        camera = camera_of(source, self.settings)
        device = (camera.device or find_device("dlp7000")).timed(self.shortest, self.settle)
        with as_input_error():
            turned = self.model_dump(include={"flip", "rotate", "invert"})
            layout = DmdLayout.model_validate(camera.layout.model_dump() | turned)
        dwell = rails.picture_s(device, camera.exposure) if self.dwell is None else self.dwell
        frames = FrameSettings(
            device=device,
            dwell_s=dwell,
            selection=self.selection,  # type: ignore[arg-type]
            seed=self.seed,
            format=self.kind or ("planes" if device.packed else "npy"),  # type: ignore[arg-type]
            layout=layout,
        )
        with terminal.progress("patterns") as report:
            patterns = export_patterns(rails, frames, self.out, report)
        write_reference(patterns, self.out)
        raised = (
            f"the mean picture time was raised to {device.shortest_us} µs: {device.name} shows no "
            "shorter picture (`shortest`)"
        )
        return _patterns_in(self.out, patterns, [raised] * frames.raised)

    def _check_of_design(self) -> None:
        """Raise `InputError` for options of a scan, which a design decides."""
        from deepfsi.hardware.calibration.scans import SCAN_NAMES

        for option, words in (("size", "cells"), ("detectors", "detectors")):
            if getattr(self, option) is not None:
                raise InputError(
                    f"--{option} is for {' and '.join(SCAN_NAMES)}: {self.file} has the {words} of "
                    "its design; leave it out"
                )


class CheckPatterns(Command):
    """`deepfsi dmd check`.

    Example: deepfsi dmd check patterns
    """

    folder: fields.PatternFolder

    def run(self, terminal: Terminal) -> Outcome:
        """Patterns of the folder, all of whose frames are as they were exported."""
        from deepfsi.hardware.patterns.folder import check_patterns

        with terminal.progress("frames") as report:
            patterns = check_patterns(self.folder, report)
        return _patterns_in(self.folder, patterns)


def _patterns_in(folder: Path, patterns: "Patterns", remarks: list[str] | None = None) -> Outcome:
    """Patterns of a folder, after remarks on their export."""
    return Outcome(
        {"patterns": str(folder), **patterns.as_dict()},
        [*(remarks or []), *patterns.lines(), f"patterns: {folder}"],
    )

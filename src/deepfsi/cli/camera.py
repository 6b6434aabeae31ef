"""Commands that describe a camera, and that calibrate a real one."""

from pathlib import Path
from typing import Annotated

from deepfsi.base.files import write_atomically
from deepfsi.base.models.strict import Count
from deepfsi.camera.camera import PRESETS, Camera
from deepfsi.cli import fields
from deepfsi.cli.command import Command
from deepfsi.cli.data import pictures_written
from deepfsi.cli.terminal import Outcome, Terminal


class DescribeCamera(Command):
    """`deepfsi camera describe`.

    Example: deepfsi camera describe --template my-lab.toml
    """

    source: Path | None = fields.argument(
        "camera: a preset (dmd, dmd-2x2, dmd-4x4, two-arm, paper), a TOML file, a design file, or "
        "a folder of patterns or of a run; dmd unless given",
        "[source]",
        default=None,
    )
    template: Annotated[Path | None, fields.Output((".toml",))] = fields.option(
        "write a camera file, .toml, with a comment on each field"
    )
    force: fields.Force = False

    def run(self, terminal: Terminal) -> Outcome:
        """The camera, or a file to describe one in."""
        from deepfsi.lab.setup import camera_of

        if self.template is not None:
            write_atomically(self.template, Camera.template().encode())
            return Outcome(
                {"template": str(self.template)},
                [f"camera file: {self.template}; then: deepfsi camera describe {self.template}"],
            )
        name = "dmd" if self.source is None else str(self.source)
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


class WriteSpots(Command):
    """`deepfsi camera spots`.

    Show them to the camera with the patterns of `deepfsi dmd export hadamard`, count, and give the
    run to `deepfsi camera calibrate`.

    Example: deepfsi camera spots --size 32x32 -o spots
    """

    out: Annotated[Path, fields.Output(new=True)] = fields.required("folder for the pictures, new")
    size: fields.HeightWidth = fields.option("pixels of the display, HEIGHTxWIDTH", (32, 32))
    side: Count = fields.option("pixels of a spot; larger is brighter", 2)

    def run(self, terminal: Terminal) -> Outcome:
        """Pictures that were written."""
        from deepfsi.hardware.calibration.fit import write_spots

        return pictures_written(write_spots(self.out, self.size, self.side), self.out)


class CalibrateCamera(Command):
    """`deepfsi camera calibrate`.

    `deepfsi design --view` then trains on what the camera sees. Of several detectors, the cells
    that each sees are written to detectors.npy, for `deepfsi design --detectors`.

    Example: deepfsi camera calibrate run_spots --spots spots -o calibration
    """

    folder: fields.RunFolder
    spots: Path = fields.required("the pictures that were shown")
    out: Annotated[Path, fields.Output()] = fields.required("folder for calibration.json")
    force: fields.Force = False

    def run(self, terminal: Terminal) -> Outcome:
        """View of the camera, in its file."""
        from deepfsi.lab.setup import calibrate

        fields.check_free(self.out / "calibration.json", self.force)
        calibration, file, detectors = calibrate(self.folder, self.spots, self.out)
        if not terminal.as_json:
            for doubt in calibration.doubts:
                terminal.warn(f"deepfsi: warning: {doubt}")
        cells = [] if detectors is None else [f"cells of each detector: {detectors}"]
        return Outcome(
            {
                "calibration": str(file),
                **calibration.model_dump(mode="json", exclude={"flat"}),
                "detectors": detectors and str(detectors),
                "warnings": calibration.doubts,
            },
            [*calibration.lines(), f"calibration: {file}", *cells],
        )


class CheckView(Command):
    """`deepfsi camera check`.

    Put reference.png of the folder of patterns in the place of the scenes, alone and on black,
    record a pass and count it; a design of adaptive masks shows it with `camera live`. If
    orientation, scale, shift or rotation differ from those of the masks, the target is blurred, or
    the counts do not show them, the exit code is 1.

    Example: deepfsi camera check run_reference
    """

    folder: fields.RunFolder
    keep: Path | None = fields.option(
        "acquisition folder of scenes with the same patterns, with which what is found is kept: "
        "`camera classify` then refuses the run if the reference did not fit"
    )

    def run(self, terminal: Terminal) -> Outcome:
        """Place of the scenes on the device."""
        from deepfsi.lab.setup import check_view

        with terminal.progress("reference") as report:
            fit = check_view(self.folder, report)
        if self.keep is not None:
            fit.verdict(self.folder).keep(self.keep)
        return Outcome(fit.as_dict(), fit.lines(), failed=not fit.fits)

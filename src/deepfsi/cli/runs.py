"""Commands that read what was recorded: photon files, runs and tables of counts."""

from pathlib import Path

from deepfsi.base.errors import InputError
from deepfsi.base.models import Seconds
from deepfsi.cli import fields
from deepfsi.cli.command import Command
from deepfsi.cli.terminal import Outcome, Terminal
from deepfsi.counting.reader import summarise
from deepfsi.counting.recording import Recording
from deepfsi.counting.tables import TableSettings
from deepfsi.lab.calibration import find_gains
from deepfsi.lab.classify import classify_run, classify_table
from deepfsi.lab.design_data import camera_of


class InspectPhotons(Command):
    """A file that is cut or damaged is described as far as it goes, and the exit code is 2.

    Example: deepfsi camera inspect photons.ptu
    """

    file: Path = fields.argument("PicoQuant .ptu file")

    def run(self, terminal: Terminal) -> Outcome:
        with terminal.progress("records") as report:
            contents = summarise(self.file, report)
        problems = "; ".join(contents.problems)
        return Outcome(
            contents.model_dump(),
            [contents.table(str(self.file))],
            refusal=f"{self.file} is not whole: {problems}" if problems else "",
        )


class CountRun(Command):
    """Unless given, the dead time is that of the folder's calibration or of the design's camera.

    A shorter exposure is counted in more gates. For a design of detectors that click, only the
    first photon of each gate counts.

    Example: deepfsi camera count run_0001 --exposure 1ms
    """

    folder: fields.RunFolder
    settings: fields.DeadTimes
    exposure_s: Seconds | None = fields.option(
        "total exposure, such as 10ms; default: the recorded one", alias="exposure"
    )
    flat: Path | None = fields.option(
        "counted run of uniform white with these patterns: corrects efficiencies of detectors"
    )

    def run(self, terminal: Terminal) -> Outcome:
        with terminal.progress("counting") as report:
            dead_time = camera_of(self.folder, self.settings).counter_dead_time
            recording = Recording.read(self.folder)
            counts = recording.count(
                exposure_s=self.exposure_s,
                dead_time=dead_time,
                gains=() if self.flat is None else find_gains(self.flat),
                click_gates=camera_of(self.folder).clicks,
                progress=report,
            )
        return Outcome(recording.as_dict(counts), recording.lines(counts))


class ClassifyRun(Command):
    """Runs whose counts are unlike the training's are refused; single scenes are named.

    A table has a value for each frame, in the order of the patterns.

    Example: deepfsi camera classify one-dmd.safetensors run_0001
    """

    settings: fields.DeadTimes
    file: fields.DesignPath = fields.argument("design that was shown, or folder of its patterns")
    counted: Path = fields.argument(
        "counted run; or counts, a row for each exposure, .csv .parquet .npy .mat (FILE:VARIABLE)",
        "RUN|TABLE",
    )
    photons: float | None = fields.option(
        "counts of an exposure, detector efficiency included; default: by the all-ON frames"
    )
    background: float | None = fields.option(
        "table: dark counts of an input in an exposure; default: by the all-OFF frames"
    )
    settle_s: Seconds | None = fields.option(
        "table: time after each marker without counting; default: 0", alias="settle"
    )
    gain: float | None = fields.option("analogue table: counts that one unit stands for")
    read_noise: float | None = fields.option("analogue table: read noise of a value, counts rms")
    trust: fields.Trust = False
    force: bool = fields.option("classify counts that do not look like the training's", False)

    def run(self, terminal: Terminal) -> Outcome:
        of_tables = ("background", "settle_s", "gain", "read_noise")
        if self.counted.is_dir():
            for name in (*self.explicit(of_tables), *self.settings):
                raise InputError(
                    f"`{name.removesuffix('_s')}` is for tables, and {self.counted} is a folder: "
                    "leave it out"
                )
            answers = classify_run(
                self.file, self.counted, photons=self.photons, force=self.force, trust=self.trust
            )
            return Outcome(answers.as_dict(), answers.lines())
        table = classify_table(
            self.file,
            self.counted,
            TableSettings(**self.explicit(("photons", *of_tables))),
            camera=self.settings,
            force=self.force,
            trust=self.trust,
        )
        return Outcome(table.as_dict(), table.lines())

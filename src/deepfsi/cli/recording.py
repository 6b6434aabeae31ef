"""Commands that record a run, with a virtual camera or with devices, or import what others did."""

from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, ClassVar

from deepfsi.base.errors import InputError, check_choice
from deepfsi.base.models import Seconds, WholeNumber
from deepfsi.base.progress import SILENT
from deepfsi.base.registry import installed
from deepfsi.camera.camera import Camera
from deepfsi.cli import fields
from deepfsi.cli.command import Command
from deepfsi.cli.terminal import Outcome, Terminal, option_name
from deepfsi.counting.acquisition import Acquisition
from deepfsi.counting.events import read_events, write_ptu
from deepfsi.counting.flux import name_inputs
from deepfsi.counting.reader import summarise
from deepfsi.counting.recording import CountSettings, Recording
from deepfsi.datasets.display import Display
from deepfsi.lab.design_data import camera_of, listed_scenes, shown_scenes
from deepfsi.lab.devices import Setup, virtual_setup
from deepfsi.lab.live import LiveRun, record_run
from deepfsi.lab.results import LiveAnswers
from deepfsi.lab.virtual_optics import record_scenes, virtual_camera
from deepfsi.patterns.folder import Patterns


class _Run(Command):
    """A run of a virtual camera, or of devices."""

    patterns: fields.PatternFolder
    settings: Annotated[
        dict[str, Any],
        fields.camera_options("camera", "exposure", "flux", "dark", "dead_time", "dead_time_model"),
    ]
    scene: Path = fields.option(
        "image, or folder of images, with or without a folder for each class", ...
    )
    out: Annotated[Path, fields.Output(new=True)] = fields.option("acquisition folder, new", ...)
    virtual: str | None = fields.option(
        "virtual camera: ideal, pmt, spad, or a TOML file; default: with the dark counts and "
        "dead time of the design's camera, or pmt where that is no laboratory's"
    )
    inputs: fields.Inputs = ()
    seed: WholeNumber = fields.option(
        "seed of the random numbers: the same one repeats the run exactly", 0
    )

    def of_virtual(self, camera: Camera) -> dict[str, Any]:
        """Settings of an acquisition with the virtual camera, which needs light."""
        if camera.flux is None:
            raise InputError(
                "a virtual camera needs its light: give `flux`, such as 1e6, or a camera"
            )
        virtual = virtual_camera(self.virtual, self.patterns, self.settings)
        shown = virtual.model_dump(mode="json")
        return {"flux": camera.flux, "seed": self.seed, "camera": shown}


class SimulateRun(_Run):
    """`deepfsi camera simulate`.

    Without options, the design's camera gives exposure, flux, dark counts and dead time.

    Example: deepfsi camera simulate patterns --scene images --flux 1e7 --exposure 10ms -o run_0001
    """

    settle_s: fields.SettleTime = None
    repeats: fields.Repeats = None

    def run(self, terminal: Terminal) -> Outcome:
        """Run as it was recorded."""
        patterns = Patterns.read(self.patterns)
        camera = camera_of(self.patterns, self.settings)
        virtual = self.of_virtual(camera)
        images, scenes = shown_scenes(self.scene, patterns)
        acquisition = Acquisition.plan(
            patterns.manifest,
            scenes,
            exposure_s=camera.exposure,
            **virtual,
            **self.explicit(("settle_s", "repeats", "inputs")),
        )
        with terminal.progress("photons") as report:
            acquisition = record_scenes(self.out, patterns, images.x, acquisition, report)
        return Outcome(
            {
                "folder": str(self.out),
                "preprocessing": images.preprocessing,
                "acquisition": acquisition.model_dump(mode="json"),
            },
            [
                f"scenes: {self.scene}. {images.preprocessing}",
                acquisition.exposures_text,
                f"recorded: {self.out}",
            ],
        )


class _DeviceRun(_Run):
    """A run with devices, virtual or real."""

    OF_VIRTUAL: ClassVar = ("flux", "dark", "virtual", "seed")
    """Settings that only virtual devices take."""

    projector: str = fields.option(
        "virtual, or NAME[,SETTING=VALUE...] of a driver, such as vialux,version=4.1", "virtual"
    )
    counter: str = fields.option(
        "virtual, or NAME[,SETTING=VALUE...] of a driver, such as swabian,trigger=8", "virtual"
    )
    marker_bit: fields.MarkerBit = None

    def open_projector(self, role: str) -> Any:
        """Real projector, or None of virtual devices; `InputError` where options do not fit."""
        for kind, text in (("projector", self.projector), ("counter", self.counter)):
            check_choice(kind, text.partition(",")[0], ("virtual", *installed().parts[kind]))
        is_virtual = self.projector == "virtual"
        if is_virtual != (self.counter == "virtual"):
            raise InputError("virtual and real devices do not go together: give both, or neither")
        if is_virtual:
            return None
        for setting in self.OF_VIRTUAL:
            if setting in self.settings.keys() | self.model_fields_set:
                raise InputError(f"{option_name(setting)} is for virtual devices: leave it out")
        return installed().open_device(role, self.projector)

    def setup(
        self,
        projector: Any,
        patterns: Patterns,
        images: Display | None,
        acquisition: Acquisition,
        terminal: Terminal,
        decision_s: float | None = None,
    ) -> Setup[Any]:
        """Devices of a run; to real ones someone shows the scenes, whose names are asked for."""
        if images is not None and projector is None:
            with terminal.progress("light of the scenes") as report:
                return virtual_setup(patterns, images.x, acquisition, report, decision_s)
        wiring = {"inputs": acquisition.inputs, "marker_bit": acquisition.marker_bit}
        counter = installed().open_device("counter", self.counter, **wiring)

        def display(scene: int) -> None:
            terminal.ask(f"show {acquisition.scenes[scene].name}")

        return Setup(projector, counter, display)


class RecordRun(_DeviceRun):
    """`deepfsi camera record`.

    Prints a line for each scene as it is recorded. Ctrl-C keeps the scenes that are finished.

    Example: deepfsi camera record patterns --scene images --exposure 10ms --flux 1e7 -o run_0001
    """

    scene: Path = fields.option(
        "picture or folder of the scenes; with real devices also a text file with NAME or "
        "NAME,LABEL on each line",
        ...,
    )
    settle_s: fields.SettleTime = None
    repeats: fields.Repeats = None

    def run(self, terminal: Terminal) -> Outcome:
        """Counts of the run."""
        projector = self.open_projector("projector")
        patterns = Patterns.read(self.patterns)
        camera = camera_of(self.patterns, self.settings)
        wiring: dict[str, Any] = {"flux": camera.flux}
        images = None
        if projector is None:
            wiring = self.of_virtual(camera)
            images, scenes = shown_scenes(self.scene, patterns)
        else:
            scenes = listed_scenes(self.scene, patterns)
        acquisition = Acquisition.plan(
            patterns.manifest,
            scenes,
            exposure_s=camera.exposure,
            **wiring,
            **self.explicit(("settle_s", "repeats", "inputs", "marker_bit")),
        )
        setup = self.setup(projector, patterns, images, acquisition, terminal)
        loading = SILENT if terminal.as_json else None
        recorded = record_run(self.out, patterns, acquisition, setup, report=loading)
        with closing(recorded) as lines:
            for line in lines:
                terminal.say(line)
        settings = CountSettings(
            dead_time=camera.counter_dead_time,
            clicks=camera_of(self.patterns).clicks,
        )
        with terminal.progress("counting") as report:
            run = Recording.read(self.out)
            counts = run.count(settings, progress=report)
        after = f"run: {self.out}; then: deepfsi camera classify {self.patterns} {self.out}"
        return Outcome(run.as_dict(counts), [*run.lines(counts), after])


class RunLive(_DeviceRun):
    """`deepfsi camera live`.

    A design of adaptive masks makes the next mask from the counts so far.

    Prints each decision when it is made. Ctrl-C keeps the scenes that are finished.

    Example: deepfsi camera live patterns --scene images --exposure 10ms --flux 1e6 -o run_0002
    """

    until: float | None = fields.option(
        "confidence above which an exposure stops; default: that of the design's rule"
    )
    photons: fields.ExposureBudget = None

    def run(self, terminal: Terminal) -> Outcome:
        """Classes of the scenes, each said as it is decided."""
        projector = self.open_projector("list projector")
        camera = camera_of(self.patterns, self.settings)
        exposure_s = camera.exposure
        if exposure_s is None:
            raise InputError("an exposure needs a time: give `exposure`, such as 10ms, or a camera")
        patterns = Patterns.read(self.patterns)
        images, scenes = shown_scenes(self.scene, patterns)
        others = self.explicit(("inputs", "marker_bit")) | {"flux": camera.flux}
        if dead_time := camera.counter_dead_time:
            others["dead_time"] = dead_time
        if projector is None:
            others |= self.of_virtual(camera)
        run = LiveRun(
            patterns,
            scenes,
            exposure_s,
            camera.shortest_dwell or None,
            photons=self.photons,
            until=self.until,
            **others,
        )
        decision_s = run.looks.decision_s
        setup = self.setup(projector, patterns, images, run.settings, terminal, decision_s)
        answered = []
        view = None
        with closing(run.steps(self.out, setup)) as steps:
            for step in steps:
                if step.answer is not None:
                    answered.append(step.answer)
                    view = (step.decision and step.decision.view) or view
                    for line in step.answer.lines(exposure_s):
                        terminal.say(line)
        answers = LiveAnswers(exposure_s, tuple(answered), view)
        answers.check_classes(self.out)
        content = answers.as_dict()
        del content["live"]  # as every run of this command is
        return Outcome(
            {
                "folder": str(self.out),
                "preprocessing": images.preprocessing,
                "exposure_s": exposure_s,
                **content,
            },
            [f"scenes: {images.preprocessing}", *answers.run_lines(), f"run: {self.out}"],
        )


class ImportRecording(Command):
    """`deepfsi camera import`.

    With --patterns and --scenes it becomes an acquisition folder for `camera count`. Without
    options, the design's camera gives exposure and flux; the exposure is the longest that fits
    where it has none.

    Without patterns, time stamps become a photon file alone, as for `camera transits`. Their
    trigger is marker 0; without a trigger the file has no markers.

    Example: deepfsi camera import photons.ptu --patterns frames --scenes scenes.csv -o run_lab
    """

    events: fields.ExistingPath = fields.argument(
        "photon file (.ptu), or time stamps in two columns, time and channel (.txt .csv .npy "
        ".parquet)"
    )
    settings: Annotated[dict[str, Any], fields.camera_options("camera", "exposure", "flux")]
    out: Path = fields.option("acquisition folder, new; or the photon file, .ptu", ...)
    patterns: Path | None = fields.option("folder of the patterns that were shown for each scene")
    scenes: Path | None = fields.option(
        "text file with NAME or NAME,LABEL on each line; or a folder of the pictures, with or "
        "without a folder for each class"
    )
    inputs: fields.Inputs = ()
    marker_bit: fields.MarkerBit = None
    settle_s: fields.SettleTime = None
    repeats: fields.Repeats = None
    unit: Seconds | None = fields.option("time stamps: unit of the times, such as 1ps")
    marker_channel: int | None = fields.option(
        "time stamps: channel of the device's trigger; default: none"
    )
    channels: tuple[int, ...] = fields.option(
        "time stamps: channel of each detector, in order; default: all others",
        (),
        alias="channel",
    )
    force: fields.Force = False

    def run(self, terminal: Terminal) -> Outcome:
        """Photon file or acquisition folder that was written."""
        if self.patterns is None:
            fields.Output((".ptu",)).check(self.out, self.force)
            return self._write_photons(self.out)

        fields.Output(new=True).check(self.out, self.force)
        if self.scenes is None:
            raise InputError("an acquisition has scenes: give --scenes, or leave --patterns out")
        camera = camera_of(self.patterns, self.settings)
        patterns = Patterns.read(self.patterns)
        planned = Acquisition.plan(
            patterns.manifest,
            listed_scenes(self.scenes, patterns),
            exposure_s=camera.exposure,
            flux=camera.flux,
            **self.explicit(("inputs", "marker_bit", "settle_s", "repeats")),
        )
        with TemporaryDirectory() as folder:
            photons = self.events
            if photons.suffix.lower() != ".ptu":
                photons = Path(folder) / "photons.ptu"
                self._write_photons(photons)
            acquisition = Recording.prepare(self.out, patterns, planned, photons).acquisition
        return Outcome(
            {"folder": str(self.out), "acquisition": acquisition.model_dump(mode="json")},
            [
                acquisition.exposures_text,
                f"photons on input {name_inputs(acquisition.inputs)}, a trigger on marker input "
                f"{acquisition.marker_bit.bit_length() - 1}",
                f"acquisition: {self.out}; then: deepfsi camera count {self.out}",
            ],
        )

    def _write_photons(self, out: Path) -> Outcome:
        """Write the photon file of time stamps, and say what it holds."""
        if self.unit is None:
            raise InputError(f"{self.events} has time stamps: give their --unit, such as 1ps")
        times, numbers = read_events(self.events)
        channels = write_ptu(
            out, times, numbers, marker=self.marker_channel, inputs=self.channels, tick_s=self.unit
        )
        contents = summarise(out)
        photons = {number + 1: contents.photons.get(number, 0) for number in range(len(channels))}
        triggers = contents.markers.get(1, 0)
        left_out = len(times) - sum(photons.values()) - triggers
        return Outcome(
            {
                "file": str(out),
                "channels": channels,
                "photons": photons,
                "markers": triggers,
                "left_out": left_out,
                "span_s": contents.span_s,
            },
            [
                contents.table(str(out)),
                f"{left_out} events of other channels left out",
                f"photons: {out}",
            ],
        )

"""Commands that record a run, with a virtual camera or with devices, or import what others did."""

from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

from deepfsi.base.errors import InputError, check_choice
from deepfsi.base.models import Seconds, WholeNumber
from deepfsi.base.progress import SILENT
from deepfsi.base.quantities import plural, time_text
from deepfsi.base.registry import installed
from deepfsi.camera.camera import Camera
from deepfsi.cli import fields
from deepfsi.cli.command import Command
from deepfsi.cli.terminal import Outcome, Terminal
from deepfsi.counting.acquisition import Acquisition, Scene
from deepfsi.counting.events import read_events, write_ptu
from deepfsi.counting.recording import Recording
from deepfsi.datasets.display import Display
from deepfsi.lab.design_data import camera_of, listed_scenes, shown_scenes
from deepfsi.lab.devices import Setup, virtual_setup
from deepfsi.lab.live import LiveRun, record_run
from deepfsi.lab.results import ClassifiedRun, ClassifiedScene, lag_remarks, mark_early
from deepfsi.lab.virtual_optics import VirtualCamera, record_scenes
from deepfsi.patterns.folder import Patterns


def _planned(
    command: Command, patterns: Patterns, scenes: tuple[Scene, ...], **settings: Any
) -> Acquisition:
    """Acquisition of the patterns by the options of a command."""
    settings |= command.explicit(("inputs", "marker_bit", "settle_s", "repeats"))
    return Acquisition.plan(patterns.manifest, scenes, **settings)


class _Run(Command):
    """A run of a virtual camera, or of devices."""

    patterns: fields.PatternFolder
    settings: Annotated[
        dict[str, Any],
        fields.camera_options("camera", "exposure", "flux", "dark", "dead_time", "dead_time_model"),
    ]
    scene: Path = fields.option(
        "image, or folder of images, with or without a folder for each class; of real devices also "
        "a text file with NAME or NAME,LABEL on each line (`record`)",
        ...,
    )
    out: fields.NewFolder = fields.option("acquisition folder, new", ...)
    virtual: str | None = fields.option(
        "virtual camera: ideal, pmt, spad, or a TOML file; default: ideal, with the design's dark "
        "counts and dead time"
    )
    inputs: fields.Inputs = ()
    seed: WholeNumber = fields.option("seed: the same one repeats the run exactly", 0)

    def of_virtual(self, camera: Camera) -> dict[str, Any]:
        """Settings of an acquisition with the virtual camera; `InputError` without light."""
        if camera.flux is None:
            raise InputError(
                "a virtual camera needs its light: give `flux`, such as 1e6, or a camera"
            )
        virtual = VirtualCamera.load(self.virtual) if self.virtual else VirtualCamera.of(camera)
        shown = virtual.model_dump(mode="json")
        return {"flux": camera.flux, "seed": self.seed, "camera": shown}


def _lost_light(acquisition: Acquisition) -> dict[str, str]:
    """Words on the light that a virtual detector leaves, if it loses some."""
    camera = VirtualCamera.model_validate(acquisition.camera or {})
    if camera.efficiency == 1 or acquisition.flux is None:
        return {}
    return {"light": camera.light_text(acquisition.flux * acquisition.exposure_s)}


class SimulateRun(_Run):
    """Without options, the design's camera gives exposure, flux, dark counts and dead time.

    Example: deepfsi camera simulate patterns --scene images --flux 1e7 --exposure 10ms -o run_0001
    """

    settle_s: fields.SettleTime = None
    repeats: fields.Repeats = None

    def run(self, terminal: Terminal) -> Outcome:
        patterns = Patterns.read(self.patterns)
        camera = camera_of(self.patterns, self.settings)
        virtual = self.of_virtual(camera)
        images, scenes = shown_scenes(self.scene, patterns)
        acquisition = _planned(self, patterns, scenes, exposure_s=camera.exposure, **virtual)
        with terminal.progress("photons") as report:
            acquisition = record_scenes(self.out, patterns, images.x, acquisition, report)
        return Outcome(
            {
                "folder": str(self.out),
                "preprocessing": images.preprocessing,
                **_lost_light(acquisition),
                "acquisition": acquisition.model_dump(mode="json"),
            }
        )


class _DeviceRun(_Run):
    """A run with devices, virtual or real."""

    projector: str = fields.option("virtual, or a driver: vialux,version=4.1", "virtual")
    counter: str = fields.option("virtual, or a driver: swabian,trigger=8", "virtual")
    marker_bit: fields.MarkerBit = None

    def open_projector(self, role: str) -> Any:
        """Real projector, or None for virtual devices; `InputError` if options do not fit."""
        for option, kind, text in (
            ("projector", role, self.projector),
            ("counter", "counter", self.counter),
        ):
            check_choice(option, text.partition(",")[0], ("virtual", *installed().parts[kind]))
        is_virtual = self.projector == "virtual"
        if is_virtual != (self.counter == "virtual"):
            raise InputError("virtual and real devices do not go together: give both, or neither")
        if is_virtual:
            return None
        for setting in ("flux", "dark", "virtual", "seed"):
            if setting in self.settings.keys() | self.model_fields_set:
                raise InputError(f"`{setting}` is for virtual devices: leave it out")
        return installed().open_device(role, self.projector)

    def setup(
        self,
        projector: Any,
        patterns: Patterns,
        images: Display | None,
        acquisition: Acquisition,
        terminal: Terminal,
        decision_s: float | None = None,
    ) -> Setup:
        """Devices of a run. With real ones a person is asked to show each scene."""
        if images is not None and projector is None:
            with terminal.progress("light of the scenes") as report:
                return virtual_setup(patterns, images.x, acquisition, report, decision_s)
        wiring = {"inputs": acquisition.inputs, "marker_bit": acquisition.marker_bit}
        counter = installed().open_device("counter", self.counter, **wiring)

        def display(scene: int) -> None:
            terminal.ask(f"show {acquisition.scenes[scene].name}")

        return Setup(projector, counter, display)


class RecordRun(_DeviceRun):
    """Prints a line for each scene as it is recorded. Ctrl-C keeps the scenes that are finished.

    Example: deepfsi camera record patterns --scene images --exposure 10ms --flux 1e7 -o run_0001
    """

    settle_s: fields.SettleTime = None
    repeats: fields.Repeats = None

    def run(self, terminal: Terminal) -> Outcome:
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
        acquisition = _planned(self, patterns, scenes, exposure_s=camera.exposure, **wiring)
        setup = self.setup(projector, patterns, images, acquisition, terminal)
        loading = SILENT if terminal.as_json else None
        recorded = record_run(self.out, patterns, acquisition, setup, report=loading)
        with closing(recorded) as lines:
            for line in lines:
                terminal.say(line)
        clicks = camera_of(self.patterns).clicks
        with terminal.progress("counting") as report:
            run = Recording.read(self.out)
            counts = run.count(
                dead_time=camera.counter_dead_time, click_gates=clicks, progress=report
            )
        after = f"run: {self.out}; then: deepfsi camera classify {self.patterns} {self.out}"
        light = _lost_light(acquisition)
        words = [f"light: {text}" for text in light.values()]
        return Outcome(run.as_dict(counts) | light, [*run.lines(counts), *words, after])


class RunLive(_DeviceRun):
    """Prints each decision when it is made. Ctrl-C keeps the scenes that are finished.

    Example: deepfsi camera live patterns --scene images --exposure 10ms --flux 1e6 -o run_0002
    """

    until: float | None = fields.option("confidence that ends an exposure; default: the design's")

    def run(self, terminal: Terminal) -> Outcome:
        projector = self.open_projector("list projector")
        camera = camera_of(self.patterns, self.settings)
        exposure_s = camera.exposure
        if exposure_s is None:
            raise InputError("an exposure needs a time: give `exposure`, such as 10ms, or a camera")
        patterns = Patterns.read(self.patterns)
        images, scenes = shown_scenes(self.scene, patterns)
        wiring = self.explicit(("inputs", "marker_bit")) | {"flux": camera.flux}
        if dead_time := camera.counter_dead_time:
            wiring["dead_time"] = dead_time
        if projector is None:
            wiring |= self.of_virtual(camera)
        run = LiveRun(patterns, scenes, exposure_s, until=self.until, **wiring)
        setup = self.setup(projector, patterns, images, run.settings, terminal, run.decision_s)
        answered = []
        view = None
        with closing(run.steps(self.out, setup)) as steps:
            for step in steps:
                view = step.view or view
                if step.answer is not None:
                    answered.append(step.answer)
                    terminal.say(_words(step.answer))
                    for fault in step.faults:
                        terminal.say(f"  {fault.words()}")
        if all(answer.predicted is None for answer in answered):
            first = next(fault for answer in answered for fault in answer.faults)
            raise InputError(f"no scene of {self.out} has a class: {first.words()}")
        answers = ClassifiedRun(
            title="a live run",
            noun="scene",
            classes=run.design.classes,
            scenes=mark_early(answered),
            remarks=(*filter(None, [view and view.remark]), *lag_remarks(scenes)),
            view=view,
        )
        light = _lost_light(run.settings)
        return Outcome(
            {
                "folder": str(self.out),
                "preprocessing": images.preprocessing,
                "exposure_s": exposure_s,
                **light,
                **answers.as_dict(),
            },
            [
                f"scenes: {images.preprocessing}",
                *(f"light: {text}" for text in light.values()),
                *answers.summary(),
                f"run: {self.out}",
            ],
        )


def _words(answer: ClassifiedScene) -> str:
    """Class of a scene of a live run in one line."""
    if answer.predicted is None:
        return f"{answer.name}: no class"
    return (
        f"{answer.name}: {answer.predicted}, confidence {answer.probability:.3f}, "
        f"{plural(answer.looks or 0, 'look')}, light {time_text(answer.light_s or 0.0)}, clock "
        f"{time_text(answer.clock_s or 0.0)}"
    )


class ImportRecording(Command):
    """It becomes an acquisition folder for `camera count`; without patterns, a photon file alone.

    Without options, the design's camera gives exposure and flux; the exposure is the longest that
    fits where it has none.

    Example: deepfsi camera import photons.ptu --patterns frames --scenes scenes.csv -o run_lab
    """

    events: fields.ExistingPath = fields.argument(
        "photon file (.ptu), or time and channel of each event (.txt .csv .npy .parquet)"
    )
    settings: Annotated[dict[str, Any], fields.camera_options("camera", "exposure", "flux")]
    out: Path = fields.option("acquisition folder, new; or the photon file, .ptu", ...)
    patterns: Path | None = fields.option("folder of the patterns that were shown for each scene")
    scenes: Path | None = fields.option(
        "text file with NAME or NAME,LABEL on each line; or a folder of the pictures"
    )
    inputs: fields.Inputs = ()
    marker_bit: fields.MarkerBit = None
    settle_s: fields.SettleTime = None
    repeats: fields.Repeats = None
    unit: Seconds | None = fields.option("time stamps: unit of the times, such as 1ps")
    marker_channel: int | None = fields.option("time stamps: channel of the device's trigger")
    channels: tuple[int, ...] = fields.option(
        "time stamps: channel of each detector; default: all others", (), alias="channel"
    )
    force: fields.Force = False

    def run(self, terminal: Terminal) -> Outcome:
        if self.patterns is None:
            fields.Output((".ptu",)).check(self.out, self.force)
            self._write_photons(self.out)
            return Outcome({"file": str(self.out)})
        fields.Output(new=True).check(self.out, self.force)
        if self.scenes is None:
            raise InputError("an acquisition has scenes: give `scenes`, or leave `patterns` out")
        camera = camera_of(self.patterns, self.settings)
        patterns = Patterns.read(self.patterns)
        scenes = listed_scenes(self.scenes, patterns)
        light = {"exposure_s": camera.exposure, "flux": camera.flux}
        planned = _planned(self, patterns, scenes, **light)
        with TemporaryDirectory() as folder:
            photons = self.events
            if photons.suffix.lower() != ".ptu":
                photons = Path(folder) / "photons.ptu"
                self._write_photons(photons)
            acquisition = Recording.prepare(self.out, patterns, planned, photons).acquisition
        return Outcome(
            {"folder": str(self.out), "acquisition": acquisition.model_dump(mode="json")}
        )

    def _write_photons(self, out: Path) -> None:
        if self.unit is None:
            raise InputError(f"{self.events} has time stamps: give their `unit`, such as 1ps")
        times, numbers = read_events(self.events)
        wiring: dict[str, Any] = {"marker": self.marker_channel, "inputs": self.channels}
        write_ptu(out, times, numbers, **wiring, tick_s=self.unit)

"""Commands that record a run, with a virtual camera or with devices, or import what others did."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import Field

from deepfsi.base.errors import InputError, check_choice
from deepfsi.base.models.strict import WholeNumber
from deepfsi.base.progress import SILENT
from deepfsi.base.quantities import time_text
from deepfsi.base.registry import installed
from deepfsi.camera.camera import Camera
from deepfsi.camera.device import find_device
from deepfsi.cli import fields
from deepfsi.cli.command import Command
from deepfsi.cli.terminal import Outcome, Terminal

if TYPE_CHECKING:
    from deepfsi.hardware.counting.acquisition import Acquisition
    from deepfsi.lab.devices import Setup


MOST_EVENTS = 1e8
"""Photons of a simulated recording that are written without asking."""

EVENT_BYTES = 4
"""Bytes of a photon in its file."""

NewRun = Annotated[Path, fields.Output(new=True), Field(description="acquisition folder, new")]
ShownScenes = Annotated[
    Path,
    Field(description="image, or folder of images, with or without a folder for each class"),
]
VirtualName = Annotated[
    str | None,
    Field(
        description="virtual camera: ideal, pmt, spad, or a TOML file; with the dark counts and "
        "dead time of the design's camera unless given, or pmt where that is no laboratory's"
    ),
]
RunSeed = Annotated[
    WholeNumber,
    Field(description="seed of the random numbers: the same one repeats the run exactly"),
]
LargeFile = Annotated[bool, Field(description="write a large file without asking")]


class PrepareRun(Command):
    """`deepfsi camera prepare`.

    Exposure and flux are those of the design's camera unless given; the longest exposure that fits
    where it has none.

    Example: deepfsi camera prepare patterns --scenes scenes.csv --input 1 --marker 0 -o run_lab
    """

    patterns: fields.PatternFolder
    scenes: Path = fields.required(
        "text file with NAME or NAME,LABEL on each line; or a folder of the pictures, with or "
        "without a folder for each class"
    )
    settings: Annotated[dict[str, Any], fields.run_options("exposure", "flux")]
    out: NewRun
    inputs: fields.Inputs = ()
    marker_bit: fields.MarkerBit = None
    settle_s: fields.SettleTime = None
    repeats: fields.Repeats = None

    def run(self, terminal: Terminal) -> Outcome:
        """Plan of the run, in its folder."""
        from deepfsi.hardware.counting.acquisition import Acquisition
        from deepfsi.hardware.counting.recording import Recording
        from deepfsi.hardware.light.flux import name_inputs
        from deepfsi.hardware.patterns.folder import Patterns
        from deepfsi.lab.design_data import camera_of, listed_scenes

        patterns = Patterns.read(self.patterns)
        camera = camera_of(self.patterns, self.settings)
        planned = Acquisition.plan(
            patterns.manifest,
            listed_scenes(self.scenes, self.patterns),
            exposure_s=camera.exposure,
            flux=camera.flux,
            **self.explicit(("inputs", "marker_bit", "settle_s", "repeats")),
        )
        acquisition = Recording.prepare(self.out, patterns, planned).acquisition
        return Outcome(
            {"folder": str(self.out), "acquisition": acquisition.model_dump(mode="json")},
            [
                f"{acquisition.exposures_text}, {time_text(patterns.manifest.pass_s)} a pass",
                f"photons on input {name_inputs(acquisition.inputs)}, a trigger on marker input "
                f"{acquisition.marker_bit.bit_length() - 1}",
                f"acquisition: {self.out}; show the patterns once for each scene, put the "
                f"recording there as photons.ptu, then: deepfsi camera count {self.out}",
            ],
        )


class SimulateRun(Command):
    """`deepfsi camera simulate`.

    Exposure, flux, dark counts, dead time and gates are those of the design's camera unless given.

    Example: deepfsi camera simulate patterns --scene images --flux 1e7 --exposure 10ms -o run_0001
    """

    patterns: fields.PatternFolder
    settings: Annotated[
        dict[str, Any],
        fields.run_options("exposure", "flux", "dark", *fields.COUNTER_EFFECTS),
    ]
    scene: ShownScenes
    out: NewRun
    virtual: VirtualName = None
    settle_s: fields.SettleTime = None
    repeats: fields.Repeats = None
    inputs: fields.Inputs = ()
    seed: RunSeed = 0
    yes: LargeFile = False

    def run(self, terminal: Terminal) -> Outcome:
        """Run as it was recorded."""
        from deepfsi.hardware.patterns.folder import Patterns
        from deepfsi.lab.design_data import camera_of, displayed, picture_hashes
        from deepfsi.lab.virtual_optics import (
            RecordingSettings,
            expected_events,
            record_scenes,
            virtual_camera,
        )

        camera = camera_of(self.patterns, self.settings)
        virtual = virtual_camera(self.virtual, self.patterns, self.settings)
        if self.virtual is None:
            clicks = camera_of(self.patterns).clicks
            virtual = virtual.model_copy(update={"gates": clicks})
        recording = RecordingSettings(
            virtual,
            _flux_of(camera),
            _exposure_of(camera),
            seed=self.seed,
            **self.explicit(("settle_s", "repeats", "inputs")),
        )
        patterns = Patterns.read(self.patterns)
        images = displayed(self.scene, self.patterns)
        if not self.yes:
            _ask_for_room(terminal, expected_events(patterns, images.x, virtual, recording.flux))
        with terminal.progress("photons") as report:
            acquisition = record_scenes(
                self.patterns,
                images.x,
                images.names,
                images.labels,
                out=self.out,
                settings=recording,
                report=report,
                hashes=picture_hashes(self.scene, self.patterns),
            )
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


def _ask_for_room(terminal: Terminal, events: float) -> None:
    """Ask before a photon file beyond `MOST_EVENTS`; `InputError` where there is no one to ask."""
    if events <= MOST_EVENTS:
        return
    size = f"{events:.2g} photons, {events * EVENT_BYTES / 1e9:.2g} GB"
    if not terminal.confirm(f"The recording will hold {size}. Go on?"):
        raise InputError(
            f"the recording would hold {size}: lower --flux, show fewer scenes, export with a "
            "shorter --exposure (all of a pass is recorded), or add --yes"
        )


def _exposure_of(camera: Camera) -> float:
    """Time of a whole exposure in seconds, or `InputError` where the camera has none."""
    if camera.exposure is None:
        raise InputError("an exposure needs a time: give `exposure`, such as 10ms, or a camera")
    return camera.exposure


def _flux_of(camera: Camera) -> float:
    """Flux in counts/s, or `InputError` where the camera has none."""
    if camera.flux is None:
        raise InputError("a virtual camera needs its light: give `flux`, such as 1e6, or a camera")
    return camera.flux


class _DeviceRun(Command):
    """A run with devices, virtual or real."""

    OF_VIRTUAL: ClassVar = ("flux", "dark", "virtual", "latency_s", "seed", "yes")
    """Settings that only virtual devices take."""

    settings: dict[str, Any]
    scene: Path
    out: NewRun
    projector: str = fields.option(
        "virtual, or NAME[,SETTING=VALUE...] of a driver, such as vialux,version=4.1", "virtual"
    )
    counter: str = fields.option(
        "virtual, or NAME[,SETTING=VALUE...] of a driver, such as swabian,trigger=8", "virtual"
    )
    virtual: VirtualName = None
    latency_s: fields.Time | None = fields.option(
        "time from a decision until virtual devices show its frames; 1ms unless given",
        alias="latency",
    )

    @property
    def is_virtual(self) -> bool:
        """True of virtual devices."""
        return self.projector == "virtual"

    def check_devices(self) -> None:
        """Raise `InputError` for devices or options that do not go together."""
        for role, text in (("projector", self.projector), ("counter", self.counter)):
            check_choice(role, text.partition(",")[0], ("virtual", *installed().parts[role]))
        if self.is_virtual != (self.counter == "virtual"):
            raise InputError("virtual and real devices do not go together: give both, or neither")
        for setting in () if self.is_virtual else self.OF_VIRTUAL:
            if setting in self.settings.keys() | self.model_fields_set:
                option = self.option(setting)
                raise InputError(f"{option} is for virtual devices: leave it out")

    def wire(self, projector: Any, acquisition: "Acquisition", terminal: Terminal) -> "Setup[Any]":
        """Real devices of a run: someone shows the scenes, whose names are asked for."""
        from deepfsi.lab.devices import Setup

        wiring = {"inputs": acquisition.inputs, "marker_bit": acquisition.marker_bit}
        counter = installed().open_device("counter", self.counter, **wiring)

        def display(scene: int) -> None:
            name = acquisition.scenes[scene].name
            terminal.ask(f"show {name}" if scene >= 0 else "make the scenes dark")

        return Setup(projector, counter, display)


class RecordRun(_DeviceRun):
    """`deepfsi camera record`.

    Prints a line for each scene as it is recorded. Ctrl-C keeps the scenes that are finished.

    Example: deepfsi camera record patterns --scene images --exposure 10ms --flux 1e7 -o run_0001
    """

    patterns: fields.PatternFolder
    settings: Annotated[
        dict[str, Any],
        fields.run_options("exposure", "flux", "dark", *fields.COUNTER_EFFECTS),
    ]
    scene: Path = fields.required(
        "picture, folder or .zip of the scenes; with real devices also a text file with NAME or "
        "NAME,LABEL on each line"
    )
    settle_s: fields.SettleTime = None
    repeats: fields.Repeats = None
    inputs: fields.Inputs = ()
    marker_bit: fields.MarkerBit = None
    seed: RunSeed = 0
    yes: LargeFile = False

    def run(self, terminal: Terminal) -> Outcome:
        """Counts of the run."""
        from deepfsi.hardware.counting.acquisition import Acquisition
        from deepfsi.hardware.counting.recording import CountSettings, Recording
        from deepfsi.hardware.patterns.folder import Patterns
        from deepfsi.lab.design_data import camera_of, displayed, listed_scenes, scenes_of
        from deepfsi.lab.devices import PassProjector, Setup, virtual_setup
        from deepfsi.lab.live import record_run
        from deepfsi.lab.virtual_optics import expected_events, virtual_camera

        self.check_devices()
        patterns = Patterns.read(self.patterns)
        camera = camera_of(self.patterns, self.settings)
        wiring = self.explicit(("settle_s", "repeats", "inputs", "marker_bit"))
        if self.is_virtual:
            flux = _flux_of(camera)
            images = displayed(self.scene, self.patterns)
            virtual = virtual_camera(self.virtual, self.patterns, self.settings)
            if not self.yes:
                _ask_for_room(terminal, expected_events(patterns, images.x, virtual, flux))
            scenes = scenes_of(images, self.scene, self.patterns)
            wiring |= {"seed": self.seed, "camera": virtual.model_dump(mode="json")}
        else:
            scenes = listed_scenes(self.scene, self.patterns)
        acquisition = Acquisition.plan(
            patterns.manifest, scenes, exposure_s=camera.exposure, flux=camera.flux, **wiring
        )
        setup: Setup[PassProjector]
        if self.is_virtual:
            with terminal.progress("light of the scenes") as report:
                setup = virtual_setup(
                    self.patterns, images.x, acquisition, report, latency_s=self.latency_s
                )
        else:
            projector = installed().open_device("projector", self.projector)
            setup = self.wire(projector, acquisition, terminal)
        loading = SILENT if terminal.as_json else None
        recorded = record_run(self.out, self.patterns, acquisition, setup, report=loading)
        with closing(recorded) as scenes_so_far:
            for scene in scenes_so_far:
                terminal.say(str(scene))
        settings = CountSettings(
            dead_time=camera.corrected_dead_time(self.settings),
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

    settings: Annotated[
        dict[str, Any],
        fields.run_options("exposure", "flux", "dark", *fields.COUNTER_EFFECTS, "shortest_dwell"),
    ]
    source: fields.DesignPath = fields.argument(
        "folder of patterns; or a design file, shown on a DLP7000"
    )
    scene: ShownScenes
    until: float | None = fields.option(
        "confidence above which an exposure stops; that of the design's rule unless given"
    )
    photons: fields.ExposureBudget = None
    inputs: fields.Inputs = ()
    marker_bit: fields.MarkerBit = None
    seed: RunSeed = 0
    yes: LargeFile = False

    def run(self, terminal: Terminal) -> Outcome:
        """Classes of the scenes, each said as it is decided."""
        from deepfsi.hardware.patterns.folder import Patterns
        from deepfsi.lab.adaptive_looks import open_looks
        from deepfsi.lab.design_data import camera_of, displayed, scenes_of
        from deepfsi.lab.devices import Setup, StreamingProjector, virtual_setup
        from deepfsi.lab.live import plan_live, run_live
        from deepfsi.lab.results import LiveAnswers
        from deepfsi.lab.virtual_optics import expected_events, virtual_camera

        self.check_devices()
        projector = None
        if not self.is_virtual:
            projector = installed().open_device("list projector", self.projector)
        camera = camera_of(self.source, self.settings)
        exposure_s = _exposure_of(camera)
        others = self.explicit(("inputs", "marker_bit"))
        if dead_time := camera.corrected_dead_time(self.settings):
            others["dead_time"] = dead_time
        if self.is_virtual:
            flux = _flux_of(camera)
            virtual = virtual_camera(self.virtual, self.source, self.settings)
            others |= {"seed": self.seed, "camera": virtual.model_dump(mode="json")}
        with self._patterns(terminal) as patterns:
            images = displayed(self.scene, patterns)
            looks = open_looks(patterns)
            acquisition = plan_live(
                patterns,
                scenes_of(images, self.scene, patterns),
                exposure_s,
                camera.shortest_dwell or None,
                looks=looks,
                photons=self.photons,
                until=self.until,
                flux=camera.flux,
                **others,
            )
            setup: Setup[StreamingProjector]
            if projector is None:
                if not self.yes:
                    shown = Patterns.read(patterns)
                    passes = exposure_s / shown.manifest.pass_s + 1  # at most
                    events = expected_events(shown, images.x, virtual, flux)
                    _ask_for_room(terminal, events * passes)
                with terminal.progress("light of the scenes") as report:
                    setup = virtual_setup(
                        patterns,
                        images.x,
                        acquisition,
                        report,
                        latency_s=self.latency_s,
                        decision_s=looks.decision_s,
                    )
            else:
                setup = self.wire(projector, acquisition, terminal)
            answers = []
            view = None
            live = run_live(self.out, patterns, acquisition, setup, looks=looks)
            with closing(live) as steps:
                for step in steps:
                    if step.answer is not None:
                        answers.append(step.answer)
                        view = (step.decision and step.decision.view) or view
                        for line in step.answer.lines(exposure_s):
                            terminal.say(line)
        run = LiveAnswers(exposure_s, tuple(answers), view)
        run.check_classes(self.out)
        content = run.as_dict()
        del content["live"]  # as every run of this command is
        return Outcome(
            {
                "folder": str(self.out),
                "preprocessing": images.preprocessing,
                "exposure_s": exposure_s,
                **content,
            },
            [f"scenes: {images.preprocessing}", *run.run_lines(), f"run: {self.out}"],
        )

    @contextmanager
    def _patterns(self, terminal: Terminal) -> Iterator[Path]:
        """Folder of patterns, or those of a design file for the moment."""
        from deepfsi.hardware.patterns.folder import Patterns
        from deepfsi.lab.design_data import design_rails

        if self.source.is_dir():
            yield self.source
            return
        with TemporaryDirectory() as folder:
            patterns = Path(folder) / "patterns"
            with terminal.progress("patterns") as report:
                Patterns.from_rails(design_rails(self.source), find_device("dlp7000"), 1e-3).write(
                    patterns, report
                )
            yield patterns


class ImportRecording(Command):
    """`deepfsi camera import`.

    Time stamps become a photon file, their trigger marker 0. Without a trigger it has no markers,
    as for `camera transits`.

    Example: deepfsi camera import tags.csv --unit 81ps --marker-channel 8 -o run_lab/photons.ptu
    """

    events: Path = fields.argument(
        "time stamps: two columns, time and channel (.txt .csv .npy .parquet)"
    )
    out: Annotated[Path, fields.Output((".ptu",))] = fields.required("photon file, .ptu, new")
    unit: fields.Time = fields.required("unit of the times, such as 1ps")
    marker_channel: int | None = fields.option("channel of the device's trigger; none unless given")
    channels: tuple[int, ...] = fields.option(
        "channel of each detector, in order; all others unless given", (), alias="channel"
    )
    force: fields.Force = False

    def run(self, terminal: Terminal) -> Outcome:
        """Photon file that was written."""
        from deepfsi.hardware.photons.events import read_events, write_ptu
        from deepfsi.hardware.photons.reader import summarise

        times, numbers = read_events(self.events)
        channels = write_ptu(
            self.out,
            times,
            numbers,
            marker=self.marker_channel,
            inputs=self.channels,
            tick_s=self.unit,
        )
        contents = summarise(self.out)
        photons = {number + 1: contents.photons.get(number, 0) for number in range(len(channels))}
        triggers = contents.markers.get(1, 0)
        left_out = len(times) - sum(photons.values()) - triggers
        marker = f"channel {self.marker_channel}: {triggers} markers on 0"
        if self.marker_channel is None:
            marker = "no trigger, so no markers: give --marker-channel if a channel has it"
        return Outcome(
            {
                "file": str(self.out),
                "channels": channels,
                "photons": photons,
                "markers": triggers,
                "left_out": left_out,
                "span_s": contents.span_s,
            },
            [
                *(
                    f"channel {channel}: {count} photons on input {number}"
                    for channel, (number, count) in zip(channels, photons.items(), strict=True)
                ),
                marker,
                f"{left_out} events of other channels left out",
                f"time from the first event to the last: {contents.span_s:.6g} s",
                f"photons: {self.out}",
            ],
        )

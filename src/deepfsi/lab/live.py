"""Runs: a projector shows, and a counter counts, scene after scene, until all are shown.

A live run decides on what is shown next. Each of its lists of frames ends with the all-OFF frame,
which stays while the next list is chosen: its marker ends the last gate, and the detector rests.

A recorded run shows a pass of all frames for each scene. Its photon file is counted afterwards, as
any. While it is written frames are counted, too, so that a missing marker or a scene without light
is said at once, and not when all scenes are shown.
"""

import math
import time
from collections.abc import Generator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.files import GrowingFile
from deepfsi.base.interrupts import note_saved_work
from deepfsi.base.progress import Progress, progress_bar
from deepfsi.base.registry import require_extras
from deepfsi.camera.dead_time import NO_DEAD_TIME, DeadTime
from deepfsi.counting.acquisition import Acquisition, LiveSettings, Scene, StopRule
from deepfsi.counting.checks import NO_LIGHT
from deepfsi.counting.flux import excess_chance
from deepfsi.counting.recording import Recording
from deepfsi.counting.streaming import FrameCounts, FrameGates
from deepfsi.designfile.provenance import was_trained_on
from deepfsi.lab.devices import (
    PATIENCE_S,
    PassProjector,
    Setup,
    StreamingCounter,
    StreamingProjector,
)
from deepfsi.lab.observer import (
    MARGIN_NS,
    OFF,
    Decision,
    SceneObserver,
    margin_ns,
)
from deepfsi.lab.results import LOG, FrameList, LiveScene, LoggedList, LoggedScene
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.frames import make_frame
from deepfsi.patterns.manifest import Manifest


class LiveStep(NamedTuple):
    """A decision of a live run, and when it fell."""

    scene: int  # from 0
    decision: Decision | None  # None where a scene had no light
    clock_s: float  # after the scene's first command, seconds
    answer: LiveScene | None = None  # class of the scene, after its last look


class LiveRun:
    """A live run: a design of adaptive masks, its patterns, and the settings.

    Parameters
    ----------
    patterns : Patterns
        Of a folder, which has the design, too.
    scenes : tuple of Scene
        In their order.
    exposure_s : float
        Time of all looks at a scene, seconds.
    shortest_s : float, optional
        Shortest time for which a frame is counted, seconds. Default: of the device.
    photons : float, optional
        Budget of an exposure, counts. Default: measured by the all-ON frames.
    until : float, optional
        Probability at which an exposure ends. Default: of the design's rule.
    dead_time : DeadTime
        Dead time of the counter, to be corrected.
    **others
        Fields of the `Acquisition`.

    Raises
    ------
    InputError
        If the patterns are of no such design, or the device cannot show its looks so.
    """

    def __init__(
        self,
        patterns: Patterns,
        scenes: tuple[Scene, ...],
        exposure_s: float,
        shortest_s: float | None = None,
        *,
        photons: float | None = None,
        until: float | None = None,
        dead_time: DeadTime = NO_DEAD_TIME,
        **others: object,
    ) -> None:
        with require_extras():
            from deepfsi.lab.adaptive_looks import AdaptiveLooks
        if not (math.isfinite(exposure_s) and exposure_s > 0):
            raise InputError(f"exposure {exposure_s!r} is not allowed: give seconds above 0")
        if photons is not None and not (math.isfinite(photons) and photons > 0):
            raise InputError(f"photons {photons!r} is not allowed: give a number above 0")
        if until is not None and not 0 < until < 1:
            raise InputError(f"confidence {until!r} is not allowed: give `until` between 0 and 1")
        self.patterns = patterns
        self.looks = AdaptiveLooks.read(patterns)
        manifest = patterns.manifest
        looks_s = exposure_s * np.array(self.looks.shares)
        with as_input_error():
            self.settings = Acquisition(
                scenes=scenes,
                exposure_s=exposure_s,
                settle_s=manifest.device.settle_us * 1e-6,
                repeats=1,
                live=LiveSettings(
                    shortest_ns=_shortest_gate(manifest, looks_s, shortest_s),
                    photons=photons,
                    rule=self.looks.rule if until is None else StopRule(threshold=until),
                    dead_time=dead_time,
                ),
                **{"inputs": tuple(range(manifest.inputs)), **others},
            )

    def steps(self, folder: Path, setup: Setup[StreamingProjector]) -> Generator[LiveStep]:
        """Show, count and decide with devices, which are let go of at the end.

        Gives each decision as it falls; the last one of a scene has its answer. Scenes that are
        finished are kept in `folder`, which is new, whenever the run is stopped: their lines are in
        `shown.jsonl` before their last decision is given.
        """
        looks = self.looks
        assert self.settings.live is not None
        live = self.settings.live.model_copy(update={"latencies": setup.latencies})
        settings = self.settings.model_copy(update={"live": live})
        manifest = self.patterns.manifest
        observer = SceneObserver(looks, manifest, settings)
        with ExitStack() as stack:
            stack.enter_context(setup.projector)
            stack.enter_context(setup.counter)
            setup.projector.load(self.patterns)
            Recording.prepare(folder, self.patterns, settings)
            setup.counter.start(folder / "photons.ptu")
            log = stack.enter_context(GrowingFile(folder / LOG))
            frames = _DeviceFrames(setup, manifest, settings.settle_s)
            for number, scene in enumerate(settings.scenes):
                frames.begin(number)
                decision: Decision | None = None
                for decision in observer.observe(number, frames.count):
                    if not decision.final:
                        yield LiveStep(number, decision, frames.clock_s)
                logged = frames.logged(decision)
                log.write(logged.line)
                note_saved_work("finished scenes are kept")
                [trained] = was_trained_on(looks.training_scenes, [scene.hash])
                photons = decision.photons if decision else None
                answer = LiveScene.of(scene, logged, looks.classes, trained, photons)
                yield LiveStep(number, decision, logged.clock_s, answer)
            setup.counter.stop()


def _shortest_gate(manifest: Manifest, looks_s: np.ndarray, shortest_s: float | None) -> int:
    """Shortest gate of a run, ns, for looks of some lengths (K,)."""
    device = manifest.device
    if device.video_us is not None:
        raise InputError(
            f"{device.name} shows all frames for one time, and a live run chooses theirs: export "
            "for a device that stores frames, such as dlp7000"
        )
    look_s = float(looks_s.min())
    look_ns = np.array(looks_s.max() * 1e9)
    longest_us = float(look_ns + margin_ns(look_ns)) * 1e-3 + device.settle_us
    if longest_us > device.longest_us:
        raise InputError(
            f"a look may show one mask for {longest_us:.4g} µs, and {device.name} holds a picture "
            f"for {device.longest_us} at most: give a shorter `exposure`"
        )
    least_ns = device.shortest_us * 1000 - round(device.settle_us * 1000) - MARGIN_NS
    if shortest_s is not None and not shortest_s >= 0:
        raise InputError(f"a shortest dwell of {shortest_s!r} is not allowed: give 0 or more")
    shortest_ns = max(least_ns, round((shortest_s or 0.0) * 1e9), 1)
    if look_s * 1e9 < shortest_ns:
        raise InputError(
            f"a look of {look_s:.3g} s is shorter than the shortest dwell, {shortest_ns / 1e3:g} "
            "µs: give a longer `exposure`, or a shorter `shortest_dwell`"
        )
    return shortest_ns


class _DeviceFrames:
    """Frames of a live run, shown and counted by devices list after list, scene after scene."""

    def __init__(
        self, setup: Setup[StreamingProjector], manifest: Manifest, settle_s: float
    ) -> None:
        self._setup = setup
        self._manifest = manifest
        self._settle_s = settle_s
        self._counted = _CountedFrames(setup.counter, manifest.inputs)
        self._markers = 0  # of all lists so far

    def begin(self, scene: int) -> None:
        """Show a scene: lists from here on are its own."""
        self._setup.display(scene)
        self._scene = scene
        self._lists: list[LoggedList] = []
        self._first_marker = self._markers
        self._start_s = self._setup.clock()

    @property
    def clock_s(self) -> float:
        """Time since the scene's first command, seconds."""
        return self._setup.clock() - self._start_s

    def logged(self, decision: Decision | None) -> LoggedScene:
        """The scene as it was shown, and its last decision; none where it had no light."""
        return LoggedScene(
            scene=self._scene,
            first_marker=self._first_marker,
            lists=tuple(self._lists),
            chances=tuple(decision.chances.tolist()) if decision else (),
            faults=decision.faults if decision else (),
            light_s=decision.light_s if decision else 0.0,
            clock_s=self.clock_s,
        )

    def count(self, asked: FrameList) -> FrameCounts:
        """Counts of the frames of a list, which are shown."""
        projector = self._setup.projector
        if asked.masks is not None:
            manifest = self._manifest
            for frame, mask in zip(asked.frames, asked.masks, strict=True):
                projector.replace(int(frame), make_frame(mask, manifest.device, manifest.grid))
        frames = np.append(asked.frames, OFF)
        gates_s = np.append(asked.gate_ns, 0) * 1e-9
        pictures_s = self._pictures_s(asked)
        markers, markers_s = projector.pictures(pictures_s)
        offsets_s = np.full(len(frames), self._settle_s)
        self._setup.counter.expect(FrameGates(offsets_s, gates_s, markers, markers_s))
        projector.show(frames, pictures_s)
        limit_s = float(pictures_s.sum()) + PATIENCE_S
        counts = self._counted.take(len(asked.frames), limit_s)
        self._lists.append(LoggedList.of(asked, markers))
        self._markers += int(markers.sum())
        return counts

    def _pictures_s(self, asked: FrameList) -> np.ndarray:
        """Times for which frames, and the all-OFF one after them, are held, whole µs in seconds."""
        device = self._manifest.device
        us = np.ceil((asked.gate_ns + margin_ns(asked.gate_ns)) * 1e-3 + device.settle_us)
        if asked.look < 0:
            us = np.array([self._manifest.frames[index].picture_us for index in asked.frames])
        return np.append(np.maximum(us, device.shortest_us), device.shortest_us) * 1e-6


class _CountedFrames:
    """Counts of frames as a counter gives them, list after list.

    The frame after a list's own, which ends the last gate, is left out: its count may come late.
    """

    def __init__(self, counter: StreamingCounter, inputs: int) -> None:
        self._counter = counter
        self._inputs = inputs
        self._late = 0  # frames of earlier lists whose counts are still to come

    def take(self, wanted: int, limit_s: float, since: str = "") -> FrameCounts:
        """Counts of the next frames, within a time; `since` says in a fault when it begins."""
        until = time.monotonic() + limit_s
        parts = []
        count = -self._late
        while count < wanted:
            left = until - time.monotonic()
            if left <= 0:
                raise InputError(
                    f"counts of {wanted - max(count, 0)} of {wanted} frames did not come within "
                    f"{limit_s:.3g} s{since}: check that the device's trigger is wired to the "
                    "counter and that it records"
                )
            counts = self._counter.counts_since_marker(left)
            parts.append(counts[max(-count, 0) :])
            count += len(counts.starts_s)
        self._late = wanted + 1 - count
        return FrameCounts.join(parts, self._inputs)[:wanted]


@dataclass(frozen=True)
class _RecordedScene:
    """A scene as its pass was counted while it was recorded, counts/s."""

    scene: Scene
    on_rate: float
    off_rate: float
    masks_rate: float  # in the masks' frames, of all detectors
    lit: bool  # True if all-ON frames are brighter than the all-OFF one, by more than chance

    def __str__(self) -> str:
        return (
            f"{self.scene.name}: {self.masks_rate:.4g} counts/s in the masks' frames, all ON "
            f"{self.on_rate:.4g}, all OFF {self.off_rate:.4g}{'' if self.lit else ': NO LIGHT'}"
        )

    @classmethod
    def of(cls, scene: Scene, counts: np.ndarray, times: np.ndarray, manifest: Manifest) -> Self:
        """Scene by counts (F, inputs) of its pass's frames but the last, and their times (F,)."""
        arm = counts[:, manifest.arm]
        on = arm[[0, -1]].sum()
        on_s = times[[0, -1]].sum()
        off = arm[OFF].sum()
        off_s = times[OFF]
        masks = manifest.shown
        return cls(
            scene=scene,
            on_rate=float(on / on_s),
            off_rate=float(off / off_s),
            masks_rate=float(counts[masks].sum() / times[masks].sum()),
            lit=bool(excess_chance(on, on_s, off, off_s) < NO_LIGHT),
        )


def record_run(
    folder: Path,
    patterns: Patterns,
    acquisition: Acquisition,
    setup: Setup[PassProjector],
    report: Progress | None = None,
) -> Generator[_RecordedScene]:
    """Show and record scene after scene; gives each when its pass has ended."""
    acquisition.check_fixed(folder)
    manifest = patterns.manifest
    room = manifest.picture_s - acquisition.settle_s
    lengths = np.maximum(room - margin_ns(room * 1e9) * 1e-9, 0)
    lengths[-1] = 0  # nothing ends the gate of the last frame before the next pass
    gates = FrameGates(
        np.full(len(lengths), acquisition.settle_s),
        lengths,
        np.ones(len(lengths), np.int64),
        manifest.picture_s,
    )
    done = 0
    with ExitStack() as stack:
        stack.enter_context(setup.projector)
        stack.enter_context(setup.counter)
        with progress_bar(report, "loading the frames") as loading:
            setup.projector.load(patterns, loading)
        prepared = Recording.prepare(folder, patterns, acquisition)
        setup.counter.start(folder / "photons.ptu")
        frames = _CountedFrames(setup.counter, manifest.inputs)
        try:
            for index, scene in enumerate(acquisition.scenes):
                setup.display(index)
                setup.counter.expect(gates)
                setup.projector.run()
                setup.projector.wait()
                counts = frames.take(len(gates) - 1, PATIENCE_S, " of their pass").counts
                recorded = _RecordedScene.of(scene, counts, gates.lengths_s[:-1], manifest)
                done = index + 1
                note_saved_work("finished scenes are kept")
                yield recorded
            setup.counter.stop()
        finally:
            if 0 < done < len(acquisition.scenes):
                prepared.keep_first(done)

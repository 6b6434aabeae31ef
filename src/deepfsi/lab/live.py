"""Runs: a projector shows, and a counter counts, scene after scene.

A live run decides what is shown next. Each list of frames ends with the all-OFF frame, which stays
while the next list is chosen: its marker ends the last gate, and the detector rests.

A recorded run shows every frame for each scene, and its photon file is counted afterwards. Frames
are also counted while it is written, so that a missing marker or a dark scene is said at once.
"""

import time
from collections.abc import Generator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

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
from deepfsi.counting.streaming import FrameGates
from deepfsi.designfile.provenance import was_trained_on
from deepfsi.lab.design_data import shown_design
from deepfsi.lab.devices import (
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

PATIENCE_S = 5.0
"""Time by which counts may come later than their frames end, seconds."""


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
        Patterns of a folder, with their design.
    scenes : tuple of Scene
    exposure_s : float
        Seconds that the looks at a scene take together.
    shortest_s : float, optional
        Shortest time for which a frame is counted, seconds. Default: the device's.
    photons : float, optional
        Budget of an exposure, counts. Default: measured by the all-ON frames.
    until : float, optional
        Exposures that reach this probability end early. Default: the design's.
    dead_time : DeadTime
        Dead time of the counter, which is corrected.
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
            from deepfsi.design.design import Design
            from deepfsi.lab.adaptive_looks import AdaptiveLooks
        if until is not None and not 0 < until < 1:
            raise InputError(f"confidence {until!r} is not allowed: give `until` between 0 and 1")
        self.patterns = patterns
        manifest = patterns.manifest
        folder = patterns.folder
        assert folder is not None
        if manifest.looks is None:
            raise InputError(
                f"{folder} has the patterns of a design whose masks are known before: learn one of "
                '`design="adaptive"` masks, or record it with `deepfsi camera simulate` or '
                "`import`"
            )
        self.looks = AdaptiveLooks(Design.load(shown_design(folder, manifest)), manifest)
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
    """Shortest gate of a run, ns; `InputError` where the device cannot show the looks (K,)."""
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

    def count(self, asked: FrameList) -> np.ndarray:
        """Counts (F, inputs) of the frames of a list, which are shown."""
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
        us = (asked.gate_ns + margin_ns(asked.gate_ns)) * 1e-3 + device.settle_us
        if asked.look < 0:
            us = np.array([self._manifest.frames[index].picture_us for index in asked.frames])
        return np.array([device.whole_us(each) for each in (*us.tolist(), 0.0)]) * 1e-6


class _CountedFrames:
    """Counts of frames as a counter gives them, list after list.

    The frame after a list's own, which ends the last gate, is left out: its count may come late.
    """

    def __init__(self, counter: StreamingCounter, inputs: int) -> None:
        self._counter = counter
        self._inputs = inputs
        self._late = 0  # frames of earlier lists whose counts are still to come

    def take(self, wanted: int, limit_s: float, since: str = "") -> np.ndarray:
        """Counts (F, inputs) of the next frames; `since` says in a fault when the time begins."""
        until = time.monotonic() + limit_s
        parts = [np.zeros((0, self._inputs), np.int64)]
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
            count += len(counts)
        self._late = wanted + 1 - count
        return np.concatenate(parts)[:wanted]


def _light_text(counts: np.ndarray, times: np.ndarray, manifest: Manifest) -> str:
    """Light of a pass, by counts (F, inputs) of its frames but the last, and their times (F,)."""
    arm = counts[:, manifest.arm]
    on = arm[[0, -1]].sum()
    on_s = times[[0, -1]].sum()
    off = arm[OFF].sum()
    off_s = times[OFF]
    masks = manifest.shown
    rate = counts[masks].sum() / times[masks].sum()
    # All-ON frames are brighter than the all-OFF one by no more than chance
    dark = excess_chance(on, on_s, off, off_s) >= NO_LIGHT
    return (
        f"{rate:.4g} counts/s in the masks' frames, all ON {on / on_s:.4g}, all OFF "
        f"{off / off_s:.4g}{': NO LIGHT' if dark else ''}"
    )


def record_run(
    folder: Path,
    patterns: Patterns,
    acquisition: Acquisition,
    setup: Setup[PassProjector],
    report: Progress | None = None,
) -> Generator[str]:
    """Show and record scene after scene; says the light of each when its pass has ended."""
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
                counts = frames.take(len(gates) - 1, PATIENCE_S, " of their pass")
                done = index + 1
                note_saved_work("finished scenes are kept")
                yield f"{scene.name}: {_light_text(counts, gates.lengths_s[:-1], manifest)}"
            setup.counter.stop()
        finally:
            if 0 < done < len(acquisition.scenes):
                prepared.keep_first(done)

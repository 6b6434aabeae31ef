"""Runs: a projector shows, and a counter counts, scene after scene, until all are shown.

A live run decides on what is shown next. Each of its lists of frames ends with the all-OFF frame,
which stays while the next list is chosen: its marker ends the last gate, and the detector rests.

A recorded run shows a pass of all frames for each scene. Its photon file is counted afterwards, as
any. While it is written frames are counted, too, so that a missing marker or a scene without light
is said at once, and not when all scenes are shown.
"""

import math
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepfsi.base import (
    GrowingFile,
    InputError,
    Progress,
    as_input_error,
    note_saved_work,
    progress_bar,
)
from deepfsi.camera import MARGIN_NS, NO_DEAD_TIME, DeadTime, LiveSettings, StopRule, margin_ns
from deepfsi.hardware.counting import Acquisition, FrameCounts, FrameGates, Scene, prepare_run
from deepfsi.hardware.drivers import (
    PATIENCE_S,
    PassProjector,
    Setup,
    StreamingCounter,
    StreamingProjector,
)
from deepfsi.hardware.light import NO_LIGHT, excess_chance
from deepfsi.hardware.live import shown
from deepfsi.hardware.live.decisions import OFF, Decision, Observer
from deepfsi.hardware.live.known import read_looks
from deepfsi.hardware.live.looks import FrameList
from deepfsi.hardware.patterns.folder import read_patterns
from deepfsi.hardware.patterns.mirrors import make_frame
from deepfsi.hardware.patterns.sequence import Manifest
from deepfsi.lab.results import LiveScene


@dataclass(frozen=True)
class Decided:
    """A decision, and when it fell."""

    scene: int
    decision: Decision | None  # none where a scene had no light
    clock_s: float  # after the scene's first command, seconds
    answer: LiveScene | None = None  # after the last look


def plan_live(
    patterns_folder: Path,
    scenes: tuple[Scene, ...],
    exposure_s: float,
    shortest_s: float | None = None,
    photons: float | None = None,
    until: float | None = None,
    dead_time: DeadTime = NO_DEAD_TIME,
    background: bool = False,
    **others: object,
) -> Acquisition:
    """Settings of a live run of the patterns in a folder."""
    manifest = read_patterns(patterns_folder).manifest
    if manifest.looks is None:
        raise InputError(
            f"{patterns_folder} has the patterns of a design of fixed dwells: learn one of several "
            "`looks`, or record it with `deepfsi camera simulate` or `prepare`"
        )
    if not (math.isfinite(exposure_s) and exposure_s > 0):
        raise InputError(f"exposure {exposure_s!r} is not allowed: give seconds above 0")
    if photons is not None and not (math.isfinite(photons) and photons > 0):
        raise InputError(f"photons {photons!r} is not allowed: give a number above 0")
    if background and manifest.looks.adaptive:
        raise InputError(
            "adaptive masks are not known before, and a `background` is measured mask by mask: "
            "keep ambient light out, and leave it out"
        )
    looks = read_looks(patterns_folder, manifest)
    rule = _find_rule(looks.rule, until)
    looks_s = exposure_s * np.array(looks.shares)
    shortest_ns = _shortest_gate(manifest, looks_s, shortest_s)
    shortest_ns = max(shortest_ns, round(looks.shortest * exposure_s * 1e9))
    with as_input_error():
        return Acquisition(
            scenes=scenes,
            exposure_s=exposure_s,
            settle_s=manifest.device.settle_us * 1e-6,
            repeats=1,
            live=LiveSettings(
                shortest_ns=shortest_ns,
                photons=photons,
                rule=rule,
                dead_time=dead_time,
                background=background,
            ),
            **{"inputs": tuple(range(manifest.inputs)), **others},
        )


def _find_rule(own: StopRule | None, until: float | None) -> StopRule | None:
    """Rule of a run: the design's own, or one of a confidence, for any budget."""
    if until is None:
        return own
    if not 0 < until < 1:
        raise InputError(f"confidence {until!r} is not allowed: give `until` between 0 and 1")
    return StopRule(threshold=until)


def _shortest_gate(manifest: Manifest, looks_s: np.ndarray, shortest_s: float | None) -> int:
    """Shortest gate of a run, ns, for looks of some lengths (K,)."""
    device = manifest.device
    if device.video_us is not None:
        raise InputError(
            f"{device.name} shows all frames for one time, and looks choose theirs: export for a "
            "device that stores frames, such as dlp7000"
        )
    look_s, look_ns = float(looks_s.min()), np.array(looks_s.max() * 1e9)
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


def run_live(
    folder: Path, patterns_folder: Path, acquisition: Acquisition, setup: Setup[StreamingProjector]
) -> Generator[Decided]:
    """Show, count and decide; gives each decision as it falls."""
    # The folder, new or empty, is as that of any acquisition, with `shown.jsonl` in it. Scenes that
    # are finished are kept whenever the run is stopped. The settings are those of `plan_live`; the
    # devices are taken hold of, and let go at the end
    assert acquisition.live is not None
    live = acquisition.live.model_copy(update={"latencies": setup.latencies})
    acquisition = acquisition.model_copy(update={"live": live})
    patterns = read_patterns(patterns_folder)
    looks = read_looks(patterns_folder, patterns.manifest)
    observer = Observer(looks, patterns.manifest, acquisition)
    with ExitStack() as stack:
        stack.enter_context(setup.projector)
        stack.enter_context(setup.counter)
        setup.projector.load(patterns_folder)
        prepare_run(folder, patterns_folder, acquisition)
        setup.counter.start(folder / "photons.ptu")
        show = _Sequencer(setup, patterns.manifest, acquisition)
        record = stack.enter_context(GrowingFile(folder / shown.NAME))
        if live.background:
            setup.display(shown.DARK)
            _measure(setup.clock, observer, show, record)
        for place, scene in enumerate(acquisition.scenes):
            setup.display(place)
            yield from _look(place, scene, setup.clock, observer, show, record)
        setup.counter.stop()


def _measure(
    clock: Callable[[], float], observer: Observer, show: "_Sequencer", record: GrowingFile
) -> None:
    """Measure the masks' own background, and record what was shown for it."""
    start = clock()
    observer.measure_background(show)
    line = shown.ShownScene(
        scene=shown.DARK,
        first_marker=0,
        lists=tuple(show.lists),
        chances=(),
        light_s=0.0,
        clock_s=clock() - start,
    )
    record.write(f"{line.model_dump_json()}\n".encode())


def _look(
    place: int,
    scene: Scene,
    clock: Callable[[], float],
    observer: Observer,
    show: "_Sequencer",
    record: GrowingFile,
) -> Iterator[Decided]:
    """Decide on a scene; its line is in the record before the last decision is given."""
    start, show.lists, first, last = clock(), [], show.markers, None
    for last in observer.observe(place, show):
        if not last.final:
            yield Decided(place, last, clock() - start)
    clock_s = clock() - start
    finished = shown.ShownScene(
        scene=place,
        first_marker=first,
        lists=tuple(show.lists),
        chances=() if last is None else tuple(last.chances.tolist()),
        faults=() if last is None else last.faults,
        light_s=0.0 if last is None else last.light_s,
        clock_s=clock_s,
    )
    record.write(f"{finished.model_dump_json()}\n".encode())
    note_saved_work("finished scenes are kept")
    answer = LiveScene.of(scene, last, observer.looks, clock_s)
    yield Decided(place, last, clock_s, answer)


class _Sequencer:
    """Shows list after list of frames, and gives the counts of each."""

    def __init__(
        self, setup: Setup[StreamingProjector], manifest: Manifest, acquisition: Acquisition
    ) -> None:
        self._setup, self._manifest = setup, manifest
        self._settle_s = acquisition.settle_s
        self._counted = _CountedFrames(setup.counter, manifest.inputs)
        self.lists: list[shown.ShownList] = []
        self.markers = 0

    def __call__(self, asked: FrameList) -> FrameCounts:
        projector, counter = self._setup.projector, self._setup.counter
        if asked.masks is not None:
            manifest = self._manifest
            for place, mask in zip(asked.frames, asked.masks, strict=True):
                frame = make_frame(mask, manifest.device, manifest.grid)
                projector.replace(int(place), frame)
        gates_s = np.append(asked.gate_ns, 0) * 1e-9
        frames = np.append(asked.frames, OFF)
        pictures_s = self._pictures(asked)
        markers, each_s = projector.pictures(pictures_s)
        offsets_s = np.full(len(frames), self._settle_s)
        counter.expect(FrameGates(offsets_s, gates_s, markers, each_s))
        projector.show(frames, pictures_s)
        limit_s = float(pictures_s.sum()) + PATIENCE_S
        counts = self._counted.take(len(asked.frames), limit_s)
        self.lists.append(
            shown.ShownList(
                look=asked.look,
                frames=tuple(asked.frames.tolist()),
                gate_ns=tuple(asked.gate_ns.tolist()),
                markers=tuple(markers.tolist()),
                masks=shown.packed(asked.masks),
            )
        )
        self.markers += int(markers.sum())
        return counts

    def _pictures(self, asked: FrameList) -> np.ndarray:
        """Times for which frames, and the all-OFF one after them, are held, whole µs in seconds."""
        device = self._manifest.device
        us = np.ceil((asked.gate_ns + margin_ns(asked.gate_ns)) * 1e-3 + device.settle_us)
        if asked.look < 0:
            us = np.array([self._manifest.frames[place].picture_us for place in asked.frames])
        return np.append(np.maximum(us, device.shortest_us), device.shortest_us) * 1e-6


class _CountedFrames:
    """Counts of frames as a counter gives them, list after list.

    The frame after a list's own, which ends the last gate, is left out: its count may come late.
    """

    def __init__(self, counter: StreamingCounter, inputs: int) -> None:
        self._counter, self._inputs = counter, inputs
        self._late = 0  # frames of earlier lists whose counts are still to come

    def take(self, wanted: int, limit_s: float, since: str = "") -> FrameCounts:
        """Counts of the next frames, within a time; `since` says in a fault when it begins."""
        until, parts, count = time.monotonic() + limit_s, [], -self._late
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
class RecordedScene:
    """A scene as its pass was counted while it was recorded, counts/s."""

    scene: Scene
    on_rate: float  # in the all-ON frames, of the detectors that see mirrors ON
    off_rate: float  # in the first all-OFF frame, of the same
    masks_rate: float  # in the masks' frames, of all detectors
    lit: bool  # whether all-ON frames are brighter than the all-OFF one, by more than chance


def record_run(
    folder: Path,
    patterns_folder: Path,
    acquisition: Acquisition,
    setup: Setup[PassProjector],
    report: Progress | None = None,
) -> Generator[RecordedScene]:
    """Show and record scene after scene; gives each when its pass has ended.

    Parameters
    ----------
    folder : path
        Of the run, new. Scenes that are finished are kept whenever the run is stopped, and the
        folder then has these alone.
    patterns_folder : path
        Patterns that are shown.
    acquisition : Acquisition
        Settings of the run, as `plan_acquisition` makes them.
    setup : Setup
        Devices; taken hold of, and let go at the end.
    report : callable, optional
        Told of the share of frames that is loaded; a bar on the terminal unless given.

    Yields
    ------
    RecordedScene
        Each when its pass has ended.

    Raises
    ------
    InputError
        If the patterns choose their dwells, or a device fails.
    """
    acquisition.check_fixed(folder)
    manifest = read_patterns(patterns_folder).manifest
    done = 0
    with ExitStack() as stack:
        stack.enter_context(setup.projector)
        stack.enter_context(setup.counter)
        with progress_bar(report, "loading the frames") as loading:
            setup.projector.load(patterns_folder, loading)
        prepared = prepare_run(folder, patterns_folder, acquisition)
        setup.counter.start(folder / "photons.ptu")
        show = _Passes(setup.projector, setup.counter, manifest, acquisition.settle_s)
        try:
            for place, scene in enumerate(acquisition.scenes):
                setup.display(place)
                counted = show(scene)
                done = place + 1
                note_saved_work("finished scenes are kept")
                yield counted
            setup.counter.stop()
        finally:
            if 0 < done < len(acquisition.scenes):
                prepared.keep_first(folder, done)


class _Passes:
    """Shows one pass after another, and counts its frames."""

    def __init__(
        self,
        projector: PassProjector,
        counter: StreamingCounter,
        manifest: Manifest,
        settle_s: float,
    ) -> None:
        self._projector, self._counter, self._manifest = projector, counter, manifest
        self._frames = _CountedFrames(counter, manifest.inputs)
        room = manifest.picture_s - settle_s
        lengths = np.maximum(room - margin_ns(room * 1e9) * 1e-9, 0)
        lengths[-1] = 0  # nothing ends the gate of the last frame before the next pass
        ones = np.ones(len(lengths), np.int64)
        offsets = np.full(len(lengths), settle_s)
        self._gates = FrameGates(offsets, lengths, ones, manifest.picture_s)

    def __call__(self, scene: Scene) -> RecordedScene:
        self._counter.expect(self._gates)
        self._projector.run()
        self._projector.wait()
        counts = self._frames.take(len(self._gates) - 1, PATIENCE_S, " of their pass").counts
        times, masks = self._gates.lengths_s[:-1], self._manifest.shown
        arm = counts[:, : self._manifest.detector_count]  # those that see mirrors ON
        on, on_s = arm[[0, -1]].sum(), times[[0, -1]].sum()
        off, off_s = arm[1].sum(), times[1]
        return RecordedScene(
            scene=scene,
            on_rate=float(on / on_s),
            off_rate=float(off / off_s),
            masks_rate=float(counts[masks].sum() / times[masks].sum()),
            lit=bool(excess_chance(on, on_s, off, off_s) < NO_LIGHT),
        )

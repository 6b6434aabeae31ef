"""Runs: a projector shows, and a counter counts, scene after scene.

A live run decides what is shown next. Each list of frames ends with the all-OFF frame, which stays
while the next list is chosen: its marker ends the last gate, and the detector rests.

A recorded run shows every frame for each scene, and its photon file is counted afterwards. Frames
are also counted while it is written, so that a missing marker or a dark scene is said at once.
"""

import time
from base64 import b64encode
from collections.abc import Generator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.files import GrowingFile
from deepfsi.base.interrupts import note_saved_work
from deepfsi.base.progress import Progress, progress_bar
from deepfsi.camera.dead_time import NO_DEAD_TIME, DeadTime
from deepfsi.counting.acquisition import Acquisition, LiveSettings, Scene, StopRule
from deepfsi.counting.checks import NO_LIGHT
from deepfsi.counting.flux import excess_p_value
from deepfsi.counting.recording import Recording
from deepfsi.counting.streaming import FrameGates
from deepfsi.designfile.provenance import was_trained_on
from deepfsi.lab.design_data import open_design, shown_design
from deepfsi.lab.devices import Setup, StreamingCounter
from deepfsi.lab.results import LOG, MARGIN_NS, OFF, Decision, FrameList, LoggedList, LoggedScene
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.frames import make_frame
from deepfsi.patterns.manifest import Manifest

PATIENCE_S = 5.0
"""Time by which counts may come later than their frames end, seconds."""


class LiveRun:
    """A live run: a design of adaptive masks, its patterns, and the settings.

    Parameters
    ----------
    patterns : Patterns
        Patterns of a folder, with their design.
    scenes : tuple of Scene
    exposure_s : float
        Seconds that the looks at a scene take together.
    until : float, optional
        Exposures that reach this probability end early. Default: the design's.
    dead_time : DeadTime
        Dead time of the counter, which is corrected.
    **others
        Fields of the `Acquisition`.
    """

    def __init__(
        self,
        patterns: Patterns,
        scenes: tuple[Scene, ...],
        exposure_s: float,
        *,
        until: float | None = None,
        dead_time: DeadTime = NO_DEAD_TIME,
        **fields: object,
    ) -> None:
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
        self.design = open_design(shown_design(folder, manifest))
        exposure = self.design.prior_exposure
        threshold = exposure.settings.until if until is None else until
        looks_s = exposure_s * np.array(exposure.settings.shares)
        # Time of a decision, by `benchmarks/adaptive.py --latency` with 8192 and 60 000 scenes, and
        # with `--dictionary 2000`, where counts and light take most of it
        self.decision_s = 4e-3 + 1.35e-7 * len(exposure.prior)
        if manifest.looks.dictionary:
            self.decision_s = 0.5e-3 + 5e-9 * len(exposure.prior)
        with as_input_error():
            self.settings = Acquisition(
                scenes=scenes,
                exposure_s=exposure_s,
                settle_s=manifest.device.settle_us * 1e-6,
                repeats=1,
                live=LiveSettings(
                    shortest_ns=_shortest_gate(manifest, looks_s),
                    rule=None if threshold == 1 else StopRule(threshold=threshold),
                    dead_time=dead_time,
                ),
                **{"inputs": tuple(range(manifest.inputs)), **fields},
            )

    def steps(self, folder: Path, setup: Setup) -> Generator[Decision]:
        """Show, count and decide with devices, and let go of them at the end.

        Yields each decision; the last one of a scene has its answer. Finished scenes stay in
        `folder`, which is new, whenever the run is stopped: a scene's line is in `shown.jsonl`
        before its last decision is yielded.
        """
        from deepfsi.lab.observer import SceneObserver

        design = self.design
        assert self.settings.live is not None
        live = self.settings.live.model_copy(update={"latencies": setup.latencies})
        settings = self.settings.model_copy(update={"live": live})
        manifest = self.patterns.manifest
        observer = SceneObserver(design, manifest, settings)
        with ExitStack() as stack:
            stack.enter_context(setup.projector)
            stack.enter_context(setup.counter)
            setup.projector.load(self.patterns)
            Recording.prepare(folder, self.patterns, settings)
            setup.counter.start(folder / "photons.ptu")
            log = stack.enter_context(GrowingFile(folder / LOG))
            frames = _DeviceFrames(setup, manifest, settings.settle_s)
            for number, scene in enumerate(settings.scenes):
                setup.display(number)
                frames.lists = []
                first_marker = frames.markers
                start_s = setup.clock()
                for step in observer.observe(number, frames.count):
                    decision = replace(step, clock_s=setup.clock() - start_s)
                    if not decision.final:
                        yield decision
                logged = LoggedScene(
                    scene=number,
                    first_marker=first_marker,
                    lists=tuple(frames.lists),
                    chances=tuple(decision.probabilities.tolist()),
                    faults=decision.faults,
                    light_s=decision.light_s,
                    clock_s=decision.clock_s,
                )
                log.write(f"{logged.model_dump_json()}\n".encode())
                note_saved_work("finished scenes are kept")
                [trained] = was_trained_on(design.training_scenes, [scene.hash])
                tested = observer.test.usual is not None
                answer = logged.answer(scene, design.classes, trained, tested)
                yield replace(decision, answer=replace(answer, photons=decision.photons))
            setup.counter.stop()


def _margin_ns(gate_ns: np.ndarray | float) -> Any:
    """Time by which pictures outlast their gates, ns: clocks may differ by a share of it."""
    return np.maximum(MARGIN_NS, 2e-4 * gate_ns)


def _shortest_gate(manifest: Manifest, looks_s: np.ndarray) -> int:
    """Shortest gate of a run, ns; `InputError` if the device cannot show the looks (K,)."""
    device = manifest.device
    shortest_ns = device.shortest_us * 1000 - round(device.settle_us * 1000) - MARGIN_NS
    shortest_ns = max(shortest_ns, 1)
    longest_ns = looks_s.max() * 1e9
    longest_us = (longest_ns + _margin_ns(longest_ns)) * 1e-3 + device.settle_us
    if looks_s.min() * 1e9 < shortest_ns or longest_us > device.longest_us:
        raise InputError(
            f"looks of {looks_s.min():.3g} to {looks_s.max():.3g} s do not fit {device.name}, "
            f"which shows a mask for {shortest_ns * 1e-9:.3g} to {device.longest_us * 1e-6:.3g} s: "
            "give another `exposure`"
        )
    return shortest_ns


class _DeviceFrames:
    """Frames of a live run, shown and counted by devices list after list."""

    def __init__(self, setup: Setup, manifest: Manifest, settle_s: float) -> None:
        self.lists: list[LoggedList] = []  # of the scene
        self.markers = 0  # of all lists so far
        self._setup = setup
        self._manifest = manifest
        self._settle_s = settle_s
        self._counted = _CountedFrames(setup.counter, manifest.inputs)

    def count(self, asked: FrameList) -> np.ndarray:
        """Show the frames of a list, and give their counts (F, inputs)."""
        projector = self._setup.projector
        if asked.masks is not None:
            manifest = self._manifest
            for frame, mask in zip(asked.frames, asked.masks, strict=True):
                projector.replace(int(frame), make_frame(mask, manifest.device, manifest.grid))
        frames = np.append(asked.frames, OFF)
        gates_s = np.append(asked.gate_ns, 0) * 1e-9
        pictures_s = self._pictures_s(asked)
        markers, markers_s = projector.pictures(pictures_s)
        gates = FrameGates(np.full(len(frames), self._settle_s), gates_s, markers, markers_s)
        self._setup.counter.expect(gates)
        projector.show(frames, pictures_s)
        limit_s = float(pictures_s.sum()) + PATIENCE_S
        counts = self._counted.take(len(asked.frames), limit_s)
        packed = () if asked.masks is None else np.packbits(asked.masks, axis=1)
        self.lists.append(
            LoggedList(
                look=asked.look,
                frames=tuple(asked.frames.tolist()),
                gate_ns=tuple(asked.gate_ns.tolist()),
                markers=tuple(markers.tolist()),
                masks=tuple(b64encode(bits.tobytes()).decode() for bits in packed),
            )
        )
        self.markers += int(markers.sum())
        return counts

    def _pictures_s(self, asked: FrameList) -> np.ndarray:
        """Picture times (F + 1,) of frames and the all-OFF one after them, whole µs in seconds."""
        device = self._manifest.device
        us = (asked.gate_ns + _margin_ns(asked.gate_ns)) * 1e-3 + device.settle_us
        if asked.look < 0:  # all-ON and all-OFF frames last as exported
            us = np.array([self._manifest.frames[index].picture_us for index in asked.frames])
        return np.array([device.whole_us(time_us) for time_us in (*us.tolist(), 0.0)]) * 1e-6


class _CountedFrames:
    """Counts of a counter, list after list.

    The all-OFF frame after a list ends the last gate; its count may come late, and is left out.
    """

    def __init__(self, counter: StreamingCounter, inputs: int) -> None:
        self._counter = counter
        self._inputs = inputs
        self._late = 0  # frames of earlier lists whose counts are still to come

    def take(self, wanted: int, limit_s: float, since: str = "") -> np.ndarray:
        """Counts (F, inputs) of the next frames; `since` completes the message of a timeout."""
        until = time.monotonic() + limit_s
        blocks = [np.zeros((0, self._inputs), np.int64)]
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
            blocks.append(counts[max(-count, 0) :])
            count += len(counts)
        # the all-OFF frame's count is still due, or came already
        self._late = wanted + 1 - count
        return np.concatenate(blocks)[:wanted]


def _light_text(counts: np.ndarray, times: np.ndarray, manifest: Manifest) -> str:
    """Words for the light of a pass: counts (F, inputs) and times (F,) lack its last frame."""
    arm = counts[:, manifest.on_inputs].sum(axis=1)
    (on, off), (on_s, off_s) = ((values[0] + values[-1], values[OFF]) for values in (arm, times))
    # All-ON frames are brighter than the all-OFF one by no more than chance
    dark = excess_p_value(on, on_s, off, off_s) >= NO_LIGHT
    text = f"{on / on_s:.4g} counts/s with all mirrors ON, {off / off_s:.4g} with all OFF"
    return f"{text}{': NO LIGHT' if dark else ''}"


def record_run(
    folder: Path,
    patterns: Patterns,
    acquisition: Acquisition,
    setup: Setup,
    report: Progress | None = None,
) -> Generator[str]:
    """Show and record scene after scene; yields words for the light of each pass."""
    acquisition.check_fixed(folder)
    manifest = patterns.manifest
    room = manifest.picture_s - acquisition.settle_s
    lengths = np.maximum(room - _margin_ns(room * 1e9) * 1e-9, 0)
    lengths[-1] = 0  # nothing ends the gate of the last frame before the next pass
    gates = FrameGates.of(acquisition.settle_s, lengths)
    gates = replace(gates, pictures_s=manifest.picture_s)
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
            # a run that is stopped keeps its finished scenes
            if 0 < done < len(acquisition.scenes):
                prepared.keep_first(done)

"""A recorded run: a projector shows a pass of all frames for each scene, and a counter records.

The photon file is counted afterwards, as any. While it is written frames are counted, too, so that
a missing marker or a scene without light is said at once, and not when all scenes are shown.
"""

import time
from collections.abc import Generator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepfsi.base import interrupts, progress
from deepfsi.base.errors import InputError
from deepfsi.base.progress import Report
from deepfsi.camera.stop_rule import margin_ns
from deepfsi.hardware.counting.acquisition import (
    Acquisition,
    Scene,
    check_fixed,
    keep_first,
    prepare,
)
from deepfsi.hardware.counting.streaming import FrameGates
from deepfsi.hardware.drivers import PATIENCE_S, PassProjector, Setup, StreamingCounter
from deepfsi.hardware.light import NO_LIGHT, excess_chance
from deepfsi.hardware.patterns.folder import read_patterns
from deepfsi.hardware.patterns.sequence import Manifest


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
    report: Report | None = None,
) -> Generator[RecordedScene]:
    """Show and record scene after scene; gives each when its pass has ended."""
    # The folder is new. Scenes that are finished are kept whenever the run is stopped, and the
    # folder then has these alone
    check_fixed(acquisition, folder)
    manifest, done = read_patterns(patterns_folder).manifest, 0
    with ExitStack() as stack:
        stack.enter_context(setup.projector)
        stack.enter_context(setup.counter)
        with progress.shown(report, "loading the frames") as loading:
            setup.projector.load(patterns_folder, loading)
        prepared = prepare(folder, patterns_folder, acquisition)
        setup.counter.start(folder / "photons.ptu")
        show = _Passes(setup.projector, setup.counter, manifest, acquisition.settle_s)
        try:
            for place, scene in enumerate(acquisition.scenes):
                setup.display(place)
                counted = show(scene)
                done = place + 1
                interrupts.keep("finished scenes are kept")
                yield counted
            setup.counter.stop()
        finally:
            if 0 < done < len(acquisition.scenes):
                keep_first(folder, prepared, done)


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
        room = manifest.picture_s - settle_s
        lengths = np.maximum(room - margin_ns(room * 1e9) * 1e-9, 0)
        lengths[-1] = 0  # nothing ends the gate of the last frame before the next pass
        ones = np.ones(len(lengths), np.int64)
        offsets = np.full(len(lengths), settle_s)
        self._gates = FrameGates(offsets, lengths, ones, manifest.picture_s)
        self._found = np.zeros((0, manifest.inputs), np.int64)
        self._rest = 0  # last frame of the pass before, whose count may still come

    def __call__(self, scene: Scene) -> RecordedScene:
        self._counter.expect(self._gates)
        self._projector.run()
        self._projector.wait()
        counts = self._take(len(self._gates) - 1)
        times, shown = self._gates.lengths_s[:-1], self._manifest.shown
        arm = counts[:, : self._manifest.detector_count]  # those that see mirrors ON
        ends = [(arm[at].sum(), times[at].sum()) for at in ([0, -1], [1])]
        on, off = (float(found / seconds) for found, seconds in ends)
        lit = bool(excess_chance(*ends[0], *ends[1]) < NO_LIGHT)
        return RecordedScene(scene, on, off, float(counts[shown].sum() / times[shown].sum()), lit)

    def _take(self, frames: int) -> np.ndarray:
        """Counts (F - 1, inputs) of the frames of a pass but its last."""
        wanted, until = self._rest + frames, time.monotonic() + PATIENCE_S
        while len(self._found) < wanted:
            left = until - time.monotonic()
            if left <= 0:
                raise InputError(
                    f"counts of {wanted - len(self._found)} of {frames} frames did not come within "
                    f"{PATIENCE_S:g} s of their pass: check that the device's trigger is wired to "
                    "the counter and that it records"
                )
            came = self._counter.counts_since_marker(left).counts
            self._found = np.concatenate([self._found, came])
        taken = self._found[self._rest : wanted]
        self._found, self._rest = self._found[wanted:], 1
        return taken

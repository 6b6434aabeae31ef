"""Devices of a run: protocols of projector and counter, and virtual ones.

Projector and counter are context managers that always let go of their device, on Ctrl-C, too.
Virtual devices do not wait: each step sets their clock on by its duration. They write photons and
markers to a PTU file, and read counts from it while it grows.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import lru_cache
from io import FileIO
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from deepfsi.base.progress import SILENT, Progress
from deepfsi.counting.acquisition import Acquisition
from deepfsi.counting.events import PtuWriter
from deepfsi.counting.streaming import FrameCounter, FrameGates
from deepfsi.lab.virtual_detector import DETECTOR_TICK_S
from deepfsi.lab.virtual_optics import (
    FRAME_MARKER,
    EventRecorder,
    MirrorLight,
    VirtualCamera,
    arrival_rates,
    check_scenes,
)
from deepfsi.patterns.folder import Patterns


class _Projector(AbstractContextManager["_Projector"], Protocol):
    """Micromirror device; entering takes hold of it, leaving stops it and lets go of it."""

    def load(self, patterns: Patterns, report: Progress = SILENT) -> None:
        """Bring the frames of patterns into the device, in place of earlier ones."""


class StreamingProjector(_Projector, Protocol):
    """Device that holds frames and shows lists of them; each picture gives a marker."""

    def replace(self, frame: int, packed: np.ndarray) -> None:
        """Replace a loaded frame by packed bits (rows, bytes), while no list is shown."""

    def pictures(self, dwells_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Number of pictures (F,) that show each frame, and seconds (F,) of a picture."""

    def show(self, frames: np.ndarray, dwells_s: np.ndarray) -> None:
        """Show frames, indices (F,) in the folder, after the last list; may return early.

        Each is held for its seconds (F,) or longer with settling, the last until the next list.
        """


class PassProjector(_Projector, Protocol):
    """Device that shows passes; frames begin with a marker, and have the times of the manifest."""

    def run(self) -> None:
        """Start one pass; may return before its end."""

    def wait(self) -> None:
        """Return when the pass has ended."""


class StreamingCounter(AbstractContextManager["StreamingCounter"], Protocol):
    """Photon-counting electronics that count frame by frame while they record.

    Entering takes hold of the device; leaving stops the recording and lets go of the device.
    Counts are of the photons in the recorded file.
    """

    def start(self, path: Path) -> None:
        """Begin to record into a new file."""

    def expect(self, gates: FrameGates) -> None:
        """Tell the gates of the frames that are shown next, before they are shown."""

    def counts_since_marker(self, timeout_s: float) -> np.ndarray:
        """Counts (F, inputs) of frames whose gates have ended since the last call, in order.

        Waits for one; after the timeout there may be none. Raises `InputError` if a marker came
        that starts no frame told, or the gate of the frame before had not ended.
        """

    def stop(self) -> None:
        """End the recording; its file is then whole."""


@dataclass(frozen=True)
class Setup:
    """Devices of a run, and who shows its scenes."""

    projector: Any  # `StreamingProjector` of a live run, `PassProjector` of a recorded one
    counter: StreamingCounter
    display: Callable[[int], None]  # shows a scene by its number; returns when it has settled
    clock: Callable[[], float] = time.monotonic  # seconds
    latencies: dict[str, float] | None = None  # of each step of virtual devices, seconds


LATENCIES = {
    "load": 3.3e-3,  # of each pattern: known masks once, adaptive ones each before its look
    "display": 20e-3,  # until the display shows another scene, and it has settled
    "command": 1e-3,  # from a decision until the first frame of its list: USB, the device's start
    "block": 1e-3,  # the counter hands over its records in blocks, each so long after the last
    "transfer": 0.25e-3,  # from the end of a block until the computer has it
    "decision": 0.4e-3,  # from the counts until the next list is known, or the class
}
"""Times of the steps of a loop, seconds; docs/notebook/live-timing.md says their sources."""


class VirtualBench(AbstractContextManager["VirtualBench"]):
    """Projector of scenes on a display, and a counter that records their light into a PTU file."""

    def __init__(
        self,
        rates: np.ndarray,
        camera: VirtualCamera,
        latencies: Mapping[str, float],
        inputs: Sequence[int],
        marker_bit: int = FRAME_MARKER,
        *,
        seed: int = 0,
        rates_of: Callable[[int, np.ndarray], np.ndarray] | None = None,
    ) -> None:
        self.latencies = latencies
        # Time on the counter's clock before the first list, seconds
        self.now_s = 1e-3
        self.recorder = EventRecorder(camera, np.random.default_rng(seed), inputs)
        self._bit = marker_bit
        self._rates_of = rates_of
        self._rates = rates
        self._scene = 0
        self._frame = 1
        self._times_s = np.zeros(0)  # of the frames that are loaded
        self._file: FileIO | None = None

    def __exit__(self, *error: object) -> None:
        """End the recording; its file stays."""
        self.stop()

    def load(self, patterns: Patterns, report: Progress = SILENT) -> None:
        """Take the time that a real device needs to load each frame."""
        self._times_s = patterns.manifest.picture_s
        self.now_s += len(self._times_s) * self.latencies["load"]

    def display(self, scene: int) -> None:
        """Show a scene on the display."""
        self.now_s += self.latencies["display"]
        # light of the old scene is recorded until the new one has settled
        self._hold(round(self.now_s / DETECTOR_TICK_S))
        self._scene = scene

    def replace(self, frame: int, packed: np.ndarray) -> None:
        """Replace a frame that is not shown."""
        assert self._rates_of is not None
        self.now_s += self.latencies["load"]
        self._rates[self._scene, frame] = self._rates_of(self._scene, packed)

    def show(self, frames: np.ndarray, dwells_s: np.ndarray) -> None:
        """Show frames, and set the clock to the time at which their counts are decided upon."""
        self.now_s += self.latencies["command"]
        self._hold(round(self.now_s / DETECTOR_TICK_S))
        durations = np.rint(dwells_s / DETECTOR_TICK_S).astype(np.int64)
        marks = self.recorder.end + np.cumsum(durations) - durations
        self.recorder.add(marks, -self._bit)
        self.recorder.see(durations, self._rates[self._scene, frames])
        self._frame = int(frames[-1])
        # What came before the last frame's marker is handed over with it, in its block
        block = self.latencies["block"]
        block_end_s = math.ceil(float(marks[-1]) * DETECTOR_TICK_S / block) * block
        self.now_s = block_end_s + self.latencies["transfer"] + self.latencies["decision"]

    def pictures(self, dwells_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One picture for each frame, of its time."""
        return np.ones(len(dwells_s), np.int64), dwells_s

    def run(self) -> None:
        """Show every frame for its picture time."""
        self.show(np.arange(len(self._times_s)), self._times_s)

    def wait(self) -> None:
        """Let time pass until all that was shown is recorded."""
        self._hold(
            max(round(self.now_s / DETECTOR_TICK_S), self.recorder.end + self.recorder.reach)
        )
        self.now_s = self.recorder.end * DETECTOR_TICK_S

    def _hold(self, end: int) -> None:
        """Go on showing the last frame until a tick; past ticks do nothing."""
        ticks = max(end - self.recorder.end, 0)
        self.recorder.see(np.array([ticks]), self._rates[self._scene, [self._frame]])

    def start(self, path: Path) -> None:
        """Begin to record into a new file."""
        self.recorder.writer = PtuWriter(path, DETECTOR_TICK_S, growing=True).__enter__()
        self._file = FileIO(path)
        self._counter = FrameCounter(self.recorder.inputs, self._bit, path)

    def expect(self, gates: FrameGates) -> None:
        """Tell the gates of the frames that are shown next."""
        self._counter.expect(gates)

    def counts_since_marker(self, timeout_s: float) -> np.ndarray:
        """Counts since the last call; a virtual counter never waits."""
        assert self._file is not None
        return self._counter.feed(self._file.read())

    def stop(self) -> None:
        """End the recording; its file is then whole."""
        if self._file is not None and self.recorder.writer is not None:
            self._file.close()
            self.recorder.writer.__exit__(None, None, None)
            self._file = self.recorder.writer = None


def virtual_setup(
    patterns: Patterns,
    scenes: np.ndarray,
    acquisition: Acquisition,
    report: Progress = SILENT,
    decision_s: float | None = None,
) -> Setup:
    """Virtual devices of a run, with the camera, flux, seed and wiring of its acquisition."""
    camera = VirtualCamera.model_validate(acquisition.camera)
    manifest = patterns.manifest
    flux = acquisition.flux or 0.0
    images = check_scenes(scenes, manifest, flux)
    rates = arrival_rates(patterns, scenes, camera, flux, report=report)
    latencies = dict(LATENCIES)
    if manifest.device.load_us:
        latencies["load"] = manifest.device.load_us * 1e-6
    if decision_s is not None:
        latencies["decision"] = decision_s

    @lru_cache(maxsize=1)
    def light(scene: int) -> MirrorLight:
        return MirrorLight(manifest, images[scene][None], camera, flux)

    bench = VirtualBench(
        rates,
        camera,
        latencies,
        acquisition.inputs,
        acquisition.marker_bit,
        seed=acquisition.seed or 0,
        rates_of=lambda scene, packed: light(scene).rates([packed])[0, 0],
    )
    return Setup(bench, bench, bench.display, clock=lambda: bench.now_s, latencies=latencies)

"""Devices of a run: protocols of projector and counter, and virtual ones.

Projector and counter are context managers that let go of their device on every way out, Ctrl-C
included, so that a laboratory can bring its own. Virtual devices do not wait: each step sets their
clock on by the time that it takes. They see what the display shows frame by frame as the virtual
camera does, write photons and markers to a PTU file, and read counts from it while it grows.
"""

import math
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import lru_cache
from io import FileIO
from pathlib import Path
from typing import Generic, Protocol, TypeVar

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Progress
from deepfsi.counting.acquisition import Acquisition
from deepfsi.counting.events import PtuWriter
from deepfsi.counting.streaming import FrameCounter, FrameCounts, FrameGates
from deepfsi.lab.virtual_detector import DETECTOR_TICK_S, Stream, divide
from deepfsi.lab.virtual_optics import (
    FRAME_MARKER,
    MirrorLight,
    VirtualCamera,
    arrival_rates,
    check_file_inputs,
    check_scenes,
)
from deepfsi.patterns.folder import Patterns

PATIENCE_S = 5.0
"""Time by which counts may come later than their frames end, seconds."""


class StreamingProjector(AbstractContextManager["StreamingProjector"], Protocol):
    """Micromirror device that holds patterns and shows lists of them, for times told with each.

    Entering takes hold of the device; leaving stops it and lets go of it. Each picture gives a
    marker at its start.
    """

    def load(self, patterns: Patterns, report: Progress = SILENT) -> None:
        """Bring the frames of patterns into the device, once, in place of earlier ones."""

    def replace(self, frame: int, packed: np.ndarray) -> None:
        """Bring another frame into the device in place of a loaded one, while none is shown.

        Its packed bits (rows, bytes of a row) are as in the folder's files.
        """

    def pictures(self, dwells_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pictures as which frames are shown that are held so long: how many, and each one's time.

        Numbers (F,), more than 1 where a frame is repeated, and seconds (F,). Each picture gives a
        marker. Times (F,) are as for `show`.
        """

    def show(self, frames: np.ndarray, dwells_s: np.ndarray) -> None:
        """Show frames one after another, after those of the last list; may return before the end.

        Parameters are (F,): places in the folder, and for how long each is held at least, seconds,
        the time to settle among them. The last frame stays until the next list.
        """

    def halt(self) -> None:
        """Stop the list where it is."""


class PassProjector(AbstractContextManager["PassProjector"], Protocol):
    """Micromirror device that shows all frames of a pattern folder, one pass after another.

    Entering takes hold of the device; leaving stops it and lets go of it. Each frame gives one
    marker at its start, and is held for the picture time of the folder's manifest.
    """

    def load(self, patterns: Patterns, report: Progress = SILENT) -> None:
        """Bring the frames of patterns into the device, once, in place of earlier ones."""

    def run(self) -> None:
        """Start one pass; may return before its end."""

    def wait(self) -> None:
        """Return when the pass has ended."""

    def halt(self) -> None:
        """Stop the pass where it is."""


class StreamingCounter(AbstractContextManager["StreamingCounter"], Protocol):
    """Photon-counting electronics that count frame by frame while they record.

    Entering takes hold of the device; leaving stops the recording and lets go of the device.
    The file that is recorded holds what was counted.
    """

    def start(self, path: Path) -> None:
        """Begin to record into a new file."""

    def expect(self, gates: FrameGates) -> None:
        """Tell the gates of the frames that are shown next, before they are shown."""

    def counts_since_marker(self, timeout_s: float) -> FrameCounts:
        """Frames whose gates have ended since the last call, in order, with their counts.

        Waits for one; after the timeout there may be none. Raises `InputError` if a marker came
        that starts no frame told, or the gate of the frame before had not ended.
        """

    def stop(self) -> None:
        """End the recording; its file is then whole."""


Projector_co = TypeVar("Projector_co", bound=StreamingProjector | PassProjector, covariant=True)


@dataclass(frozen=True)
class Setup(Generic[Projector_co]):
    """Devices of a run, and who shows its scenes.

    Parameters
    ----------
    projector : StreamingProjector or PassProjector
        Shows lists of frames that a live run chooses, or a pass of all frames for each scene.
    counter : StreamingCounter
        Counts, and records what it counts.
    display : callable
        Shows a scene by its number, or darkness for -1, and returns when it has settled.
    clock : callable
        Seconds; the clock of virtual devices runs by itself.
    latencies : dict, optional
        Seconds of each step, of virtual devices.
    """

    projector: Projector_co
    counter: StreamingCounter
    display: Callable[[int], None]
    clock: Callable[[], float] = time.monotonic
    latencies: dict[str, float] | None = None


LATENCIES = {
    "load": 3.3e-3,  # of each pattern: known masks once, adaptive ones each before its look
    "display": 20e-3,  # until the display shows another scene, and it has settled
    "command": 1e-3,  # from a decision until the first frame of its list: USB, the device's start
    "trigger": 0.0,  # from the start of a frame until its marker is recorded
    "block": 1e-3,  # the counter hands over its records in blocks, each so long after the last
    "transfer": 0.25e-3,  # from the end of a block until the computer has it
    "decision": 0.4e-3,  # from the counts until the next list is known, or the class
}
"""Times of the steps of a loop, seconds; docs/notebook/live-timing.md says their sources."""


class VirtualProjector(AbstractContextManager["VirtualProjector"]):
    """Projector whose frames send the light of scenes on a display to detectors."""

    def __init__(
        self,
        rates: np.ndarray,
        camera: VirtualCamera,
        latencies: Mapping[str, float],
        seed: int = 0,
        made: Callable[[int, np.ndarray], np.ndarray] | None = None,
    ) -> None:
        if camera.gates:
            raise InputError(
                "virtual devices of a run have no gates: leave gates out of its camera"
            )
        self._made = made
        self.latencies = latencies
        # Time on the counter's clock before the first list, seconds
        self.now_s = 1e-3
        self._rates = rates
        self._scene = 0
        self._frame = 1
        rng = np.random.default_rng(seed)
        self._streams = [Stream(camera, rng) for _ in range(rates.shape[2])]
        self._reach = self._streams[0].reach
        self._camera = camera
        self._light = camera.light(rng)
        self._times_s = np.zeros(0)  # of the frames that are loaded
        self._end = 0  # ticks up to which the detectors' light is known
        self._times = np.zeros(0, np.int64)
        self._codes = np.zeros(0, np.int64)
        self.written: PtuWriter | None = None  # of the counter that records
        # Its inputs, one for each detector, and the bits of its markers
        self.wiring: tuple[tuple[int, ...], int] = tuple(range(rates.shape[2])), FRAME_MARKER

    def __exit__(self, *error: object) -> None:
        """Do nothing: there is nothing to close."""

    def load(self, patterns: Patterns, report: Progress = SILENT) -> None:
        """Take the time that a real device needs to load each frame."""
        self._times_s = patterns.manifest.picture_s
        self.now_s += len(self._times_s) * self.latencies["load"]

    def display(self, scene: int) -> None:
        """Show a scene on the display."""
        self.now_s += self.latencies["display"]
        self._see(np.array([self._frame]), np.array([max(self._ticks(self.now_s), self._end)]))
        self._scene = scene

    def replace(self, frame: int, packed: np.ndarray) -> None:
        """Load another frame in place of one, which is not shown at the moment."""
        assert self._made is not None
        self.now_s += self.latencies["load"]
        self._rates[self._scene, frame] = self._made(self._scene, packed)

    def show(self, frames: np.ndarray, dwells_s: np.ndarray) -> None:
        """Show frames; the clock is then where their counts have come and are decided upon."""
        self.now_s += self.latencies["command"]
        start = max(self._ticks(self.now_s), self._end)
        self._see(np.array([self._frame]), np.array([start]))
        ends = start + np.cumsum(np.rint(dwells_s / DETECTOR_TICK_S).astype(np.int64))
        marks = np.append(start, ends[:-1]) + self._ticks(self.latencies["trigger"])
        self._add(marks, -self.wiring[1])
        self._see(frames, ends)
        self._frame = int(frames[-1])
        # What came before the last frame's marker is handed over with it, in its block
        block = self.latencies["block"]
        whole = math.ceil(float(marks[-1]) * DETECTOR_TICK_S / block) * block
        self.now_s = whole + self.latencies["transfer"] + self.latencies["decision"]

    def pictures(self, dwells_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One picture for each frame, of its time."""
        return np.ones(len(dwells_s), np.int64), dwells_s

    def run(self) -> None:
        """Show a pass of all frames, each for its picture time."""
        self.show(np.arange(len(self._times_s)), self._times_s)

    def halt(self) -> None:
        """Do nothing: a virtual list has ended."""

    def wait(self) -> None:
        """Let time pass until all that was shown is recorded."""
        end = max(self._ticks(self.now_s), self._end + self._reach)
        self._see(np.array([self._frame]), np.array([end]))
        self.now_s = end * DETECTOR_TICK_S

    @staticmethod
    def _ticks(seconds: float) -> int:
        return round(seconds / DETECTOR_TICK_S)

    def _see(self, frames: np.ndarray, ends: np.ndarray) -> None:
        """Draw the events while frames are shown, the last until `ends[-1]`, and write them."""
        durations = np.diff(ends, prepend=self._end)
        rates = self._camera.fluctuate(
            self._rates[self._scene, frames], (ends - durations) * DETECTOR_TICK_S, self._light
        )
        for pieces, flow in divide(durations, rates):
            stop = self._end + int(pieces.sum())
            for each, stream in enumerate(self._streams):
                self._add(stream.events(self._end, pieces, flow[:, each]), self.wiring[0][each])
            self._end = stop
            self._write()

    def _add(self, times: np.ndarray, code: int) -> None:
        self._times = np.append(self._times, np.maximum(times, 0))
        self._codes = np.append(self._codes, np.full(len(times), code))

    def _write(self) -> None:
        """Write what no later event can come before."""
        order = np.argsort(self._times, kind="stable")
        times = self._times[order]
        codes = self._codes[order]
        ready = int(np.searchsorted(times, self._end - self._reach))
        if self.written is not None and ready:
            self.written.write(times[:ready], codes[:ready])
        self._times = times[ready:]
        self._codes = codes[ready:]


class VirtualCounter(AbstractContextManager["VirtualCounter"]):
    """Counter of the photons of a virtual setup, which it records into a PTU file."""

    def __init__(
        self, projector: VirtualProjector, inputs: tuple[int, ...], marker_bit: int = FRAME_MARKER
    ) -> None:
        self._projector = projector
        self._inputs = inputs
        self._bit = marker_bit
        self._file: FileIO | None = None

    def __exit__(self, *error: object) -> None:
        """End the recording; its file stays."""
        self.stop()

    def start(self, path: Path) -> None:
        """Begin to record into a new file."""
        check_file_inputs(self._inputs)
        self._projector.wiring = self._inputs, self._bit
        self._projector.written = PtuWriter(path, DETECTOR_TICK_S, growing=True).__enter__()
        self._file = FileIO(path)
        self._counter = FrameCounter(self._inputs, self._bit, path)

    def expect(self, gates: FrameGates) -> None:
        """Tell the gates of the frames that are shown next."""
        self._counter.expect(gates)

    def counts_since_marker(self, timeout_s: float) -> FrameCounts:
        """Frames whose gates have ended since the last call; a virtual counter never waits."""
        assert self._file is not None
        return self._counter.feed(self._file.read())

    def stop(self) -> None:
        """End the recording; its file is then whole."""
        if self._file is None:
            return
        self._file.close()
        self._file = None
        writer = self._projector.written
        self._projector.written = None
        assert writer is not None
        writer.__exit__(None, None, None)


def virtual_setup(
    patterns: Patterns,
    scenes: np.ndarray,
    acquisition: Acquisition,
    report: Progress = SILENT,
    *,
    latency_s: float | None = None,
    decision_s: float | None = None,
) -> Setup[VirtualProjector]:
    """Virtual devices of a run, with the camera, flux, seed and wiring of its acquisition."""
    camera = VirtualCamera.model_validate(acquisition.camera)
    manifest = patterns.manifest
    flux = acquisition.flux or 0.0
    images = check_scenes(scenes, manifest, flux)
    rates = arrival_rates(patterns, scenes, camera, flux, report=report)
    load_us = manifest.device.load_us
    times = {
        "load": load_us * 1e-6 if load_us else None,
        "command": latency_s,
        "decision": decision_s,
    }
    latencies = LATENCIES | {name: time for name, time in times.items() if time is not None}

    @lru_cache(maxsize=1)
    def light(scene: int) -> MirrorLight:
        return MirrorLight(manifest, images[scene][None], camera, flux)

    projector = VirtualProjector(
        rates,
        camera,
        latencies,
        seed=acquisition.seed or 0,
        made=lambda scene, packed: light(scene).rates([packed])[0, 0],
    )
    return Setup(
        projector,
        VirtualCounter(projector, acquisition.inputs, acquisition.marker_bit),
        projector.display,
        clock=lambda: projector.now_s,
        latencies=latencies,
    )

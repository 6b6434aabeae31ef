"""Devices of a run: protocols of projector and counter, so that a laboratory can bring its own.

Both are context managers that let go of their device on every way out, Ctrl-C included.
"""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Protocol, TypeVar

import numpy as np

from deepfsi.base.progress import SILENT, Progress
from deepfsi.hardware.counting.streaming import FrameCounts, FrameGates

PATIENCE_S = 5.0
"""Time by which counts may come later than their frames end, seconds."""


class StreamingProjector(AbstractContextManager["StreamingProjector"], Protocol):
    """Micromirror device that holds patterns and shows lists of them, for times told with each.

    Entering takes hold of the device; leaving stops it and lets go of it. Each picture gives a
    marker at its start.
    """

    def load(self, folder: Path, report: Progress = SILENT) -> None:
        """Bring the frames of a pattern folder into the device, once, in place of earlier ones."""

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

    def load(self, folder: Path, report: Progress = SILENT) -> None:
        """Bring the frames of a pattern folder into the device, once, in place of earlier ones."""

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

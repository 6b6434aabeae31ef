"""Photons counted frame by frame while a recording runs, as soon as the gate of each has ended.

A device gives a marker at the start of each frame. The gates of frames, as times after their
markers, are announced before the frames are shown. Each marker starts the next frame, and must come
when the picture before it ends: so a missing marker shifts no frames, and is noticed at the latest
when the next list of frames begins. A gate has ended when a later record (a photon, a marker or an
overflow) shows that no earlier photon can follow.
"""

import os
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.quantities import time_text
from deepfsi.counting.ptu import EARLIEST_TICK, Decoded, marker_slack
from deepfsi.counting.reader import PtuStream, WindowCounter
from deepfsi.counting.windows import MOST_EXTRA, MOST_RATE


@dataclass(frozen=True)
class FrameGates:
    """Gates of frames, one for each frame, in the order in which they are shown."""

    offsets_s: np.ndarray  # (F,): When it begins after the first marker of its frame, seconds
    lengths_s: np.ndarray  # (F,): For how long it is open
    # (F,): Markers of the frame, more than one where it is shown as several pictures in a row
    markers: np.ndarray
    # (F,): Time from each of its markers to the next; not checked where None. The next list of
    # frames may begin at any time after the last
    pictures_s: np.ndarray | None = None

    @classmethod
    def of(cls, offset_s: float, lengths_s: Sequence[float] | np.ndarray) -> "FrameGates":
        """Gates of frames with one marker each, all as long after their marker."""
        lengths = np.asarray(lengths_s, np.float64)
        return cls(np.full(lengths.shape, offset_s), lengths, np.ones(lengths.shape, np.int64))

    def __len__(self) -> int:
        return len(self.offsets_s)


class _DueFrame(NamedTuple):
    """A frame whose marker is due, its times in ticks."""

    offset: int
    length: int
    markers: int
    picture: int  # time from each of its markers to the next; 0 if that is not checked
    tolerance: int  # by how much that may be off
    follows: bool  # whether it comes as soon as the frame before ends


class FrameCounter:
    """Counts photons frame by frame in a PTU file whose bytes arrive in pieces of any size.

    The inputs of the counter are numbered from 0; the marker bit of the device's trigger is 1, 2, 4
    or 8. `stream` is the name by which errors call it.
    """

    def __init__(
        self,
        inputs: Sequence[int],
        marker_bit: int = 1,
        stream: str | os.PathLike[str] = "the stream",
    ) -> None:
        self._inputs = tuple(inputs)
        self._bit = marker_bit
        self._stream = PtuStream(stream)
        self._windows = WindowCounter(self._stream, self._inputs)
        self._told: list[FrameGates] = []  # lists of frames that are not due yet
        self._due: deque[_DueFrame] = deque()
        self._frame: _DueFrame | None = None  # the frame whose marker came last
        self._last = EARLIEST_TICK  # that marker
        self._skipped = 0  # markers to come of that frame
        self._begun = 0  # frames whose counts were not given
        # (n, inputs): Of their gates that have ended
        self._counts = np.zeros((0, len(self._inputs)), np.int64)
        self._stop = EARLIEST_TICK  # end of the last gate

    def expect(self, gates: FrameGates) -> None:
        """Announce the next frames, before they are shown."""
        self._told.append(gates)

    def feed(self, data: bytes | bytearray | memoryview) -> np.ndarray:
        """Read the next bytes; give the counts (F, inputs) of frames whose gates ended."""
        self._stream.feed(data)
        no_counts = np.zeros((0, len(self._inputs)), np.int64)
        return np.concatenate([no_counts, *(self._add(block) for block in self._stream.blocks())])

    @property
    def _tick_s(self) -> float:
        return self._stream.header.tick_s

    def _plan(self, gates: FrameGates) -> None:
        """Put the frames of a list in line, with times in ticks of the header."""
        tick_s = self._tick_s
        slack = marker_slack(tick_s)
        offsets = np.rint(gates.offsets_s / tick_s)
        if len(gates) and not offsets.min() > slack:
            raise InputError(
                f"a gate begins {time_text(gates.offsets_s.min())} after its marker, which may be "
                f"{time_text(slack * tick_s)} off: give frames a longer time to settle"
            )
        lengths = np.rint(gates.lengths_s / tick_s)
        pictures = tolerances = np.zeros(len(gates))
        if gates.pictures_s is not None and len(gates):
            ticks = gates.pictures_s / tick_s
            pictures = np.rint(ticks)
            # the clock and the device may differ as in recordings (`windows`)
            tolerances = MOST_RATE * ticks + MOST_EXTRA * ticks.min() + slack
        columns = np.stack([offsets, lengths, gates.markers, pictures, tolerances]).astype(np.int64)
        for number, times in enumerate(columns.T.tolist()):
            self._due.append(_DueFrame._make([*times, number > 0]))

    def _add(self, block: Decoded) -> np.ndarray:
        """Count the next records; give the frames whose gates, and pictures, have ended."""
        while self._told:
            self._plan(self._told.pop(0))
        block.check(self._stream.header.path)
        begun = map(self._begin, block.marks[block.bits & self._bit != 0].tolist())
        gates = np.array([gate for gate in begun if gate], np.int64).reshape(-1, 2)
        self._windows.expect(*gates.T)
        self._windows.add(block)
        counts = np.concatenate([self._counts, self._windows.take()])
        waits = 0 < len(counts) == self._begun and self._followed
        ready = len(counts) - waits
        self._counts = counts[ready:]
        self._begun -= ready
        return counts[:ready]

    @property
    def _followed(self) -> bool:
        """True if the shown frame is not the last of its list."""
        return bool(self._due) and self._due[0].follows

    def _begin(self, time: int) -> tuple[int, int] | None:
        """Gate of the frame that a marker starts, ticks; None if the marker starts none."""
        if not (self._skipped or self._due):
            raise InputError(
                f"{self._describe(time)} that starts no frame: tell frames before they are shown, "
                "and wire the trigger so that it comes once"
            )
        self._check_step(time, bool(self._skipped) or self._followed)
        self._last = time
        if self._skipped:
            self._skipped -= 1
            return None
        self._frame = frame = self._due.popleft()
        start = time + frame.offset
        self._skipped = frame.markers - 1
        # The counter need not record anything after the last marker of a list: then the counts of
        # a gate that ends after it never come
        last = frame.follows and frame.picture and not self._followed
        if (time if last else start) < self._stop:
            raise InputError(
                f"{self._describe(time)}, before the gate of the frame before has ended: show "
                "frames for longer, count them for less, or use a trigger that jitters by less "
                "than 2 µs"
            )
        self._stop = start + frame.length
        self._begun += 1
        return start, self._stop

    def _check_step(self, time: int, follows: bool) -> None:
        """Raise `InputError` unless a marker comes when the picture before it ends."""
        # The first one of a list may come later
        frame = self._frame
        if frame is None or not frame.picture:
            return
        step = time - self._last
        late = step - frame.picture
        if abs(late) > frame.tolerance and (follows or late < 0):
            raise InputError(
                f"{self._describe(time)}, {time_text(step * self._tick_s)} after the one before, "
                f"and that picture lasts {time_text(frame.picture * self._tick_s)}: a marker is "
                "missing or one too many; look at the trigger"
            )

    def _describe(self, time: int) -> str:
        return f"{self._stream.header.path} has a marker at {time * self._tick_s:.9g} s"

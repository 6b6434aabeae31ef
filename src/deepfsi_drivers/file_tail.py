"""Photon counters over a PTU file that is read as it grows, so that counts are those of the file.

`FollowedCounter` follows a file that a counter's own software writes. So any PicoQuant counter
streams, as long as its software writes records at once and does not hold them back: look at how
often the file grows before the time that a decision takes is relied on.

`TappedCounter` takes what a device hands over, and writes the file itself.
"""

import os
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from io import FileIO
from pathlib import Path

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.counting.events import PtuWriter
from deepfsi.counting.streaming import FrameCounter, FrameGates

FILE_POLL_S = 0.0001
"""Time between two looks at the file, seconds."""

TAP_POLL_S = 0.0002
"""Time between two questions to a device, seconds."""


APPEARS_S = 60.0
"""Time in which the file must appear, seconds."""


class FollowedCounter(AbstractContextManager["FollowedCounter"]):
    """Streaming counter over a file, or a named pipe, that other software writes.

    `ask` is called with a request to begin or end the recording.
    """

    def __init__(
        self,
        inputs: tuple[int, ...] = (0,),
        marker_bit: int = 1,
        ask: Callable[[str], None] | None = None,
    ) -> None:
        self._inputs = inputs
        self._bit = marker_bit
        self._ask = ask
        # Bytes read at once
        self._buffer = memoryview(bytearray(2**21))
        self._file: FileIO | None = None

    def __exit__(self, *error: object) -> None:
        self._close()

    def start(self, path: Path) -> None:
        """Follow a file from its beginning; waits until it is there."""
        self._close()
        if self._ask is not None:
            self._ask(f"begin to record {path} with the counter's software")
        end = time.monotonic() + APPEARS_S
        while not path.exists():
            if time.monotonic() > end:
                raise InputError(
                    f"{path} did not appear within {APPEARS_S:g} s: start the recording into it in "
                    "the counter's software"
                )
            time.sleep(FILE_POLL_S)
        try:
            self._file = open(path, "rb", buffering=0, opener=_open_at_once)  # noqa: SIM115
        except OSError as error:
            raise InputError(f"{path} cannot be read: {error.strerror}") from None
        self._path = path
        self._frames = FrameCounter(self._inputs, self._bit, path)

    def expect(self, gates: FrameGates) -> None:
        """Tell the gates of the frames that are shown next, before they are shown."""
        self._frames.expect(gates)

    def counts_since_marker(self, timeout_s: float) -> np.ndarray:
        """Counts since the last call, as `StreamingCounter` says."""
        assert self._file is not None
        end = time.monotonic() + timeout_s
        while True:
            size = self._file.readinto(self._buffer)
            if size and len(counts := self._frames.feed(self._buffer[:size])):
                return counts
            if time.monotonic() > end:
                return np.zeros((0, len(self._inputs)), np.int64)
            if not size:
                self._check_same(self._file)
                time.sleep(FILE_POLL_S)

    def _check_same(self, file: FileIO) -> None:
        """Raise `InputError` if the path no longer leads to the file that is followed."""
        try:
            same = os.path.samestat(os.stat(self._path), os.fstat(file.fileno()))
        except FileNotFoundError:
            same = False
        if not same:
            raise InputError(
                f"{self._path} was replaced, renamed or deleted while it was followed, and what is "
                "recorded now is in another file: let the counter's software write into one file "
                "from begin to end"
            )

    def stop(self) -> None:
        """Follow no longer; someone is asked to stop what records the file."""
        if self._ask is not None and self._file is not None:
            self._ask("end the recording in the counter's software")
        self._close()

    def _close(self) -> None:
        if self._file is not None:
            self._file.close()
        self._file = None


class TappedCounter(FollowedCounter, ABC):
    """Streaming counter of a device that hands events over to a thread."""

    def __init__(self, inputs: tuple[int, ...], marker_bit: int) -> None:
        super().__init__(inputs, marker_bit)
        self._recording = ExitStack()
        self._fault: Exception | None = None  # of the thread

    def __exit__(self, *error: object) -> None:
        """End the recording and let go of the device."""
        try:
            self._recording.close()
        finally:
            self._free()

    def start(self, path: Path) -> None:
        """Begin to record into a new file."""
        self.stop()
        if path.exists():
            raise InputError(f"{path} is there already: give a new file")
        with ExitStack() as stack:
            tick_s, take = self._begin(path, stack)
            writer = stack.enter_context(PtuWriter(path, tick_s, growing=True))
            super().start(path)
            stack.callback(self._close)
            ending = threading.Event()
            thread = threading.Thread(target=self._read, args=(writer, take, ending), daemon=True)
            thread.start()
            # undone in reverse: the thread ends before its file is closed
            stack.callback(thread.join)
            stack.callback(ending.set)
            self._recording = stack.pop_all()

    def counts_since_marker(self, timeout_s: float) -> np.ndarray:
        """Counts since the last call, as `StreamingCounter` says."""
        end = time.monotonic() + timeout_s
        while True:
            if self._fault is not None:
                raise self._fault
            left = end - time.monotonic()
            # Time between two looks for a fault of the thread, seconds
            counts = super().counts_since_marker(min(max(left, 0.0), 0.05))
            if len(counts) or left <= 0:
                return counts

    def stop(self) -> None:
        """End the recording; its file is then whole. Without one, do nothing."""
        self._recording.close()
        fault = self._fault
        self._fault = None
        if fault is not None:
            raise fault

    def _read(
        self, writer: PtuWriter, take: Callable[[PtuWriter], None], ending: threading.Event
    ) -> None:
        """Write all events until the end; the next call raises errors."""
        try:
            while not ending.wait(TAP_POLL_S):
                take(writer)
            self._finish()
            take(writer)
        except Exception as error:
            self._fault = error

    @abstractmethod
    def _begin(self, path: Path, stack: ExitStack) -> tuple[float, Callable[[PtuWriter], None]]:
        """Begin a recording that the stack ends; give its tick, s, and a writer of new events."""

    @abstractmethod
    def _finish(self) -> None:
        """Wait until all events so far can be taken."""

    @abstractmethod
    def _free(self) -> None:
        """Let go of the device."""


def open_followed(inputs: tuple[int, ...], marker_bit: int) -> FollowedCounter:
    """Counter whose recordings someone begins and ends, who is asked on standard error."""

    def ask(what: str) -> None:
        print(f"{what}, then press Enter", file=sys.stderr, flush=True)
        sys.stdin.readline()

    return FollowedCounter(inputs, marker_bit, ask=ask)


def _open_at_once(path: str, flags: int) -> int:
    """Open a file, or a pipe that may still have no bytes."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))

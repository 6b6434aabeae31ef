"""Vialux micromirror devices with an ALP 4 or 5 controller, through ALP4lib.

**Untested on hardware.** It was written from the library's source and Vialux's constants, and is
tested against a fake of the library. Watch its first runs with an oscilloscope on the sync output.

ALP holds one picture time for each sequence. So consecutive frames of the same picture time become
one sequence, and the sequences of a pass follow each other through the controller's queue, which
leaves no gap as long as the next sequence waits in it. An `equal-dwell` design whose sentinels
have the same time is one sequence; a `free-dwell` design may need one for each frame. Mirrors keep
their pattern for the whole picture time (binary, uninterrupted).

For several looks frames are loaded once, as one sequence of the device's shortest picture time, and
each look is a list of frames in the controller's frame look-up table (FLUT), in which a frame
stands as often as it is repeated. So a look takes three calls to the device however many frames it
has: the list, its length and the start. A frame that is made while the run goes on takes the place
of a loaded one between two lists; the controller refuses that while it shows the sequence.
"""

import contextlib
import ctypes
import itertools
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import validate_call

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Progress
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.manifest import Manifest
from deepfsi_drivers.device_errors import import_library, let_go, refusals

USUAL_VERSION = "4.3"
"""Version of the ALP interface."""

FRAMES_OF_9BIT = 512
"""Frames that entries of 9 bits can name; more need entries of 18."""

LONGEST_LIST = 4096
"""Largest number of entries of a frame list, as ALP4lib's structure has them."""

ROW_BYTES = {1024: 128, 1920: 256}
"""Bytes of a row of packed mirrors by its length, as alp.h has them; other rows go unpacked."""

VIALUX_POLL_S = 0.002
"""Time between two questions to the device, seconds."""

LIST_POLL_S = 0.0001
"""The same before a list of frames is shown, which has to begin soon, seconds."""

GRACE_S = 5.0
"""Time by which a pass may end later than planned, seconds."""


class Alp:
    """Constants of Vialux's alp.h."""

    AVAIL_MEMORY = 2003  # binary pictures that still fit
    QUEUE_AVAIL = 2317  # sequences that still fit
    BIN_MODE = 2104
    BIN_UNINTERRUPTED = 2106
    FLUT_MODE = 2118
    FLUT_9BIT = 1
    FLUT_18BIT = 2
    FLUT_ENTRIES9 = 2120  # of 9 bits; one of 18 counts as two
    FLUT_MAX_ENTRIES9 = 2324
    FLUT_WRITE_9BIT = 2325
    FLUT_WRITE_18BIT = 2326
    DATA_FORMAT = 2110
    DATA_MSB_ALIGN = 0
    DATA_BINARY_TOPDOWN = 2
    MIN_PICTURE_TIME = 2211
    MAX_PICTURE_TIME = 2213
    QUEUE_MODE = 2314
    SEQUENCE_QUEUE = 1
    RESET_QUEUE = 2319
    DEFAULT = 0
    PROJ_STATE = 2400
    PROJ_ACTIVE = 1200


class _Board(ABC):
    """A Vialux device that is open, and the frames in it."""

    @validate_call
    def __init__(
        self, version: str = USUAL_VERSION, library: Path | None = None, serial: int | None = None
    ) -> None:
        self.version = version
        self.library = library
        self.serial = serial
        self._alp: Any = None
        self._flut: Any = None  # structure of a frame list
        self._sequences: list[Any] = []
        self._end = 0.0

    def __enter__(self) -> Self:
        """Open the device, with its sequence queue on."""
        module = import_library("the Vialux device", "ALP4lib", "ALP4")
        folder = None if self.library is None else str(self.library)
        with _refusals("be opened"), contextlib.redirect_stdout(sys.stderr):  # it prints
            alp = module.ALP4(version=self.version, libDir=folder)
            try:
                alp.Initialize(self.serial)
                alp.ProjControl(Alp.QUEUE_MODE, Alp.SEQUENCE_QUEUE)
            except BaseException:
                with contextlib.suppress(Exception):
                    alp.Free()
                raise
        self._alp = alp
        self._flut = module.tFlutWrite
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        """Halt and free the device."""
        let_go(kind, self.halt, self._free)

    def load(self, patterns: Patterns, report: Progress = SILENT) -> None:
        """Send frames of any format to the device, in place of earlier ones."""
        manifest = patterns.manifest
        self.halt()
        self._unload()
        self._check(patterns)
        try:
            with _refusals("load frames"):
                self._send(manifest, patterns.frames(), report)
        except BaseException:
            with contextlib.suppress(InputError):
                self._unload()
            raise

    def halt(self) -> None:
        """Stop at once, and empty the queue."""
        with _refusals("be halted"), contextlib.ExitStack() as stack:
            stack.callback(self._alp.Halt)
            self._alp.ProjControl(Alp.RESET_QUEUE, Alp.DEFAULT)

    @abstractmethod
    def _send(self, manifest: Manifest, frames: Iterator[np.ndarray], report: Progress) -> None:
        """Bring frames into the device, in sequences of their own."""

    def _put(self, sequence: Any, frames: Iterator[np.ndarray], count: int, sent: Progress) -> None:
        """Fill a sequence with the next frames."""
        for first in range(0, count, 64):  # 6 MB on a DLP7000
            block = np.stack(list(itertools.islice(frames, min(64, count - first))))
            self._alp.SeqPut(self._rows(block).ravel(), sequence, first, len(block))
            sent((first + len(block)) / count)

    def _rows(self, packed: np.ndarray) -> np.ndarray:
        """Packed frames (n, rows, bytes) in the device's format: padded, or a byte a mirror."""
        columns = self._alp.nSizeX
        if columns in ROW_BYTES:
            return np.pad(packed, ((0, 0), (0, 0), (0, ROW_BYTES[columns] - packed.shape[-1])))
        return np.unpackbits(packed, axis=-1, count=columns) * np.uint8(255)

    def _unload(self) -> None:
        with _refusals("free its frames"):
            while self._sequences:
                self._alp.FreeSeq(self._sequences.pop())

    def _new_sequence(self, count: int, picture_us: int) -> Any:
        sequence = self._alp.SeqAlloc(nbImg=count, bitDepth=1)
        self._sequences.append(sequence)
        packed = self._alp.nSizeX in ROW_BYTES
        self._alp.SeqControl(
            Alp.DATA_FORMAT, Alp.DATA_BINARY_TOPDOWN if packed else Alp.DATA_MSB_ALIGN, sequence
        )
        self._alp.SeqControl(Alp.BIN_MODE, Alp.BIN_UNINTERRUPTED, sequence)
        shortest = self._alp.SeqInquire(Alp.MIN_PICTURE_TIME, sequence)
        longest = self._alp.SeqInquire(Alp.MAX_PICTURE_TIME, sequence)
        if not shortest <= picture_us <= longest:
            raise InputError(
                f"a picture time of {picture_us} µs is not possible: the Vialux device keeps "
                f"{shortest} to {longest} µs; export with another --exposure"
            )
        self._alp.SetTiming(sequence, pictureTime=picture_us)
        return sequence

    def _check(self, patterns: Patterns) -> None:
        manifest = patterns.manifest
        device = manifest.device
        if (device.columns, device.rows) != (self._alp.nSizeX, self._alp.nSizeY):
            raise InputError(
                f"'{patterns.folder}' is made for {device.columns} x {device.rows} mirrors and the "
                f"Vialux device has {self._alp.nSizeX} x {self._alp.nSizeY}: export for that device"
            )
        with _refusals("be asked for its memory"):
            free = self._alp.DevInquire(Alp.AVAIL_MEMORY)
        if len(manifest.frames) > free:
            raise InputError(
                f"{len(manifest.frames)} frames do not fit the Vialux controller, which has room "
                f"for {free}: export fewer masks"
            )

    def _wait(self, poll_s: float) -> None:
        """Return when nothing is shown or waits."""
        with _refusals("show patterns"):
            while self._running():
                self._sleep(poll_s)

    def _running(self) -> bool:
        return self._ask(Alp.PROJ_STATE) == Alp.PROJ_ACTIVE

    def _ask(self, which: int) -> int:
        """AlpProjInquire of the library itself: ALP4lib 1.1 hands it one argument too many."""
        value = ctypes.c_long(0)
        alp = self._alp
        alp._checkError(
            alp._ALPLib.AlpProjInquire(alp.ALP_ID, ctypes.c_long(which), ctypes.byref(value)),
            "Error sending request.",
        )
        return value.value

    def _sleep(self, poll_s: float) -> None:
        if time.monotonic() > self._end:
            raise InputError(
                f"the frames should have ended {GRACE_S:g} s ago and have not: check that the "
                "Vialux device does not wait for a trigger"
            )
        time.sleep(poll_s)

    def _free(self) -> None:
        alp = self._alp
        self._alp = None
        self._sequences.clear()  # freed with the device
        with _refusals("be freed"):
            alp.Free()


class VialuxProjector(_Board):
    """Projector of pattern folders on a Vialux device. Untested on hardware: see the module."""

    _pass_s = 0.0

    def run(self) -> None:
        """Start one pass; returns when its last sequence is in the controller's queue."""
        if not self._sequences:
            raise InputError("no patterns on the Vialux device: load a pattern folder first")
        with _refusals("show patterns"):
            if self._running():
                raise InputError("the Vialux device still shows a pass: wait for it or halt it")
            self._end = time.monotonic() + self._pass_s + GRACE_S
            for sequence in self._sequences:
                while self._ask(Alp.QUEUE_AVAIL) < 1:
                    self._sleep(VIALUX_POLL_S)
                self._alp.Run(sequence, loop=False)

    def wait(self) -> None:
        """Return when the pass has ended; Ctrl-C is heard meanwhile."""
        self._wait(VIALUX_POLL_S)

    def _send(self, manifest: Manifest, frames: Iterator[np.ndarray], report: Progress) -> None:
        sent = 0
        total = len(manifest.frames)
        for picture_us, run in itertools.groupby(manifest.frames, lambda f: f.picture_us):
            count = len(list(run))
            share = report.between(sent / total, (sent + count) / total)
            sent += count
            self._put(self._new_sequence(count, picture_us), frames, count, share)
        self._pass_s = manifest.pass_s


class VialuxLooks(_Board):
    """Streaming projector on a Vialux device. Untested on hardware: see the module.

    A frame is held for a whole number of picture times, and gives a marker with each. Lists that
    are longer than the controller's table are shown with a longer picture time.
    """

    _shortest_us = _picture_us = _frames = _entries = 0

    def pictures(self, dwells_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Number of pictures (F,) that show each frame, and seconds (F,) of a picture."""
        picture_us, repeats = self._plan(dwells_s)
        return repeats, np.full(len(repeats), picture_us * 1e-6)

    def replace(self, frame: int, packed: np.ndarray) -> None:
        """Bring another frame into the place of a loaded one, when the last list has ended."""
        (sequence,) = self._sequences
        with _refusals("load a frame"):
            self._wait(LIST_POLL_S)
            self._alp.SeqPut(self._rows(packed[None]).ravel(), sequence, frame, 1)

    def show(self, frames: np.ndarray, dwells_s: np.ndarray) -> None:
        """Show frames (F,) for dwells (F,) when the last list has ended; may return early."""
        picture_us, repeats = self._plan(dwells_s)
        indices = np.repeat(frames, repeats)
        (sequence,) = self._sequences
        with _refusals("show patterns"):
            self._wait(LIST_POLL_S)
            wide = self._frames > FRAMES_OF_9BIT
            entries = (ctypes.c_ulong * LONGEST_LIST)(*indices.tolist())
            table = self._flut(ctypes.c_long(0), ctypes.c_long(len(indices)), entries)
            write = Alp.FLUT_WRITE_18BIT if wide else Alp.FLUT_WRITE_9BIT
            self._alp.ProjControlEx(write, ctypes.byref(table))
            self._alp.SeqControl(Alp.FLUT_ENTRIES9, len(indices) * (1 + wide), sequence)
            if picture_us != self._picture_us:
                self._alp.SetTiming(sequence, pictureTime=picture_us)
                self._picture_us = picture_us
            self._end = time.monotonic() + len(indices) * picture_us * 1e-6 + GRACE_S
            self._alp.Run(sequence, loop=False)

    def _plan(self, dwells_s: np.ndarray) -> tuple[int, np.ndarray]:
        """Picture time, µs, and repeats (F,) that hold each frame long enough."""
        wanted_us = dwells_s * 1e6
        picture_us = max(self._shortest_us, int(wanted_us.sum() // self._entries))
        # ceilings may need more entries than planned: pictures become 1 % longer until they fit
        while (repeats := _repeats(wanted_us, picture_us)).sum() > self._entries >= len(repeats):
            picture_us = max(picture_us + 1, picture_us * 101 // 100)
        if repeats.sum() > self._entries:
            raise InputError(
                f"a list of {repeats.sum()} pictures does not fit the Vialux controller, which "
                f"takes {self._entries}: show fewer frames, or for less time"
            )
        return picture_us, repeats

    def _send(self, manifest: Manifest, frames: Iterator[np.ndarray], report: Progress) -> None:
        self._shortest_us = self._picture_us = manifest.device.shortest_us
        self._frames = len(manifest.frames)
        sequence = self._new_sequence(self._frames, self._shortest_us)
        wide = self._frames > FRAMES_OF_9BIT
        self._alp.SeqControl(Alp.FLUT_MODE, Alp.FLUT_18BIT if wide else Alp.FLUT_9BIT, sequence)
        self._entries = min(self._ask(Alp.FLUT_MAX_ENTRIES9) // (1 + wide), LONGEST_LIST)
        self._put(sequence, frames, self._frames, report)


def _repeats(wanted_us: np.ndarray, picture_us: float) -> np.ndarray:
    """Number of pictures (F,) that together last as long as wanted or longer."""
    # rounded first: an error of floating point must not cost a picture
    return np.maximum(np.ceil(np.round(wanted_us / picture_us, 9)), 1).astype(np.int64)


def _reason(error: Exception) -> str | None:
    # ALP4lib raises its own `ALPError`, `KeyError` for codes it does not know, `ValueError` for
    # versions it does not know, and `OSError` where Vialux's library is not there
    if isinstance(error, KeyError):
        return f"code {error}"
    ours = type(error).__name__ == "ALPError" or isinstance(error, ValueError | OSError)
    return str(error) if ours else None


_refusals = partial(refusals, "the Vialux device", reason=_reason)

"""T2 files written event by event."""

import os
import struct
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from importlib.metadata import version
from typing import Any, BinaryIO, Self

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.files import GrowingFile, open_atomically
from deepfsi.hardware.photons.header import GENERIC_T2, MAGIC, TICKS_S

LATEST_WRITTEN_TICK = 2**55
"""Latest time that is written, ticks."""

EVENTS_IN_MEMORY = 2**18
"""Events that are encoded at once."""

MOST_WRAPS = 127
"""Overflows that are written as one record at most: ptufile 2026.2 multiplies them in 32 bits."""


class Writer:
    """Writer of a T2 file of type Generic, as a context manager.

    The file appears when the block ends. If the block fails there is none.
    """

    def __init__(
        self, path: str | os.PathLike[str], tick_s: float = 1e-12, *, growing: bool = False
    ) -> None:
        if not TICKS_S[0] <= tick_s <= TICKS_S[1]:
            raise InputError(f"a tick of {tick_s!r} s is not allowed: give 1e-15 to 1")
        self._path, self._tick_s, self._growing = path, float(tick_s), growing
        self._records = self._latest = self._wraps = 0

    def __enter__(self) -> Self:
        self._opened = self._open()
        return self._opened.__enter__()

    def __exit__(self, *error: Any) -> None:
        self._opened.__exit__(*error)

    @contextmanager
    def _open(self) -> Iterator[Self]:
        """Open the file; the header is written again at the end, with the number of records."""
        with self._opener() as self._file:
            self._file.write(self._header())
            try:
                yield self
            finally:
                self._file.seek(0)
                self._file.write(self._header())

    def _opener(self) -> AbstractContextManager[BinaryIO | GrowingFile]:
        return GrowingFile(self._path) if self._growing else open_atomically(self._path)

    def write(self, times: np.ndarray, codes: np.ndarray) -> None:
        """Append events: times in ticks, integers (n,), and a code for each, integers (n,)."""
        # Times rise over all calls; equal ones are allowed. Codes 0 to 63 are a photon on that
        # input, 0 for input 1; -1 to -15 are a marker with the bits of the negative
        times, codes = np.asarray(times), np.asarray(codes)
        if times.ndim != 1 or times.shape != codes.shape:
            raise InputError(f"{times.shape} times and {codes.shape} codes: give one for each")
        for given in (times, codes):
            if given.dtype.kind not in "iu":
                raise InputError(f"times and codes of {given.dtype} are not allowed: give integers")
        for start in range(0, len(times), EVENTS_IN_MEMORY):
            stop = start + EVENTS_IN_MEMORY
            self._write(times[start:stop], codes[start:stop])

    def _write(self, times: np.ndarray, codes: np.ndarray) -> None:
        """Append few events."""
        if int(times[0]) < self._latest or (times[1:] < times[:-1]).any():
            raise InputError("times run back: give events in order, none before 0")
        if int(times[-1]) > LATEST_WRITTEN_TICK:
            raise InputError(f"time {times[-1]} is not allowed: give at most {LATEST_WRITTEN_TICK}")
        if int(codes.min()) < -15 or int(codes.max()) > 63:
            raise InputError("codes are 0 to 63 for photons and -1 to -15 for markers")
        times, codes = times.astype(np.int64), codes.astype(np.int64)
        special = np.where(codes < 0, 1 << 31 | -codes << 25, codes << 25)
        words = special | times & GENERIC_T2.time_mask
        wraps = times >> GENERIC_T2.time_bits
        steps = np.diff(wraps, prepend=self._wraps)
        places = np.flatnonzero(steps)
        copies = -(-steps[places] // MOST_WRAPS)
        left = np.full(int(copies.sum()), MOST_WRAPS)
        left[np.cumsum(copies) - 1] = steps[places] - (copies - 1) * MOST_WRAPS
        words = np.insert(words, np.repeat(places, copies), 1 << 31 | 63 << 25 | left)
        self._file.write(words.astype("<u4").tobytes())
        self._records += len(words)
        self._latest, self._wraps = int(times[-1]), int(wraps[-1])

    def _header(self) -> bytes:
        """Header, with the number of records so far."""
        tags: dict[str, str | int | float | None] = {
            "CreatorSW_Name": "deepfsi",
            "CreatorSW_Version": version("deepfsi"),
            "Measurement_Mode": 2,
            "Measurement_SubMode": 1,
            "TTResultFormat_TTTRRecType": GENERIC_T2.code,
            "TTResultFormat_BitsPerRecord": 32,
            "MeasDesc_GlobalResolution": self._tick_s,
            "TTResult_NumberOfRecords": self._records,
            "Header_End": None,
        }
        return struct.pack("<8s8s", MAGIC, b"1.0.00") + b"".join(
            _encode_tag(name, value) for name, value in tags.items()
        )


def _encode_tag(name: str, value: str | int | float | None) -> bytes:
    """One tag as bytes."""
    content = b""
    if isinstance(value, str):
        content = value.encode("windows-1252") + b"\0"
        content += bytes(-len(content) % 8)
        code, packed = 0x4001FFFF, struct.pack("<q", len(content))
    elif isinstance(value, float):
        code, packed = 0x20000008, struct.pack("<d", value)
    elif isinstance(value, int):
        code, packed = 0x10000008, struct.pack("<q", value)
    else:
        code, packed = 0xFFFF0008, bytes(8)
    return struct.pack("<32siI8s", name.encode("ascii"), -1, code, packed) + content

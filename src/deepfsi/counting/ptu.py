"""PTU files of PicoQuant: their header, and their records, decoded as far as counting needs.

A file is a header of tags and then records of 32 bits, as PicoQuant describes them:

- tags: https://github.com/PicoQuant/PicoQuant-Time-Tagged-File-Format-Demos/tree/master/doc
- records: the same folder's `apx_tttrrecords.html`
- the vendor's reader: the same repository's `PTU/Python/Read_PTU.py`
"""

import os
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.files import open_regular

RECORDS_AT_ONCE = 2**15
"""Records decoded at once: they and their times stay in the processor's cache."""

LATEST_TICK = 2**61
"""Latest time that can be read, ticks."""

EARLIEST_TICK = -(2**62)
"""A time before all others, ticks."""

MAGIC = b"PQTTTR"

LONGEST_HEADER = 2**22
"""Largest number of bytes of a header, or of one tag."""

TICKS_S = (1e-15, 1.0)
"""Shortest and longest credible tick, seconds."""

# Float8Array, two strings, BinaryBlob
_SIZED_TAGS = (0x2001FFFF, 0x4001FFFF, 0x4002FFFF, 0xFFFFFFFF)
"""Types of tags whose 8 bytes are the number of bytes that follow; of others they are the value."""


@dataclass(frozen=True)
class RecordType:
    """A type of record: 32 bits, a channel field above a time field; Generic T2 by default."""

    name: str
    code: int
    mode: Literal["T2", "T3"] = "T2"
    shift: int = 25
    time_bits: int = 25
    wrap: int = 1 << 25
    first: int = 0
    inputs: int = 64

    @property
    def time_mask(self) -> int:
        """Bits of the time."""
        return (1 << self.time_bits) - 1


GENERIC_T2 = RecordType("Generic T2", 0x00010207)
"""Record of a recent device in T2 mode, as files are written here."""


def _both_modes(name: str, code: int) -> tuple[RecordType, RecordType]:
    """Types of records, T2 and T3, of a HydraHarp or later."""
    t2 = replace(GENERIC_T2, name=f"{name} T2", code=code)
    t3 = replace(t2, name=f"{name} T3", code=code + 0x100, mode="T3", time_bits=10, wrap=1 << 10)
    return t2, t3


RECORD_TYPES = {
    kind.code: kind
    for kind in (
        # T2 overflows before its 28 bits are full
        RecordType("PicoHarp 300 T2", 0x00010203, "T2", 28, 28, wrap=210_698_240, inputs=5),
        RecordType("PicoHarp 300 T3", 0x00010303, "T3", 28, 16, wrap=1 << 16, first=1, inputs=4),
        *_both_modes("HydraHarp V2", 0x01010204),
        *_both_modes("TimeHarp 260 N", 0x00010205),
        *_both_modes("TimeHarp 260 P", 0x00010206),
        *_both_modes("Generic", GENERIC_T2.code),
    )
}
"""Types of records by code."""


@dataclass(frozen=True)
class Header:
    """Header of a PTU file, as far as records are read by it."""

    path: Path  # the file, or a name for a stream
    kind: RecordType  # type of the records
    offset: int  # bytes before the first record
    tick_s: float  # seconds of a tick
    claimed: int  # records that the header says there are
    size: int | None = None  # bytes of the file

    @property
    def records(self) -> int:
        """Records to read: as claimed, or as the file holds if it has fewer or claims none."""
        # More records than any file has
        most = 2**61 if self.size is None else (self.size - self.offset) // 4
        return min(self.claimed, most) if self.claimed > 0 else most

    @property
    def problems(self) -> tuple[str, ...]:
        """Reasons why the recording may be incomplete; none if all claimed records are there."""
        if self.size is None:
            return ()
        body = self.size - self.offset
        if self.claimed > body // 4:
            missing = self.claimed - body // 4
            return (f"{missing} of {self.claimed} records are missing: the file is cut",)
        if self.claimed <= 0 < body:
            return ("the header gives no number of records: the recording was not ended",)
        if 4 * self.claimed < body:
            extra = body - 4 * self.claimed
            return (f"{extra} bytes follow the {self.claimed} records that the header gives",)
        return ()

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> "Header":
        """Read the header of a PTU file; raise `InputError` if it has none, or a damaged one."""
        with open_regular(path) as file:
            header = cls.parse(file.read(LONGEST_HEADER), path, whole=True)
            assert header is not None
            return replace(header, size=os.fstat(file.fileno()).st_size)

    @classmethod
    def parse(
        cls, data: bytes | bytearray, path: str | os.PathLike[str], *, whole: bool = False
    ) -> "Header | None":
        """Header at the beginning of data; None if its end is still to come.

        `whole` data have no more bytes to come.
        """
        if len(data) >= len(MAGIC) and not data.startswith(MAGIC):
            raise InputError(
                f"{path} is not a PTU file: it begins with {bytes(data[: len(MAGIC)])!r}, not "
                f"{MAGIC!r}; give times and channels of other formats to `deepfsi camera import`, "
                "as two columns"
            )
        whole = whole or len(data) >= LONGEST_HEADER
        if not whole and b"Header_End" not in data:
            return None  # or each piece of a long header is parsed with all before it
        whole_numbers, floats, offset = _parse_tags(data, path)
        if not offset:
            if whole:
                raise InputError(
                    f"{path} is not a PTU file, or its header has no end within {LONGEST_HEADER} "
                    "bytes"
                )
            return None
        code = whole_numbers.get("TTResultFormat_TTTRRecType")
        if code not in RECORD_TYPES:
            raise InputError(
                f"{path} has records of unknown type {code}: the file is damaged, newer, or of a "
                "HydraHarp with software 1"
            )
        tick_s = floats.get("MeasDesc_GlobalResolution")
        if tick_s is None or not TICKS_S[0] <= tick_s <= TICKS_S[1]:
            raise InputError(
                f"{path} is damaged: its time resolution is {tick_s}, not 1e-15 to 1 s"
            )
        claimed = whole_numbers.get("TTResult_NumberOfRecords", 0)
        return cls(Path(path), RECORD_TYPES[code], offset, tick_s=tick_s, claimed=claimed)


def _parse_tags(
    data: bytes | bytearray, path: str | os.PathLike[str]
) -> tuple[dict[str, int], dict[str, float], int]:
    """Whole numbers and floats in the tags, by name, and the header's bytes or 0."""
    whole_numbers: dict[str, int] = {}
    floats: dict[str, float] = {}
    offset = 16  # after 8 bytes of magic and 8 of version
    while offset + 48 <= min(len(data), LONGEST_HEADER):
        ident, index, code, value = struct.unpack_from("<32siI8s", data, offset)
        offset += 48
        name = ident.split(b"\0")[0].decode("ascii", "replace")
        if name == "Header_End":
            return whole_numbers, floats, offset
        if code in _SIZED_TAGS:
            (size,) = struct.unpack("<q", value)
            if not 0 <= size <= LONGEST_HEADER:
                raise InputError(f"{path} is damaged: its tag {name!r} is of {size} bytes")
            offset += size
        if index >= 0:
            continue  # of one curve or input, not of the file
        if code == 0x10000008:  # tyInt8
            (whole_numbers[name],) = struct.unpack("<q", value)
        elif code == 0x20000008:  # tyFloat8
            (floats[name],) = struct.unpack("<d", value)
    return whole_numbers, floats, 0


@dataclass
class Decoded:
    """A block of records, decoded."""

    records: int
    times: np.ndarray  # of the photons, ticks (n,), which rise
    inputs: np.ndarray  # of the photons, 0 for input 1
    marks: np.ndarray  # times of the markers, ticks, int64 (k,), in the order of the records
    bits: np.ndarray  # of the markers, 1 to 15, uint8 (k,)
    last: int  # latest time of a photon, marker or sync event
    reached: int  # tick before which no photon or sync event of later blocks is
    fault: str = ""  # what is wrong with the record that follows

    def check(self, name: object) -> None:
        """Raise `InputError`, in which the file has this name, if there is a fault."""
        if self.fault:
            raise InputError(f"{name} is damaged: {self.fault}; record again")


class Decoder:
    """Decodes records block by block, up to a block with a `fault`."""

    def __init__(self, kind: RecordType, tick_s: float) -> None:
        self._kind = kind
        self._slack = marker_slack(tick_s)
        self._records = 0
        self._overflows = 0  # overflows so far
        self._reached = 0

    def decode(self, words: np.ndarray) -> Decoded:
        """Decode the next records, uint32 (n,), up to the first damaged one."""
        kind = self._kind
        photon = words < np.uint32(kind.first + kind.inputs << kind.shift)
        if kind.first:
            photon &= words >= np.uint32(kind.first << kind.shift)
        special = np.flatnonzero(~photon)
        overflows, bits, sync = _specials(kind, words[special].astype(np.int64))
        marked = special[bits > 0]
        overflown = special[overflows > 0]

        # An overflow, and what follows it up to the next one, counts from the same tick
        latest = LATEST_TICK // kind.wrap
        total = self._overflows + np.cumsum(overflows)
        bases = kind.wrap * np.minimum(np.append(self._overflows, total), latest)
        lengths = np.diff(special, prepend=0, append=len(words))
        times = np.repeat(bases, lengths) + (words & np.uint32(kind.time_mask))

        # No event may be before one that was recorded before it; markers are less exact
        ends = np.append(self._reached, times)
        ends[overflown + 1] = 0
        ends[marked + 1] -= self._slack
        ends = np.maximum.accumulate(ends)
        early = times < ends[:-1]
        early[overflown] = False
        early[marked] = times[marked] + self._slack < ends[marked]

        damages = (
            (special[~((overflows > 0) | (bits > 0) | sync)], "no known meaning"),
            (special[total > latest], f"a time beyond {LATEST_TICK} ticks"),
            (np.flatnonzero(early), "a time before that of the record before"),
        )
        starts = [(int(where[0]), how) for where, how in damages if len(where)]
        if starts:
            first, how = min(starts)
            decoded = self.decode(words[:first])
            decoded.fault = f"record {self._records + 1} has {how}"
            return decoded
        self._records += len(words)
        self._overflows = int(bases[-1]) // kind.wrap
        self._reached = max(int(bases[-1]), int(ends[-1]))
        photons = times[photon]
        return Decoded(
            records=len(words),
            times=photons,
            inputs=(words[photon] >> np.uint32(kind.shift)) - np.uint32(kind.first),
            marks=times[marked],
            bits=bits[bits > 0].astype(np.uint8),
            last=int(max(photons.max(initial=0), times[special[overflows == 0]].max(initial=0))),
            reached=self._reached,
        )


def marker_slack(tick_s: float) -> int:
    """Ticks by which a marker may stand too early or too late among photons: 1 µs, or one tick."""
    return round(max(1e-6, tick_s) / tick_s)


def _specials(kind: RecordType, words: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Overflows, marker bits and sync events (n,) of records, words (n,), that are no photons.

    All are 0 of a record without a meaning.
    """
    codes = words >> kind.shift
    if kind.inputs < 64:  # PicoHarp 300
        valid = codes == 15
        # in T2 the four lowest bits of the time are the markers
        bits = words & 15 if kind.mode == "T2" else words >> kind.time_bits & 0xFFF
        overflows = (valid & (bits == 0)).astype(np.int64)
        sync = np.zeros(len(words), bool)
    else:
        codes = codes & 63
        valid = codes != 63
        bits = codes
        # an old-style record holds no number: one overflow
        overflows = np.where(valid, 0, np.maximum(words & kind.time_mask, 1))
        sync = (codes == 0) & (kind.mode == "T2")
    return overflows, np.where(valid & (bits < 16), bits, 0), sync

"""PTU files of PicoQuant: their header, and their records, decoded as far as counting needs.

A file is a header of tags and then records of 32 bits, as PicoQuant describes them:

- tags: https://github.com/PicoQuant/PicoQuant-Time-Tagged-File-Format-Demos/tree/master/doc
- records: the same folder's `apx_tttrrecords.html`
- the vendor's reader: the same repository's `PTU/Python/Read_PTU.py`
"""

import os
import struct
from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.files import open_regular

RECORDS_IN_MEMORY = 2**19
"""Records in memory at once."""

RECORDS_IN_CACHE = 2**17
"""Records scanned at once: they and what is made of them stay in the processor's cache."""

LATEST_TICK = 2**61
"""Latest time that is read, ticks."""

EARLIEST_TICK = -(2**62)
"""A time before all others, ticks."""

MAGIC = b"PQTTTR"

LONGEST_HEADER = 2**22
"""Largest number of bytes of a header, or of one tag."""

TICKS_S = (1e-15, 1.0)
"""Shortest and longest tick that is believed, seconds."""

_EIGHT_BYTES = (
    *(0xFFFF0008, 0x00000008, 0x10000008, 0x11000008),  # Empty8, Bool8, Int8, BitSet64
    *(0x12000008, 0x20000008, 0x21000008),  # Color8, Float8, TDateTime
)
"""Types of tags whose value is their 8 bytes."""

_LONGER = (0x2001FFFF, 0x4001FFFF, 0x4002FFFF, 0xFFFFFFFF)  # Float8Array, two strings, BinaryBlob
"""Types of tags whose 8 bytes are the number of bytes that follow."""


@dataclass(frozen=True)
class Kind:
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


PICOHARP_T2 = Kind(
    name="PicoHarp 300 T2",
    code=0x00010203,
    shift=28,
    time_bits=28,
    wrap=210_698_240,
    inputs=5,
)
"""Record of a PicoHarp 300 in T2 mode."""

PICOHARP_T3 = Kind(
    name="PicoHarp 300 T3",
    code=0x00010303,
    mode="T3",
    shift=28,
    time_bits=16,
    wrap=65_536,
    first=1,
    inputs=4,
)
"""Record of a PicoHarp 300 in T3 mode."""

GENERIC_T2 = Kind("Generic T2", 0x00010207)
"""Record of a recent device in T2 mode, as files are written here."""


def _both_modes(name: str, code: int) -> tuple[Kind, Kind]:
    """Types of records, T2 and T3, of a HydraHarp or later."""
    t2 = replace(GENERIC_T2, name=f"{name} T2", code=code)
    t3 = replace(t2, name=f"{name} T3", code=code + 0x100, mode="T3", time_bits=10, wrap=1 << 10)
    return t2, t3


KINDS = {
    kind.code: kind
    for kind in (
        PICOHARP_T2,
        PICOHARP_T3,
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
    kind: Kind  # type of the records
    offset: int  # bytes before the first record
    tick_s: float  # seconds of a tick
    claimed: int  # records that the header says there are
    size: int | None = None  # bytes of the file

    @property
    def records(self) -> int:
        """Records to read: those claimed, or those that are there if fewer or unclaimed."""
        # More records than any file has
        most = 2**61 if self.size is None else (self.size - self.offset) // 4
        return min(self.claimed, most) if self.claimed > 0 else most

    @property
    def problems(self) -> tuple[str, ...]:
        """Reasons why the recording may be incomplete: none if the file holds what is claimed."""
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
        parser = cls.parse(path)
        with open_regular(path, buffering=0) as file:
            needed = next(parser)
            while True:
                try:
                    needed = parser.send(file.read(needed))
                except StopIteration as end:
                    return replace(end.value, size=os.fstat(file.fileno()).st_size)

    @classmethod
    def parse(cls, path: str | os.PathLike[str]) -> Generator[int, bytes, "Header"]:
        """Parse a header: yields how many bytes it needs, and is sent them, or fewer at the end."""
        tags, offset = yield from _parse_numbers(path)
        code = _integer(tags, "TTResultFormat_TTTRRecType", path)
        if code not in KINDS:
            raise InputError(
                f"{path} has records of unknown type {code:#010x}: the file is damaged, newer, or "
                "of a HydraHarp with software 1"
            )
        kind = KINDS[code]
        if _integer(tags, "TTResultFormat_BitsPerRecord", path, 32) not in (0, 32):
            raise InputError(f"{path} has records that are not of 32 bits")
        if _integer(tags, "Measurement_Mode", path, int(kind.mode[1])) != int(kind.mode[1]):
            raise InputError(
                f"{path} has {kind.name} records but another measurement mode: it is damaged"
            )
        tick = tags.get("MeasDesc_GlobalResolution")
        if not (isinstance(tick, float) and TICKS_S[0] <= tick <= TICKS_S[1]):
            raise InputError(f"{path} is damaged: its time resolution is {tick}, not 1e-15 to 1 s")
        return cls(
            path=Path(path),
            kind=kind,
            offset=offset,
            tick_s=tick,
            claimed=_integer(tags, "TTResult_NumberOfRecords", path, 0),
        )


def _parse_numbers(
    path: str | os.PathLike[str],
) -> Generator[int, bytes, tuple[dict[str, int | float | None], int]]:
    """Numbers in the tags of a header by name, None of another type, and the header's bytes."""
    start = yield 16
    if start[:8].rstrip(b"\0") != MAGIC:
        raise InputError(
            f"{path} is not a PTU file: it begins with {start[:8]!r}, not {MAGIC!r}; give times "
            "and channels of other formats to `deepfsi camera import`, as two columns"
        )
    numbers: dict[str, int | float | None] = {}
    offset = len(start)
    while True:
        raw = yield 48
        offset += len(raw)
        if len(raw) < 48 or offset > LONGEST_HEADER:
            raise InputError(f"{path} has a header without an end within {LONGEST_HEADER} bytes")
        ident, index, code, value = struct.unpack("<32siI8s", raw)
        name = ident.split(b"\0")[0].decode("ascii", "replace")
        if name == "Header_End":
            return numbers, offset
        if code in _LONGER:
            (size,) = struct.unpack("<q", value)
            content = (yield size) if 0 < size <= LONGEST_HEADER else b""
            if len(content) != size:
                raise InputError(f"{path} is damaged: its tag {name!r} is of {size} bytes")
            offset += size
        elif code not in _EIGHT_BYTES:
            raise InputError(f"{path} is damaged: its tag {name!r} is of unknown type {code:#010x}")
        if index < 0:
            form = {0x10000008: "<q", 0x20000008: "<d"}.get(code)
            numbers[name] = struct.unpack(form, value)[0] if form else None


def _integer(
    numbers: dict[str, int | float | None],
    name: str,
    path: str | os.PathLike[str],
    default: int | None = None,
) -> int:
    """Integer of a tag, or the default."""
    value = numbers.get(name, default)
    if not isinstance(value, int):
        raise InputError(f"{path} is damaged: its tag {name!r} is not an integer")
    return value


@dataclass(frozen=True)
class _Runs:
    """Photons between two specials; runs without any are left out."""

    begin: np.ndarray  # (r,): index of the first photon among the records
    end: np.ndarray  # (r,): index after the last
    base: np.ndarray  # (r,): tick from which their time fields count
    low: np.ndarray  # (r,): time of the first photon, ticks
    high: np.ndarray  # (r,): time of the last


@dataclass
class Part:
    """Some records that follow each other, decoded as far as is needed to count."""

    kind: Kind  # type of the records
    words: np.ndarray  # records, uint32 (n,)
    places: np.ndarray
    times: np.ndarray
    bits: np.ndarray
    sync: np.ndarray
    wraps: np.ndarray
    runs: _Runs  # photons between the specials
    reached: int  # tick before which no photon or sync event of later parts is
    fault: str = ""  # what is wrong with the record that follows

    @property
    def markers(self) -> tuple[np.ndarray, np.ndarray]:
        """Times of the markers in ticks, int64 (n,), and their bits, uint8 (n,)."""
        which = np.flatnonzero(self.bits)
        return self.times[which], self.bits[which].astype(np.uint8)

    def check(self, name: object) -> None:
        """Raise `InputError`, in which the file has this name, if there is a fault."""
        if self.fault:
            raise InputError(f"{name} is damaged: {self.fault}; record again")

    def find(self, edges: np.ndarray) -> np.ndarray:
        """Places of the first photons at or after some times, none later than the last photon."""
        run = np.searchsorted(self.runs.high, edges)
        wanted = edges - self.runs.base[run]
        low = self.runs.begin[run]
        high = self.runs.end[run] - 1
        for _ in range(int((high - low).max(initial=0)).bit_length()):
            middle = (low + high) >> 1
            later = self.words[middle] & self.kind.time_mask < wanted
            low = np.where(later, middle + 1, low)
            high = np.where(later, high, middle)
        return low

    def count(self, number: int, places: np.ndarray) -> tuple[np.ndarray, int]:
        """Photons on an input before each place, and in the whole part."""
        field = self.kind.first + number
        counted = self.words < np.uint32(field + 1 << self.kind.shift)
        if field:
            counted &= self.words >= np.uint32(field << self.kind.shift)
        total = int(np.count_nonzero(counted))
        if total == len(self.words) - len(self.places):  # all photons
            return places - np.searchsorted(self.places, places), total
        if not (total and len(places)):
            return np.zeros(len(places), np.int64), total
        return np.searchsorted(np.flatnonzero(counted), places), total

    @property
    def totals(self) -> np.ndarray:
        """Photons on each input that there can be, int64 (inputs,)."""
        fields = self.kind.first + self.kind.inputs
        channels = np.bincount(self.words >> self.kind.shift, minlength=fields)
        return channels[self.kind.first : fields]

    def photons(self, number: int) -> np.ndarray:
        """Times of the photons on an input, int64 (n,)."""
        lengths = self.runs.end - self.runs.begin
        skipped = self.runs.begin - (np.cumsum(lengths) - lengths)
        words = self.words[np.repeat(skipped, lengths) + np.arange(lengths.sum())]
        times = np.repeat(self.runs.base, lengths) + (words & np.uint32(self.kind.time_mask))
        return times[words >> np.uint32(self.kind.shift) == self.kind.first + number]


class Decoder:
    """Decodes records that come in blocks of any length.

    Where a record is damaged, the part ends before it with a `fault`, and no more can be decoded.
    """

    def __init__(self, kind: Kind, tick_s: float, ordered: bool = True) -> None:
        self._kind = kind
        self._ordered = ordered
        self._slack = marker_slack(tick_s)
        self._records = 0
        self._wraps = 0  # overflows so far
        self._latest = 0  # time of the last photon or sync event
        self._after = 0  # the same, or earliest time that may follow a marker if that was last

    def parts(self, words: np.ndarray) -> Iterator[Part]:
        """Decode records, uint32 (n,), that follow those before, and hold on to them.

        No part follows one with a `fault`.
        """
        for start in range(0, len(words), RECORDS_IN_MEMORY):
            part = self._decode(words[start : start + RECORDS_IN_MEMORY])
            yield part
            if part.fault:
                return

    def _decode(self, words: np.ndarray) -> Part:
        """Decode records up to the first that is damaged."""
        kind = self._kind
        places, back = _scan(kind, words, self._ordered)
        wraps, bits, sync, values = _specials(kind, words[places].astype(np.int64))
        damages = [(places[~((wraps > 0) | (bits > 0) | sync)], "no known meaning")]

        total = self._wraps + np.cumsum(wraps)
        damages.append(
            (places[total > LATEST_TICK // kind.wrap], f"a time beyond {LATEST_TICK} ticks")
        )
        bases = kind.wrap * np.minimum(np.append(self._wraps, total), LATEST_TICK // kind.wrap)
        times = bases[1:] + values

        runs = _Runs(*np.zeros((5, 0), np.int64))
        latest = after = 0
        if self._ordered:
            runs = _find_runs(words, places, bases, kind.time_mask)
            exact = _merge(
                (runs.begin, runs.low, runs.high), (places[sync], times[sync], times[sync])
            )
            marked = times[bits > 0]
            loose = _merge(exact, (places[bits > 0], marked + self._slack, marked - self._slack))
            late, latest = _follow(exact, self._latest)
            later, after = _follow(loose, self._after)
            early = np.concatenate([back, late, later])
            damages.append((np.sort(early), "a time before that of the record before"))

        starts = [(int(where[0]), how) for where, how in damages if len(where)]
        if starts:
            first, how = min(starts)
            part = self._decode(words[:first])
            part.fault = f"record {self._records + 1} has {how}"
            return part
        self._records += len(words)
        self._wraps = int(bases[-1]) // kind.wrap
        self._latest = latest
        self._after = after
        return Part(
            kind=kind,
            words=words,
            places=places,
            times=times,
            bits=bits,
            sync=sync,
            wraps=wraps,
            runs=runs,
            reached=max(int(bases[-1]), latest, after),
        )


def marker_slack(tick_s: float) -> int:
    """Ticks by which a marker may stand too early or too late among photons: 1 µs, or one tick."""
    return round(max(1e-6, tick_s) / tick_s)


def _find_runs(words: np.ndarray, places: np.ndarray, bases: np.ndarray, mask: int) -> _Runs:
    """Photons between specials at some places, whose times count from `bases`."""
    begin = np.append(0, places + 1)
    end = np.append(places, len(words))
    full = begin < end
    begin = begin[full]
    end = end[full]
    base = bases[full]
    low = base + (words[begin] & mask)
    high = base + (words[end - 1] & mask)
    return _Runs(begin=begin, end=end, base=base, low=low, high=high)


def _scan(kind: Kind, words: np.ndarray, ordered: bool) -> tuple[np.ndarray, np.ndarray]:
    """Places of the specials, and of photons earlier than a photon right before them."""
    # The latter are not looked for unless `ordered`
    specials = [np.zeros(0, np.int64)]
    backs = [np.zeros(0, np.int64)]
    for start in range(0, len(words), RECORDS_IN_CACHE):
        block = words[start : start + RECORDS_IN_CACHE + 1]  # and the first of the next
        special = block >= np.uint32(kind.first + kind.inputs << kind.shift)
        if kind.first:
            special |= block < np.uint32(kind.first << kind.shift)
        specials.append(np.flatnonzero(special[:RECORDS_IN_CACHE]) + start)
        if not ordered:
            continue
        times = block & np.uint32(kind.time_mask)
        back = (times[1:] < times[:-1]) > (special[1:] | special[:-1])
        if back.any():
            backs.append(np.flatnonzero(back) + start + 1)
    return np.concatenate(specials), np.concatenate(backs)


_Events = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Places of photons and other events among the records, first times and last times."""


def _merge(one: _Events, other: _Events) -> _Events:
    """Join events in the order of records."""
    if not len(other[0]):
        return one
    places, lows, highs = (np.concatenate(pair) for pair in zip(one, other, strict=True))
    order = np.argsort(places, kind="stable")
    return places[order], lows[order], highs[order]


def _follow(events: _Events, latest: int) -> tuple[np.ndarray, int]:
    """Places of events that begin before the one before has ended, and the end of the last."""
    places, lows, highs = events
    ends = np.append(latest, highs)
    return places[lows < ends[:-1]], int(ends[-1])


def _specials(
    kind: Kind, words: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Overflows, marker bits, sync events (bool) and times of records that are special."""
    # All but the times are 0 of a record that has no meaning
    times = words & kind.time_mask
    codes = words >> kind.shift
    if kind in (PICOHARP_T2, PICOHARP_T3):
        valid = codes == 15
        bits = words & 15 if kind.mode == "T2" else words >> kind.time_bits & 0xFFF
        wraps = (valid & (bits == 0)).astype(np.int64)
        sync = np.zeros(len(words), bool)
    else:
        codes = codes & 63
        valid = codes != 63
        bits = codes
        wraps = np.where(valid, 0, np.maximum(times, 1))
        sync = (codes == 0) & (kind.mode == "T2")
    return wraps, np.where(valid & (bits < 16), bits, 0), sync, times

"""PicoQuant PTU files: what is in them, photons counted between gates, and T2 files written.

A file is a header of tags and then records of 32 bits, as PicoQuant describes them:

- tags: https://github.com/PicoQuant/PicoQuant-Time-Tagged-File-Format-Demos/tree/master/doc
- records: the same folder's `apx_tttrrecords.html`
- the vendor's reader: the same repository's `PTU/Python/Read_PTU.py`

A record is a photon on one of the inputs, or *special*: a marker, a sync event (T2 only), or an
overflow, after which times count from one *wrap* later. Specials are few. So photons are counted
without their times: between two specials the records' time fields rise, and a gate's edge is
searched for there.

Times are in *ticks*. In T2 a tick is the resolution of the device. In T3 it is a period of the
sync, and a photon's delay after it is not read.

Times that run back, and records that mean nothing, are refused: a file that has them is damaged.
Markers alone may stand up to 1 µs (or one tick) too early or too late among photons: devices sample
them more coarsely.
"""

import contextlib
import os
import stat
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict

from deepfsi.errors import InputError
from deepfsi.files import open_atomically

MAGIC = b"PQTTTR"

CHUNK = 2**19
"""Records in memory at once."""

BLOCK = 2**17
"""Records looked at at once: they and what is made of them stay in the processor's cache."""

LONGEST_HEADER = 2**22
"""Bytes."""

LATEST = 2**61
"""Ticks."""

LATEST_WRITTEN = 2**55
"""Ticks."""

MOST_WRAPS = 127
"""Overflows that are written as one record: ptufile 2026.2 multiplies them in 32 bits."""

BACK = "a time before that of the record before"

TICKS_S = (1e-15, 1.0)
"""Shortest and longest tick that is believed."""

MOST_MARKERS = 2**24
MARKER_SLACK_S = 1e-6

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Kind:
    """A type of record.

    Attributes
    ----------
    name : str
    code : int
        Of the tag `TTResultFormat_TTTRRecType`.
    mode : {"T2", "T3"}
    shift : int
        Bits below the channel field.
    time_bits : int
        Lowest bits, which hold the time.
    wrap : int
        Ticks of an overflow.
    counted : bool
        Whether one record can stand for many overflows, their number in its time field.
    first, inputs : int
        Channel field of the first input, and how many inputs there can be.
    """

    name: str
    code: int
    mode: Literal["T2", "T3"]
    shift: int
    time_bits: int
    wrap: int
    counted: bool
    first: int
    inputs: int

    @property
    def time_mask(self) -> int:
        """Bits of the time."""
        return (1 << self.time_bits) - 1


def _hydra(name: str, code: int, mode: Literal["T2", "T3"], *, old: bool = False) -> Kind:
    bits = 25 if mode == "T2" else 10
    wrap = 33_552_000 if old and mode == "T2" else 1 << bits
    return Kind(f"{name} {mode}", code, mode, 25, bits, wrap, not old, 0, 64)


PICOHARP_T2 = Kind("PicoHarp 300 T2", 0x00010203, "T2", 28, 28, 210_698_240, False, 0, 5)
PICOHARP_T3 = Kind("PicoHarp 300 T3", 0x00010303, "T3", 28, 16, 65_536, False, 1, 4)
GENERIC_T2 = _hydra("Generic", 0x00010207, "T2")
KINDS = {
    kind.code: kind
    for kind in (
        PICOHARP_T2,
        PICOHARP_T3,
        _hydra("HydraHarp V1", 0x00010204, "T2", old=True),
        _hydra("HydraHarp V1", 0x00010304, "T3", old=True),
        _hydra("HydraHarp V2", 0x01010204, "T2"),
        _hydra("HydraHarp V2", 0x01010304, "T3"),
        _hydra("TimeHarp 260 N", 0x00010205, "T2"),
        _hydra("TimeHarp 260 N", 0x00010305, "T3"),
        _hydra("TimeHarp 260 P", 0x00010206, "T2"),
        _hydra("TimeHarp 260 P", 0x00010306, "T3"),
        GENERIC_T2,
        _hydra("Generic", 0x00010307, "T3"),
    )
}


@dataclass(frozen=True)
class Header:
    """What a file says of itself, and whether its size agrees.

    Attributes
    ----------
    path : Path
    tags : dict
        Values by name; of a tag with an index, by `Name(index)`. Dates are days since 1899-12-30.
    kind : Kind
    records : int
        Records to read: as many as the header says, or as are there if those are fewer or the
        header does not say.
    offset : int
        Bytes before the first record.
    tick_s : float
        Seconds of a tick.
    delay_s : float or None
        T3: seconds of one unit of the delay after the sync, if the header says.
    problems : tuple of str
        Why the recording may be incomplete. Empty if the file holds what its header says.
    """

    path: Path
    tags: dict[str, Any]
    kind: Kind
    records: int
    offset: int
    tick_s: float
    delay_s: float | None
    problems: tuple[str, ...]


class Contents(BaseModel):
    """What is in a file.

    Attributes
    ----------
    kind : str
    tick_s : float
        Seconds of a tick.
    records : int
        Records read. Fewer than the file's if `problems` says that one is damaged.
    photons : dict
        Photons on each input that has any; 0 is input 1.
    markers : dict
        Markers with each bit, 1, 2, 4 and 8, that is ever set.
    overflows : int
        Overflow records.
    syncs : int
        Sync records (T2).
    first, last : int or None
        Times of the earliest and latest photon, marker or sync, ticks.
    span_s : float
        Seconds from the start of the recording to the latest of them.
    problems : tuple of str
        What is wrong with the file.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: str
    tick_s: float
    records: int
    photons: dict[int, int]
    markers: dict[int, int]
    overflows: int
    syncs: int
    first: int | None
    last: int | None
    span_s: float
    problems: tuple[str, ...]


def read_header(path: str | os.PathLike[str]) -> Header:
    """Header of a PTU file.

    Raises
    ------
    InputError
        If it is not a PTU file, or its header is damaged or names no type of record known here.
    """
    with _opened(path) as file:
        tags = _read_tags(file, path)
        offset, size = file.tell(), os.fstat(file.fileno()).st_size
    code = _integer(tags, "TTResultFormat_TTTRRecType", path)
    if code not in KINDS:
        raise _bad(path, f"has records of unknown type {code:#010x}: the file is damaged or newer")
    kind = KINDS[code]
    if _integer(tags, "TTResultFormat_BitsPerRecord", path, 32) not in (0, 32):
        raise _bad(path, "has records that are not of 32 bits, and only those are known")
    if _integer(tags, "Measurement_Mode", path, int(kind.mode[1])) != int(kind.mode[1]):
        raise _bad(path, f"has {kind.name} records but another measurement mode: it is damaged")
    tick = tags.get("MeasDesc_GlobalResolution")
    if not (isinstance(tick, float) and TICKS_S[0] <= tick <= TICKS_S[1]):
        raise _bad(path, f"is damaged: its time resolution is {str(tick)[:40]}, not 1e-15 to 1 s")
    delay = tags.get("MeasDesc_Resolution") if kind.mode == "T3" else None
    claimed = _integer(tags, "TTResult_NumberOfRecords", path, 0)
    held = (size - offset) // 4
    problems = []
    if claimed > held:
        problems.append(f"{claimed - held} of {claimed} records are missing: the file is cut")
    elif claimed <= 0 < size - offset:
        problems.append("the header gives no number of records: the recording was not ended")
    elif 4 * claimed < size - offset:
        extra = size - offset - 4 * claimed
        problems.append(f"{extra} bytes follow the {claimed} records that the header gives")
    return Header(
        path=Path(path),
        tags=tags,
        kind=kind,
        records=min(claimed, held) if claimed > 0 else held,
        offset=offset,
        tick_s=tick,
        delay_s=delay if isinstance(delay, float) else None,
        problems=tuple(problems),
    )


def inspect(path: str | os.PathLike[str], progress: Progress | None = None) -> Contents:
    """Count what is in a file.

    Damaged records do not raise: `problems` names the first, and what stands before it is counted.

    Raises
    ------
    InputError
        As `read_header`.
    """
    header = read_header(path)
    kind, problems = header.kind, list(header.problems)
    photons = np.zeros(kind.first + kind.inputs, np.int64)
    markers = np.zeros(16, np.int64)
    records = overflows = syncs = 0
    first, last = LATEST, -1
    for part in _parts(header, progress):
        records += len(part.words)
        fields = np.bincount(part.words >> kind.shift, minlength=len(photons))
        photons += fields[: len(photons)]
        markers += np.bincount(part.bits, minlength=16)
        overflows += int(np.count_nonzero(part.wraps))
        syncs += int(np.count_nonzero(part.sync))
        times = np.concatenate([part.runs.low, part.runs.high, part.times[part.wraps == 0]])
        if len(times):
            first, last = min(first, int(times.min())), max(last, int(times.max()))
        if part.fault:
            problems.append(part.fault)
    return Contents(
        kind=kind.name,
        tick_s=header.tick_s,
        records=records,
        photons={k - kind.first: int(n) for k, n in enumerate(photons) if n},
        markers={
            bit: int(markers[np.arange(16) & bit != 0].sum())
            for bit in (1, 2, 4, 8)
            if markers[np.arange(16) & bit != 0].any()
        },
        overflows=overflows,
        syncs=syncs,
        first=first if last >= 0 else None,
        last=last if last >= 0 else None,
        span_s=max(last, 0) * header.tick_s,
        problems=tuple(problems),
    )


def read_markers(
    path: str | os.PathLike[str], progress: Progress | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Markers of a file, in its order.

    Those of a file that is cut are given as far as it goes; see `Header.problems`. Whether times
    run back is not looked at here.

    Returns
    -------
    times : int64 array, shape (n,)
        Ticks.
    bits : uint8 array, shape (n,)
        1 to 15: which of the four marker inputs.

    Raises
    ------
    InputError
        As `read_header`, and if a record is damaged or more than 2^24 are markers.
    """
    header = read_header(path)
    times, bits, found = [np.zeros(0, np.int64)], [np.zeros(0, np.uint8)], 0
    for part in _parts(header, progress, ordered=False):
        part.check(header)
        which = np.flatnonzero(part.bits)
        times.append(part.times[which])
        bits.append(part.bits[which].astype(np.uint8))
        found += len(which)
        if found > MOST_MARKERS:
            raise _bad(path, f"has more than {MOST_MARKERS} markers; give one for each frame")
    return np.concatenate(times), np.concatenate(bits)


def count_gates(
    path: str | os.PathLike[str],
    starts: np.ndarray,
    stops: np.ndarray,
    inputs: Sequence[int] = (0,),
    progress: Progress | None = None,
) -> np.ndarray:
    """Count the photons in each gate.

    Parameters
    ----------
    path : path
    starts, stops : integer arrays, shape (gates,)
        Ticks; a photon counts if start <= time < stop. Gates rise and do not overlap.
    inputs : sequence of int
        Which inputs; 0 is input 1. Sync events are none.
    progress : callable, optional
        Told the share done.

    Returns
    -------
    int64 array, shape (gates, len(inputs))

    Raises
    ------
    InputError
        As `read_header`; if a record is damaged; if gates do not rise or an input cannot be; if
        the file is cut, or holds more or less than its header says, and a gate ends after the last
        time that it holds.
    """
    header = read_header(path)
    kind = header.kind
    for each in inputs:
        if not 0 <= each < kind.inputs:
            raise InputError(f"input {each} is not one of {kind.name}: give 0 to {kind.inputs - 1}")
    edges = _edges(starts, stops)
    before = np.zeros((len(edges), len(inputs)), np.int64)
    so_far = np.zeros(len(inputs), np.int64)
    done, reached = 0, -1
    for part in _parts(header, progress):
        part.check(header)
        reached = part.reached
        until = done
        if len(part.runs.high):
            until = int(np.searchsorted(edges, part.runs.high[-1], side="right"))
        places = part.find(edges[done:until])
        for column, each in enumerate(inputs):
            here, total = part.count(each, places)
            before[done:until, column] = so_far[column] + here
            so_far[column] += total
        done = until
    before[done:] = so_far
    if header.problems and len(edges) and edges[-1] > reached:
        raise _bad(
            path,
            f"may lack records ({header.problems[0]}) and holds times up to {reached}, but gates "
            f"end at {edges[-1]}: count only gates that end before",
        )
    return before[1::2] - before[::2]


class Writer:
    """Writes a T2 file of type Generic, as a context manager.

    The file appears when the block ends. If the block fails there is none.

    Parameters
    ----------
    path : path
    tick_s : float
        Seconds of a tick.
    """

    def __init__(self, path: str | os.PathLike[str], tick_s: float = 1e-12) -> None:
        if not TICKS_S[0] <= tick_s <= TICKS_S[1]:
            raise InputError(f"a tick of {tick_s!r} s is not allowed: give 1e-15 to 1")
        self._path, self._tick_s = path, float(tick_s)
        self._records = self._latest = self._wraps = 0

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            self._file = stack.enter_context(open_atomically(self._path))
            stack.push(self._finish)
            self._file.write(self._header())
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def write(self, times: np.ndarray, codes: np.ndarray) -> None:
        """Append events.

        Parameters
        ----------
        times : integer array, shape (n,)
            Ticks, rising over all calls; equal ones are allowed.
        codes : integer array, shape (n,)
            0 to 63: a photon on that input, 0 for input 1. -1 to -15: a marker with the bits of
            the negative.

        Raises
        ------
        InputError
            If times run back, are negative or above 2^55 (ten hours of ps), or a code is none of
            these.
        """
        times, codes = np.asarray(times), np.asarray(codes)
        if times.ndim != 1 or times.shape != codes.shape:
            raise InputError(f"{times.shape} times and {codes.shape} codes: give one for each")
        for given in (times, codes):
            if given.dtype.kind not in "iu":
                raise InputError(f"times and codes of {given.dtype} are not allowed: give integers")
        for start in range(0, len(times), 2**18):
            self._write(times[start : start + 2**18], codes[start : start + 2**18])

    def _write(self, times: np.ndarray, codes: np.ndarray) -> None:
        if int(times[0]) < self._latest or (times[1:] < times[:-1]).any():
            raise InputError("times run back: give events in order, none before 0")
        if int(times[-1]) > LATEST_WRITTEN:
            raise InputError(f"time {times[-1]} is not allowed: give at most {LATEST_WRITTEN}")
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

    def _finish(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write the header again, which now knows the number of records."""
        if error is None:
            self._file.seek(0)
            self._file.write(self._header())

    def _header(self) -> bytes:
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
            _encode(name, value) for name, value in tags.items()
        )


# Records -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Runs:
    """Photons between two specials; runs without any are left out.

    Attributes
    ----------
    begin, end : arrays, shape (r,)
        Place of the first photon, and the place after the last.
    base : array, shape (r,)
        The time from which their fields count.
    low, high : arrays, shape (r,)
        Time of the first photon and of the last.
    """

    begin: np.ndarray
    end: np.ndarray
    base: np.ndarray
    low: np.ndarray
    high: np.ndarray


@dataclass
class _Part:
    """Some records that follow each other, decoded as far as is needed to count.

    The specials stand at `places`, shape (s,). Of each there are `times`, `bits` (0 if it is no
    marker), `sync`, and `wraps` (0 if it is no overflow). No photon or sync event after this part
    is earlier than `reached`. `fault` says what is wrong with the record that follows.
    """

    kind: Kind
    words: np.ndarray
    places: np.ndarray
    times: np.ndarray
    bits: np.ndarray
    sync: np.ndarray
    wraps: np.ndarray
    runs: _Runs
    reached: int
    fault: str = ""

    def check(self, header: Header) -> None:
        """Raise `InputError` if there is a fault."""
        if self.fault:
            raise _bad(header.path, f"is damaged: {self.fault}; record again")

    def find(self, edges: np.ndarray) -> np.ndarray:
        """Places of the first photons at or after some times, none later than the last photon."""
        run = np.searchsorted(self.runs.high, edges)
        wanted = edges - self.runs.base[run]
        low, high = self.runs.begin[run], self.runs.end[run] - 1
        while (low < high).any():
            middle = (low + high) >> 1
            later = self.words[middle] & self.kind.time_mask < wanted
            low = np.where(later, middle + 1, low)
            high = np.where(later, high, middle)
        return low

    def count(self, number: int, places: np.ndarray) -> tuple[np.ndarray, int]:
        """Photons on an input before each of some places, and all of them."""
        field = self.kind.first + number
        found = self.words < np.uint32(field + 1 << self.kind.shift)
        if field:
            found &= self.words >= np.uint32(field << self.kind.shift)
        total = int(np.count_nonzero(found))
        if total == len(self.words) - len(self.places):  # all photons
            return places - np.searchsorted(self.places, places), total
        if not (total and len(places)):
            return np.zeros(len(places), np.int64), total
        bounds = np.unique(np.append(0, places))
        sums = np.append(0, np.cumsum(np.add.reduceat(found, bounds, dtype=np.int64)))
        return sums[np.searchsorted(bounds, places)], total


@dataclass(frozen=True)
class _State:
    """What the records so far leave to those that follow.

    Attributes
    ----------
    wraps : int
        Overflows.
    latest : int
        Time of the last photon or sync event.
    after : int
        The same, or earliest time that may follow a marker if that was last.
    """

    wraps: int = 0
    latest: int = 0
    after: int = 0


class _Damage(Exception):
    """Some records are damaged: the place of the first, and how."""


def _parts(header: Header, progress: Progress | None, ordered: bool = True) -> Iterator[_Part]:
    """Decode a file in parts. Where a record is damaged they end before it, with a `fault`.

    Unless `ordered`, neither runs are found nor whether times run back.
    """
    state = _State()
    slack = max(round(MARKER_SLACK_S / header.tick_s), 1)
    buffer = np.empty(CHUNK, "<u4")
    with _opened(header.path) as file:
        file.seek(header.offset)
        for first in range(0, header.records, CHUNK):
            words = buffer[: header.records - first]
            if file.readinto(words.data.cast("B")) != words.nbytes:
                raise _bad(header.path, "became shorter while it was read: wait for its end")
            try:
                part, state = _decode(header.kind, words, state, slack, ordered)
            except _Damage as damage:
                place, how = damage.args
                part, _ = _decode(header.kind, words[:place], state, slack, ordered)
                part.fault = f"record {first + place + 1} of {header.records} has {how}"
                yield part
                return
            yield part
            if progress:
                progress((first + len(words)) / header.records)


def _decode(
    kind: Kind, words: np.ndarray, state: _State, slack: int, ordered: bool
) -> tuple[_Part, _State]:
    places, back = _scan(kind, words, ordered)
    wraps, bits, sync, values = _specials(kind, words[places].astype(np.int64))
    damages = [(places[~((wraps > 0) | (bits > 0) | sync)], "no known meaning")]

    total = state.wraps + np.cumsum(wraps)
    damages.append((places[total > LATEST // kind.wrap], f"a time beyond {LATEST} ticks"))
    bases = kind.wrap * np.minimum(np.append(state.wraps, total), LATEST // kind.wrap)
    times = bases[1:] + values

    runs = _Runs(*np.zeros((5, 0), np.int64))
    latest = after = 0
    if ordered:
        runs = _find_runs(words, places, bases, kind.time_mask)
        exact = _merge((runs.begin, runs.low, runs.high), (places[sync], times[sync], times[sync]))
        marked = times[bits > 0]
        loose = _merge(exact, (places[bits > 0], marked + slack, marked - slack))
        late, latest = _follow(exact, state.latest)
        later, after = _follow(loose, state.after)
        damages += [(back, BACK), (late, BACK), (later, BACK)]

    first = [(int(where[0]), how) for where, how in damages if len(where)]
    if first:
        raise _Damage(*min(first))
    part = _Part(
        kind=kind,
        words=words,
        places=places,
        times=times,
        bits=bits,
        sync=sync,
        wraps=wraps,
        runs=runs,
        reached=max(int(bases[-1]), latest),
    )
    return part, _State(int(bases[-1]) // kind.wrap, latest, after)


def _find_runs(words: np.ndarray, places: np.ndarray, bases: np.ndarray, mask: int) -> _Runs:
    begin, end = np.append(0, places + 1), np.append(places, len(words))
    full = begin < end
    begin, end, base = begin[full], end[full], bases[full]
    return _Runs(begin, end, base, base + (words[begin] & mask), base + (words[end - 1] & mask))


def _scan(kind: Kind, words: np.ndarray, ordered: bool) -> tuple[np.ndarray, np.ndarray]:
    """Places of the specials, and of photons earlier than a photon right before them.

    The latter are not looked for unless `ordered`.
    """
    specials, backs = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for start in range(0, len(words), BLOCK):
        block = words[start : start + BLOCK + 1]  # and the first of the next
        special = block >= np.uint32(kind.first + kind.inputs << kind.shift)
        if kind.first:
            special |= block < np.uint32(kind.first << kind.shift)
        specials.append(np.flatnonzero(special[:BLOCK]) + start)
        if not ordered:
            continue
        times = block & np.uint32(kind.time_mask)
        back = (times[1:] < times[:-1]) > (special[1:] | special[:-1])
        if back.any():
            backs.append(np.flatnonzero(back) + start + 1)
    return np.concatenate(specials), np.concatenate(backs)


_Events = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Where photons and other events stand among the records, their first times and their last."""


def _merge(one: _Events, other: _Events) -> _Events:
    """Join events in the order of records."""
    if not len(other[0]):
        return one
    places, lows, highs = (np.concatenate(pair) for pair in zip(one, other, strict=True))
    order = np.argsort(places, kind="stable")
    return places[order], lows[order], highs[order]


def _follow(events: _Events, latest: int) -> tuple[np.ndarray, int]:
    """Where events begin before the one before has ended, and the end of the last."""
    places, lows, highs = events
    ends = np.append(latest, highs)
    return places[lows < ends[:-1]], int(ends[-1])


def _specials(
    kind: Kind, words: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Overflows, marker bits, whether it is a sync event, and times of records that are special.

    All but the times are 0 of a record that has no meaning.
    """
    times, codes = words & kind.time_mask, words >> kind.shift
    if kind in (PICOHARP_T2, PICOHARP_T3):
        valid = codes == 15
        bits = words & 15 if kind.mode == "T2" else words >> kind.time_bits & 0xFFF
        wraps = (valid & (bits == 0)).astype(np.int64)
        sync = np.zeros(len(words), bool)
    else:
        codes = codes & 63
        valid = codes != 63
        bits = codes
        wraps = np.where(valid, 0, np.maximum(times, 1) if kind.counted else 1)
        sync = (codes == 0) & (kind.mode == "T2")
    return wraps, np.where(valid & (bits < 16), bits, 0), sync, times


# Header ------------------------------------------------------------------------------------------

NUMBERS = {
    0xFFFF0008: "Empty8",
    0x00000008: "Bool8",
    0x10000008: "Int8",
    0x11000008: "BitSet64",
    0x12000008: "Color8",
    0x20000008: "Float8",
    0x21000008: "TDateTime",
}
"""Types of tags whose value is a number."""

SIZED = {
    0x2001FFFF: "Float8Array",
    0x4001FFFF: "AnsiString",
    0x4002FFFF: "WideString",
    0xFFFFFFFF: "BinaryBlob",
}
"""Types of tags whose value is the number of bytes that follow."""


def _read_tags(file: FileIO, path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read the header; the file is then at its first record."""
    start = file.read(16)
    if start[:8].rstrip(b"\0") != MAGIC:
        raise _bad(path, f"is not a PTU file: it begins with {start[:8]!r}, not {MAGIC!r}")
    tags: dict[str, Any] = {}
    while True:
        raw = file.read(48)
        if len(raw) < 48 or file.tell() > LONGEST_HEADER:
            raise _bad(path, f"has a header without an end within {LONGEST_HEADER} bytes")
        ident, index, code, value = struct.unpack("<32siI8s", raw)
        name = ident.split(b"\0")[0].decode("ascii", "replace")
        if name == "Header_End":
            return tags
        key = name if index < 0 else f"{name}({index})"
        if code in NUMBERS:
            tags[key] = _number(NUMBERS[code], value)
        elif code in SIZED:
            (size,) = struct.unpack("<q", value)
            content = file.read(size) if 0 <= size <= LONGEST_HEADER else b""
            if len(content) != size:
                raise _bad(path, f"is damaged: its tag {key!r} is of {size} bytes")
            tags[key] = _text(SIZED[code], content)
        else:
            raise _bad(path, f"is damaged: its tag {key!r} is of unknown type {code:#010x}")


def _number(kind: str, value: bytes) -> bool | int | float | None:
    if kind == "Empty8":
        return None
    number: int | float = struct.unpack("<d" if kind in ("Float8", "TDateTime") else "<q", value)[0]
    return bool(number) if kind == "Bool8" else number


def _text(kind: str, content: bytes) -> str | bytes | np.ndarray:
    if kind == "AnsiString":
        return content.rstrip(b"\0").decode("windows-1252", "replace")
    if kind == "WideString":
        return content.decode("utf-16-le", "replace").rstrip("\0")
    if kind == "Float8Array":
        return np.frombuffer(content[: len(content) // 8 * 8], "<f8")
    return content


def _encode(name: str, value: str | int | float | None) -> bytes:
    """Write one tag."""
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


def _integer(
    tags: dict[str, Any], name: str, path: str | os.PathLike[str], default: int | None = None
) -> int:
    """Integer of a tag, or the default where there is none."""
    value = tags.get(name, default)
    if not isinstance(value, int):
        raise _bad(path, f"is damaged: its tag {name!r} is {str(value)[:40]!r}, not an integer")
    return value


@contextlib.contextmanager
def _opened(path: str | os.PathLike[str]) -> Iterator[FileIO]:
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise _bad(path, "is not a file")
        file = open(path, "rb", buffering=0)  # noqa: SIM115 - errors of what follows are not ours
    except OSError as error:
        raise _bad(path, f"cannot be read: {error.strerror}") from None
    with file:
        yield file


def _bad(path: str | os.PathLike[str], what: str) -> InputError:
    return InputError(f"{path} {what}")


def _edges(starts: np.ndarray, stops: np.ndarray) -> np.ndarray:
    """Starts and stops in turn, int64, shape (2 gates,)."""
    starts, stops = np.asarray(starts), np.asarray(stops)
    if starts.ndim != 1 or starts.shape != stops.shape:
        raise InputError(f"{starts.shape} starts and {stops.shape} stops: give one for each gate")
    for given in (starts, stops):
        if len(given) and given.dtype.kind not in "iu":
            raise InputError(f"gates in {given.dtype} are not allowed: give integer ticks")
    edges = np.stack([starts, stops], axis=1).astype(np.int64).ravel()
    if (edges[1:] < edges[:-1]).any():
        raise InputError("gates overlap or run back: give them in order, each start <= its stop")
    return edges

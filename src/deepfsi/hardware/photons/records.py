"""Records of a PTU file, decoded part by part as far as counting needs."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.hardware.photons.ptu import PICOHARP_T2, PICOHARP_T3, Kind

RECORDS_IN_MEMORY = 2**19
"""Records in memory at once."""

RECORDS_IN_CACHE = 2**17
"""Records scanned at once: they and what is made of them stay in the processor's cache."""

LATEST_TICK = 2**61
"""Latest time that is read, ticks."""

EARLIEST_TICK = -(2**62)
"""A time before all others, ticks."""

RUNS_BACK = "a time before that of the record before"
"""Fault of a record whose time is too early."""


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
        """Markers in their order: times in ticks, int64 (n,), and bits, uint8 (n,)."""
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
        """Photons on an input before each of some places, and all of them."""
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
    """Decoder of records that come in blocks, which may be of any length.

    Where a record is damaged, the part ends before it with a `fault`, and no more can be decoded.
    """

    def __init__(self, kind: Kind, tick_s: float, ordered: bool = True) -> None:
        self._kind = kind
        self._ordered = ordered
        self._slack = round(marker_slack_s(tick_s) / tick_s)
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
            damages += [(back, RUNS_BACK), (late, RUNS_BACK), (later, RUNS_BACK)]

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


def marker_slack_s(tick_s: float) -> float:
    """Seconds by which a marker may stand too early or too late: a tick, if that is longer."""
    # By how much a marker may stand too early or too late among photons, seconds
    return max(1e-6, tick_s)


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
        wraps = np.where(valid, 0, np.maximum(times, 1) if kind.counted else 1)
        sync = (codes == 0) & (kind.mode == "T2")
    return wraps, np.where(valid & (bits < 16), bits, 0), sync, times

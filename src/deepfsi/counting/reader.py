"""Photons read from their source: markers, times, what a file holds, and counts in windows.

A record is a photon on one of the inputs, or *special*: a marker, a sync event (T2 only), or an
overflow, after which times count from one *wrap* later. Specials are few. So photons are counted
without their times: between two specials the records' time fields rise, and the edge of a window
is searched for there.

Times are in *ticks*. In T2 a tick is the resolution of the device. In T3 it is a period of the
sync, and a photon's delay after it is not read.

Times that run back, and records that mean nothing, are refused: a file that has them is damaged.
Markers alone may stand up to 1 µs (or one tick) too early or too late among photons: devices sample
them more coarsely.
"""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.files import open_regular
from deepfsi.base.models import StrictModel
from deepfsi.base.progress import SILENT, Progress
from deepfsi.base.quantities import Table, time_text
from deepfsi.counting import ptu
from deepfsi.counting.ptu import (
    EARLIEST_TICK,
    GENERIC_T2,
    LATEST_TICK,
    Decoder,
    Header,
    Part,
)


class PtuFile:
    """PTU file that is there as a whole, or as far as it was recorded."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.header = Header.read(path)

    def parts(self, progress: Progress = SILENT, ordered: bool = True) -> Iterator[Part]:
        """Give the records in parts, each valid until the next; none follows one with a `fault`."""
        header = self.header
        decoder = Decoder(header.kind, header.tick_s, ordered)
        buffer = np.empty(ptu.RECORDS_IN_MEMORY, "<u4")
        with open_regular(header.path, buffering=0) as file:
            file.seek(header.offset)
            for start in range(0, header.records, len(buffer)):
                words = buffer[: header.records - start]
                if file.readinto(words.data.cast("B")) != words.nbytes:
                    raise InputError(
                        f"{header.path} became shorter while it was read: wait for its end"
                    )
                for part in decoder.parts(words):
                    yield part
                    if part.fault:
                        return
                progress((start + len(words)) / header.records)


class PtuStream:
    """PTU file whose bytes arrive in any cuts: from a pipe, or a file that grows.

    Its `header` is there when it has `begun`.
    """

    header: Header

    def __init__(self, name: str | os.PathLike[str] = "the stream") -> None:
        self._parser = Header.parse(name)
        self._needed = next(self._parser)
        self._rest = bytearray()  # bytes of the header, or of a record that is not complete
        self._records_left = 0
        self._decoder: Decoder | None = None
        self._arrived: list[memoryview] = []  # bytes after the header that are not read yet

    @classmethod
    def without_header(cls, name: str | os.PathLike[str], tick_s: float) -> Self:
        """Stream of T2 records of type Generic alone, as a device gives them."""
        stream = cls(name)
        stream._begin(Header(Path(name), GENERIC_T2, offset=0, tick_s=tick_s, claimed=0))
        return stream

    @property
    def begun(self) -> bool:
        """True when the header has arrived."""
        return self._decoder is not None

    def feed(self, data: bytes | bytearray | memoryview) -> None:
        """Take the next bytes, which `parts` then reads: do not change them before."""
        view = memoryview(data)
        if not view.nbytes:  # numpy's empty arrays cannot be cast
            return
        view = view.cast("B")
        while self._decoder is None:  # these are bytes of the header
            taken = self._needed - len(self._rest)
            self._rest += view[:taken]
            view = view[taken:]
            if len(self._rest) < self._needed:
                return
            try:
                self._needed = self._parser.send(bytes(self._rest))
            except StopIteration as end:
                self._begin(end.value)
            self._rest.clear()
        self._arrived.append(view)

    def parts(self, progress: Progress = SILENT, ordered: bool = True) -> Iterator[Part]:
        """Give the records that ended with the bytes that came since the last call, in order.

        What follows the records that the header gives is not read. A part holds on to the bytes.
        """
        while self._arrived and self._decoder:
            view = self._arrived.pop(0)
            if not self._records_left:
                continue
            if self._rest:
                view = memoryview(bytes(self._rest) + view)
            count = min(len(view) // 4, self._records_left)
            self._rest = bytearray(view[4 * count :][:3])
            for part in self._decoder.parts(np.frombuffer(view, "<u4", count)):
                self._records_left = 0 if part.fault else self._records_left - len(part.words)
                yield part

    def _begin(self, header: Header) -> None:
        self.header = header
        self._records_left = header.records
        self._decoder = Decoder(header.kind, header.tick_s)


PhotonSource = PtuFile | PtuStream
Photons = PhotonSource | str | os.PathLike[str]
"""A source, or the path of a PTU file."""


def _as_source(photons: Photons) -> PhotonSource:
    return PtuFile(photons) if isinstance(photons, str | os.PathLike) else photons


class PtuSummary(StrictModel):
    """Photons, markers and other records of a PTU file."""

    kind: str
    tick_s: float  # seconds of a tick
    records: int  # records read. Fewer than the file's if `problems` says that one is damaged
    photons: dict[int, int]  # photons on each input that has any; 0 is input 1
    markers: dict[int, int]  # markers with each bit, 1, 2, 4 and 8, that is ever set
    overflows: int
    syncs: int  # sync records (T2)
    first: int | None  # times of the earliest and latest photon, marker or sync, ticks
    last: int | None
    span_s: float  # seconds from the start of the recording to the latest of them
    problems: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """JSON types only, inputs and markers by their numbers on the counter."""
        return self.model_dump() | {
            "photons": {number + 1: count for number, count in self.photons.items()},
            "markers": {bit.bit_length() - 1: count for bit, count in self.markers.items()},
        }

    def table(self, title: str) -> Table:
        """All of it under a title."""
        inputs = self.photons.items()
        markers = self.markers.items()
        rows = [
            ("record type", self.kind),
            ("time unit", time_text(self.tick_s)),
            ("records", str(self.records)),
            *((f"photons on input {number + 1}", str(count)) for number, count in inputs),
            *((f"markers on {bit.bit_length() - 1}", str(count)) for bit, count in markers),
            ("overflow records", str(self.overflows)),
            ("sync records", str(self.syncs)),
            ("span", time_text(self.span_s)),
            *(("problem", problem) for problem in self.problems),
        ]
        return Table(title, ("what", "value"), rows)


def summarise(photons: Photons, progress: Progress = SILENT) -> PtuSummary:
    """Count the photons, markers and other records of a file.

    Damaged records do not raise: `problems` names the first, and what stands before it is counted.

    Parameters
    ----------
    photons
        A source, or the path of a PTU file.
    progress
        Told how much of it is read.

    Returns
    -------
    PtuSummary
        What there is of each sort of record.

    Raises
    ------
    InputError
        If it is no PTU file, or its header is damaged.
    """
    source = _as_source(photons)
    header = source.header
    inputs = np.zeros(header.kind.inputs, np.int64)
    markers = np.zeros(16, np.int64)
    records_read = overflows = syncs = 0
    first = LATEST_TICK
    last = -1
    faults: tuple[str, ...] = ()
    for part in source.parts(progress):
        records_read += len(part.words)
        inputs += part.totals
        markers += np.bincount(part.bits, minlength=16)
        overflows += int(np.count_nonzero(part.wraps))
        syncs += int(np.count_nonzero(part.sync))
        times = np.concatenate([part.runs.low, part.runs.high, part.times[part.wraps == 0]])
        if len(times):
            first = min(first, int(times.min()))
            last = max(last, int(times.max()))
        if part.fault:
            faults = (part.fault,)
    bits = {bit: int(markers[np.arange(16) & bit != 0].sum()) for bit in (1, 2, 4, 8)}
    return PtuSummary(
        kind=header.kind.name,
        tick_s=header.tick_s,
        records=records_read,
        photons={number: int(n) for number, n in enumerate(inputs) if n},
        markers={bit: n for bit, n in bits.items() if n},
        overflows=overflows,
        syncs=syncs,
        first=first if last >= 0 else None,
        last=last if last >= 0 else None,
        span_s=max(last, 0) * header.tick_s,
        problems=header.problems + faults,
    )


def read_markers(photons: Photons, progress: Progress = SILENT) -> tuple[np.ndarray, np.ndarray]:
    """Read the markers of a file, in its order.

    A file that is cut gives its markers as far as it goes. Whether times run back is not looked at.

    Parameters
    ----------
    photons
        A source, or the path of a PTU file.
    progress
        Told how much of it is read.

    Returns
    -------
    times
        Ticks, int64 (n,).
    bits
        Which of the four marker inputs have one, 1 to 15, uint8 (n,).

    Raises
    ------
    InputError
        If the file is damaged, or has more than 2^24 markers.
    """
    source = _as_source(photons)
    times = [np.zeros(0, np.int64)]
    bits = [np.zeros(0, np.uint8)]
    total = 0
    for part in source.parts(progress, ordered=False):
        part.check(source.header.path)
        ticks, which = part.markers
        times.append(ticks)
        bits.append(which)
        total += len(ticks)
        if total > 2**24:
            raise InputError(
                f"{source.header.path} has more than {2**24} markers: give one for each frame"
            )
    return np.concatenate(times), np.concatenate(bits)


def read_photons(
    photons: Photons, number: int = 0, progress: Progress = SILENT
) -> tuple[np.ndarray, float]:
    """Read the times of the photons on an input."""
    source = _as_source(photons)
    _check_inputs(source, (number,))
    times = [np.zeros(0, np.int64)]
    reached = total = 0
    for part in source.parts(progress):
        part.check(source.header.path)
        times.append(part.photons(number))
        reached = part.reached
        total += len(times[-1])
        if total > 2**27:  # their times are held at once
            raise InputError(
                f"{source.header.path} has more than {2**27} photons: give a shorter record"
            )
    tick_s = source.header.tick_s
    return np.concatenate(times) * tick_s, reached * tick_s


def count_windows(
    photons: Photons,
    starts: np.ndarray,
    stops: np.ndarray,
    inputs: Sequence[int] = (0,),
    progress: Progress = SILENT,
) -> np.ndarray:
    """Count the photons in each window of time.

    Parameters
    ----------
    photons
        A source, or the path of a PTU file.
    starts, stops
        Ticks, integers (windows,), in order: each start is at or after the stop before. A photon
        at the start is counted, and one at the stop is not.
    inputs
        Inputs whose photons are counted, from 0.
    progress
        Told how much is read.

    Returns
    -------
    numpy.ndarray
        Photons, int64 (windows, inputs).

    Raises
    ------
    InputError
        If windows overlap, the file is damaged, or it may end before the last window.
    """
    source = _as_source(photons)
    counter = WindowCounter(source, inputs)
    counter.expect(starts, stops)
    for part in source.parts(progress):
        part.check(source.header.path)
        counter.add(part)
    return counter.finish()


class WindowCounter:
    """Counts photons in windows; each is told before it begins."""

    def __init__(self, source: PhotonSource, inputs: Sequence[int]) -> None:
        _check_inputs(source, inputs)
        self._source = source
        self._inputs = tuple(inputs)
        self._edges = np.zeros(0, np.int64)  # starts and stops in turn, of windows not yet taken
        self._before = np.zeros((0, len(inputs)), np.int64)  # photons before each edge, in `_done`
        self._done = 0
        self._total = np.zeros(len(inputs), np.int64)
        self._latest = EARLIEST_TICK
        self._reached = -1  # no photon of parts to come is earlier

    def expect(self, starts: np.ndarray, stops: np.ndarray) -> None:
        """Count further windows; shapes as in `count_windows`."""
        if not len(starts):
            return
        edges = np.stack([starts, stops], axis=1).astype(np.int64).ravel()
        every = np.concatenate([self._edges, edges])
        if (every[1:] < every[:-1]).any():
            raise InputError(
                "gates overlap or run back: give them in order, each start <= its stop"
            )
        if edges[0] <= self._latest:
            raise InputError(
                f"{self._source.header.path} holds photons up to {self._latest}, and a gate begins "
                f"at {edges[0]}: tell gates before they begin"
            )
        self._edges = every
        unknown = np.zeros((len(edges), len(self._inputs)), np.int64)
        self._before = np.concatenate([self._before, unknown])

    def add(self, part: Part) -> None:
        """Count the photons of the next part."""
        edges = self._edges[self._done :]
        until = 0
        if len(part.runs.high):
            self._latest = int(part.runs.high[-1])
            until = int(np.searchsorted(edges, self._latest, side="right"))
        places = part.find(edges[:until])
        before = self._before[self._done :]
        for column, number in enumerate(self._inputs):
            earlier, total = part.count(number, places)
            before[:until, column] = self._total[column] + earlier
            self._total[column] += total
        self._reached = part.reached
        ended = max(until, int(np.searchsorted(edges, self._reached, side="right")))
        before[until:ended] = self._total
        self._done += ended

    def take(self) -> np.ndarray:
        """Counts of the windows that ended since the last call, int64 (windows, inputs)."""
        windows = self._done // 2
        before = self._before[: 2 * windows]
        self._edges = self._edges[2 * windows :]
        self._before = self._before[2 * windows :]
        self._done -= 2 * windows
        return np.asarray(before[1::2] - before[::2])

    def finish(self) -> np.ndarray:
        """Give the counts of all windows since the last call: no more records come."""
        problems = self._source.header.problems
        if problems and len(self._edges) and self._edges[-1] > self._reached:
            raise InputError(
                f"{self._source.header.path} may lack records ({problems[0]}) and holds times up "
                f"to {self._reached}, but gates end at {self._edges[-1]}: count gates that end "
                "before"
            )
        self._before[self._done :] = self._total
        self._done = len(self._edges)
        return self.take()


def _check_inputs(source: PhotonSource, numbers: Sequence[int]) -> None:
    """Raise `InputError` unless a source has inputs of these numbers, from 0."""
    kind = source.header.kind
    for number in numbers:
        if not 0 <= number < kind.inputs:
            raise InputError(
                f"input {number}, counted from 0, is not one of {kind.name}: give 0 to "
                f"{kind.inputs - 1} (--input 1 to {kind.inputs})"
            )

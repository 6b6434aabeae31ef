"""Photons read from PTU files and streams: markers, times, summaries, and counts in windows.

A record is a photon on one of the inputs, a marker, a sync event (T2 only), or an overflow, after
which times count from one *wrap* later. Times are in *ticks*. In T2 a tick is the resolution of the
device. In T3 it is a period of the sync, and a photon's delay after it is not read.

Times that run back, and records that mean nothing, are refused: a file that has them is damaged.
Markers alone may stand up to 1 µs (or one tick) too early or too late among photons: devices sample
them more coarsely.
"""

import os
from collections.abc import Iterator, Sequence

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.files import open_regular
from deepfsi.base.models import StrictModel
from deepfsi.base.progress import SILENT, Progress
from deepfsi.base.quantities import Table, time_text
from deepfsi.counting import ptu
from deepfsi.counting.ptu import Decoded, Decoder, Header


class PtuFile:
    """PTU file that grows no more."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.header = Header.read(path)

    def blocks(self, progress: Progress = SILENT) -> Iterator[Decoded]:
        """Give the records in blocks, up to one with a `fault`."""
        header = self.header
        decoder = Decoder(header.kind, header.tick_s)
        with open_regular(header.path, buffering=0) as file:
            file.seek(header.offset)
            for start in range(0, header.records, ptu.RECORDS_AT_ONCE):
                wanted = min(ptu.RECORDS_AT_ONCE, header.records - start)
                content = file.read(4 * wanted)
                if len(content) < 4 * wanted:
                    raise InputError(
                        f"{header.path} became shorter while it was read: wait for its end"
                    )
                block = decoder.decode(np.frombuffer(content, "<u4"))
                yield block
                if block.fault:
                    return
                progress((start + wanted) / header.records)


class PtuStream:
    """PTU file whose bytes arrive in pieces of any size: from a pipe, or a file that grows.

    `header` exists once `begun` is true.
    """

    def __init__(self, name: str | os.PathLike[str] = "the stream") -> None:
        self._name = name
        self._data = bytearray()  # that is not read yet
        self._records_left = 0
        self._decoder: Decoder | None = None

    @property
    def begun(self) -> bool:
        """True when the header has arrived."""
        return self._decoder is not None

    def feed(self, data: bytes | bytearray | memoryview) -> None:
        """Take the next bytes, which `blocks` then reads."""
        self._data += data
        if self._decoder is None and (header := Header.parse(self._data, self._name)):
            self.header: Header = header
            self._records_left = header.records
            self._decoder = Decoder(header.kind, header.tick_s)
            del self._data[: header.offset]

    def blocks(self, progress: Progress = SILENT) -> Iterator[Decoded]:
        """Give the records that are complete since the last call.

        Bytes beyond the records that the header states are not read.
        """
        if self._decoder is None:
            return
        while count := min(len(self._data) // 4, self._records_left, ptu.RECORDS_AT_ONCE):
            words = np.frombuffer(bytes(self._data[: 4 * count]), "<u4")
            del self._data[: 4 * count]
            block = self._decoder.decode(words)
            self._records_left = 0 if block.fault else self._records_left - count
            yield block
        if not self._records_left:
            self._data.clear()


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
    photons: dict[int, int]  # photons on each input that has any, by its number on the counter
    markers: dict[int, int]  # markers on each marker input that has any, 0 to 3
    span_s: float  # seconds from the start of the recording to the latest photon, marker or sync
    problems: tuple[str, ...]

    def table(self, title: str) -> Table:
        """All of it under a title."""
        rows = [
            ("record type", self.kind),
            ("time unit", time_text(self.tick_s)),
            ("records", str(self.records)),
            *((f"photons on input {number}", str(n)) for number, n in self.photons.items()),
            *((f"markers on {number}", str(n)) for number, n in self.markers.items()),
            ("span", time_text(self.span_s)),
            *(("problem", problem) for problem in self.problems),
        ]
        return Table(title, ("what", "value"), rows)


def summarise(photons: Photons, progress: Progress = SILENT) -> PtuSummary:
    """Count the photons, markers and other records of a file, as far as it is not damaged."""
    source = _as_source(photons)
    header = source.header
    inputs = np.zeros(header.kind.inputs, np.int64)
    markers = np.zeros(16, np.int64)
    records_read = last = 0
    faults: tuple[str, ...] = ()
    for block in source.blocks(progress):
        records_read += block.records
        inputs += np.bincount(block.inputs, minlength=len(inputs))
        markers += np.bincount(block.bits, minlength=16)
        last = max(last, block.last)
        if block.fault:
            faults = (block.fault,)
    # A marker record has a bit for each marker input, and several may be set at once
    by_marker = [int(markers[np.arange(16) >> number & 1 != 0].sum()) for number in range(4)]
    return PtuSummary(
        kind=header.kind.name,
        tick_s=header.tick_s,
        records=records_read,
        photons={number: int(n) for number, n in enumerate(inputs, 1) if n},
        markers={number: n for number, n in enumerate(by_marker) if n},
        span_s=last * header.tick_s,
        problems=header.problems + faults,
    )


def read_markers(photons: Photons, progress: Progress = SILENT) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) of the markers of a file in ticks, and their bits (n,), 1 to 15.

    A file that is cut gives its markers as far as it goes.
    """
    source = _as_source(photons)
    times = [np.zeros(0, np.int64)]
    bits = [np.zeros(0, np.uint8)]
    total = 0
    for block in source.blocks(progress):
        block.check(source.header.path)
        times.append(block.marks)
        bits.append(block.bits)
        total += len(block.marks)
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
    times = [np.zeros(0, np.int64)]
    reached = total = 0
    for block in source.blocks(progress):
        block.check(source.header.path)
        times.append(block.times[block.inputs == number])
        reached = block.reached
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
    """Photons (windows, inputs) from each start up to its stop, ticks (windows,) that rise.

    Raises `InputError` if the file is damaged, or may end before the last window.
    """
    source = _as_source(photons)
    counter = WindowCounter(source, inputs)
    counter.expect(starts, stops)
    for block in source.blocks(progress):
        block.check(source.header.path)
        counter.add(block)
    return counter.finish()


class WindowCounter:
    """Counts photons in windows that are announced before they begin."""

    def __init__(self, source: PhotonSource, inputs: Sequence[int]) -> None:
        self._source = source
        self._inputs = tuple(inputs)
        self._edges = np.zeros(0, np.int64)  # starts and stops in turn, of windows not yet taken
        self._before = np.zeros((0, len(inputs)), np.int64)  # photons before each edge, in `_done`
        self._done = 0
        self._total = np.zeros(len(inputs), np.int64)
        self._reached = -1  # no photon of later blocks is earlier

    def expect(self, starts: np.ndarray, stops: np.ndarray) -> None:
        """Count further windows, as in `count_windows`; they begin after the last added photon."""
        edges = np.stack([starts, stops], axis=1).astype(np.int64).ravel()
        self._edges = np.concatenate([self._edges, edges])
        unknown = np.zeros((len(edges), len(self._inputs)), np.int64)
        self._before = np.concatenate([self._before, unknown])

    def add(self, block: Decoded) -> None:
        """Count the photons of the next block."""
        edges = self._edges[self._done :]
        self._reached = block.reached
        # Later records hold no photon before `reached`: edges up to there are settled
        ended = int(np.searchsorted(edges, self._reached, side="right"))
        before = self._before[self._done :]
        for column, number in enumerate(self._inputs):
            times = block.times[block.inputs == number]
            before[:ended, column] = self._total[column] + np.searchsorted(times, edges[:ended])
            self._total[column] += len(times)
        self._done += ended

    def take(self) -> np.ndarray:
        """Counts of the windows that ended since the last call, int64 (windows, inputs)."""
        windows = self._done // 2  # a window is settled when both its edges are
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
        # The file is whole: it holds no photon between its last record and these edges
        self._before[self._done :] = self._total
        self._done = len(self._edges)
        return self.take()

"""Contents of a PTU file, added up part by part."""

import numpy as np

from deepfsi.base.models import StrictModel
from deepfsi.hardware.photons.header import Header, Kind
from deepfsi.hardware.photons.records import LATEST_TICK, Part


class Contents(StrictModel):
    """Contents of a PTU file."""

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


class Tally:
    """Sum of the photons, markers and other records of parts that follow each other."""

    def __init__(self, kind: Kind) -> None:
        self._kind = kind
        self._photons = np.zeros(kind.first + kind.inputs, np.int64)
        self._markers = np.zeros(16, np.int64)
        self._records = self._overflows = self._syncs = 0
        self._first, self._last = LATEST_TICK, -1
        self._faults: tuple[str, ...] = ()

    def add(self, part: Part) -> None:
        """Add the records of the next part, and its fault."""
        self._records += len(part.words)
        fields = np.bincount(part.words >> self._kind.shift, minlength=len(self._photons))
        self._photons += fields[: len(self._photons)]
        self._markers += np.bincount(part.bits, minlength=16)
        self._overflows += int(np.count_nonzero(part.wraps))
        self._syncs += int(np.count_nonzero(part.sync))
        times = np.concatenate([part.runs.low, part.runs.high, part.times[part.wraps == 0]])
        if len(times):
            self._first = min(self._first, int(times.min()))
            self._last = max(self._last, int(times.max()))
        if part.fault:
            self._faults += (part.fault,)

    def contents(self, header: Header) -> Contents:
        """Contents of the parts so far, of a file with this header."""
        bits = {bit: int(self._markers[np.arange(16) & bit != 0].sum()) for bit in (1, 2, 4, 8)}
        last = self._last
        return Contents(
            kind=self._kind.name,
            tick_s=header.tick_s,
            records=self._records,
            photons={k - self._kind.first: int(n) for k, n in enumerate(self._photons) if n},
            markers={bit: n for bit, n in bits.items() if n},
            overflows=self._overflows,
            syncs=self._syncs,
            first=self._first if last >= 0 else None,
            last=last if last >= 0 else None,
            span_s=max(last, 0) * header.tick_s,
            problems=header.problems + self._faults,
        )

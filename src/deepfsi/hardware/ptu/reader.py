"""PicoQuant PTU files: their contents, markers, and photons counted between gates.

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

import os
from collections.abc import Sequence

import numpy as np
from pydantic import BaseModel, ConfigDict

from deepfsi.errors import InputError
from deepfsi.hardware.ptu.header import read_header
from deepfsi.hardware.ptu.records import LATEST_TICK, read_parts
from deepfsi.progress import SILENT, Report

MOST_MARKERS = 2**24
"""Markers of a file at most."""


class Contents(BaseModel):
    """Contents of a PTU file.

    Attributes
    ----------
    tick_s : float
        Seconds of a tick.
    records : int
        Records read. Fewer than the file's if `problems` says that one is damaged.
    photons : dict
        Photons on each input that has any; 0 is input 1.
    markers : dict
        Markers with each bit, 1, 2, 4 and 8, that is ever set.
    syncs : int
        Sync records (T2).
    first, last : int or None
        Times of the earliest and latest photon, marker or sync, ticks.
    span_s : float
        Seconds from the start of the recording to the latest of them.
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


def inspect(path: str | os.PathLike[str], report: Report = SILENT) -> Contents:
    """Count the photons, markers and other records of a file.

    Damaged records do not raise: `problems` names the first, and what stands before it is counted.
    """
    header = read_header(path)
    kind, problems = header.kind, list(header.problems)
    photons = np.zeros(kind.first + kind.inputs, np.int64)
    markers = np.zeros(16, np.int64)
    records = overflows = syncs = 0
    first, last = LATEST_TICK, -1
    for part in read_parts(header, report):
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
    set_bits = {bit: int(markers[np.arange(16) & bit != 0].sum()) for bit in (1, 2, 4, 8)}
    return Contents(
        kind=kind.name,
        tick_s=header.tick_s,
        records=records,
        photons={k - kind.first: int(n) for k, n in enumerate(photons) if n},
        markers={bit: n for bit, n in set_bits.items() if n},
        overflows=overflows,
        syncs=syncs,
        first=first if last >= 0 else None,
        last=last if last >= 0 else None,
        span_s=max(last, 0) * header.tick_s,
        problems=tuple(problems),
    )


def read_markers(
    path: str | os.PathLike[str], report: Report = SILENT
) -> tuple[np.ndarray, np.ndarray]:
    """Markers of a file, in its order: times in ticks, int64 (n,), and bits, uint8 (n,).

    Bits are 1 to 15: which of the four marker inputs. Those of a file that is cut are given as far
    as it goes; see `Header.problems`. Whether times run back is not looked at here. Raises
    `InputError` as `read_header`, and if a record is damaged or more than 2^24 are markers.
    """
    header = read_header(path)
    times, bits, found = [np.zeros(0, np.int64)], [np.zeros(0, np.uint8)], 0
    for part in read_parts(header, report, ordered=False):
        part.check(header)
        which = np.flatnonzero(part.bits)
        times.append(part.times[which])
        bits.append(part.bits[which].astype(np.uint8))
        found += len(which)
        if found > MOST_MARKERS:
            raise InputError(
                f"{path} has more than {MOST_MARKERS} markers; give one for each frame"
            )
    return np.concatenate(times), np.concatenate(bits)


def count_gates(
    path: str | os.PathLike[str],
    starts: np.ndarray,
    stops: np.ndarray,
    inputs: Sequence[int] = (0,),
    report: Report = SILENT,
) -> np.ndarray:
    """Count the photons in each gate.

    Parameters
    ----------
    starts, stops : integer arrays, shape (gates,)
        Ticks; a photon counts if start <= time < stop. Gates rise and do not overlap.
    inputs : sequence of int
        Which inputs; 0 is input 1. Sync events are none.

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
            raise InputError(
                f"input {each}, counted from 0, is not one of {kind.name}: give 0 to "
                f"{kind.inputs - 1} (--input 1 to {kind.inputs})"
            )
    edges = _edges(starts, stops)
    before = np.zeros((len(edges), len(inputs)), np.int64)
    so_far = np.zeros(len(inputs), np.int64)
    done, reached = 0, -1
    for part in read_parts(header, report):
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
        raise InputError(
            f"{path} may lack records ({header.problems[0]}) and holds times up to {reached}, but "
            f"gates end at {edges[-1]}: count only gates that end before"
        )
    return before[1::2] - before[::2]


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

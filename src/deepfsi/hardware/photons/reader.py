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

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Report
from deepfsi.hardware.photons.contents import Contents, Tally
from deepfsi.hardware.photons.gate_counter import GateCounter, check_input
from deepfsi.hardware.photons.header import read_header
from deepfsi.hardware.photons.records import read_parts

MOST_PHOTONS = 2**27
"""Photons whose times are held at once, at most."""

MOST_MARKERS = 2**24
"""Markers of a file at most."""


def inspect(path: str | os.PathLike[str], report: Report = SILENT) -> Contents:
    """Count the photons, markers and other records of a file."""
    # Damaged records do not raise: `problems` names the first, and what stands before it is counted
    header = read_header(path)
    tally = Tally(header.kind)
    for part in read_parts(header, report):
        tally.add(part)
    return tally.contents(header)


def read_markers(
    path: str | os.PathLike[str], report: Report = SILENT
) -> tuple[np.ndarray, np.ndarray]:
    """Markers of a file, in its order: times in ticks, int64 (n,), and bits, uint8 (n,)."""
    # Bits are 1 to 15: which of the four marker inputs. Those of a file that is cut are given as
    # far as it goes; see `Header.problems`. Whether times run back is not looked at here
    header = read_header(path)
    times, bits, found = [np.zeros(0, np.int64)], [np.zeros(0, np.uint8)], 0
    for part in read_parts(header, report, ordered=False):
        part.check(path)
        here, which = part.markers
        times.append(here)
        bits.append(which)
        found += len(here)
        if found > MOST_MARKERS:
            raise InputError(
                f"{path} has more than {MOST_MARKERS} markers; give one for each frame"
            )
    return np.concatenate(times), np.concatenate(bits)


def read_photons(
    path: str | os.PathLike[str], number: int = 0, report: Report = SILENT
) -> tuple[np.ndarray, float]:
    """Times of the photons on an input, seconds (n,), and that of the last event of all."""
    header = read_header(path)
    check_input(number, header.kind)
    times, reached, found = [np.zeros(0, np.int64)], 0, 0
    for part in read_parts(header, report):
        part.check(path)
        times.append(part.photons(number))
        reached, found = part.reached, found + len(times[-1])
        if found > MOST_PHOTONS:
            raise InputError(f"{path} has more than {MOST_PHOTONS} photons: give a shorter record")
    return np.concatenate(times) * header.tick_s, reached * header.tick_s


def count_gates(
    path: str | os.PathLike[str],
    starts: np.ndarray,
    stops: np.ndarray,
    inputs: Sequence[int] = (0,),
    report: Report = SILENT,
) -> np.ndarray:
    """Count the photons in each gate."""
    # starts, stops (gates,)
    header = read_header(path)
    counter = GateCounter(header.kind, inputs, path)
    counter.expect(starts, stops)
    for part in read_parts(header, report):
        part.check(path)
        counter.add(part)
    return counter.finish(header)

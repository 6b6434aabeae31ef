"""Time stamps of any counter, an event at a time with its channel, written as a PTU file.

A time tagger records the trigger of the device as one channel among the others. Here it becomes a
marker, and the channels of the detectors become inputs, so that all that reads PTU files works.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepfsi.errors import InputError
from deepfsi.hardware.ptu.header import GENERIC_T2, TICKS_S
from deepfsi.hardware.ptu.writer import Writer
from deepfsi.tables.array_files import HDF5, list_variables, read_variable
from deepfsi.tables.table_files import read_table

TIMES, CHANNELS = "photon_data/timestamps", "photon_data/detectors"
UNIT = "photon_data/timestamps_specs/timestamps_unit"
"""Names in a Photon-HDF5 file."""

MOST_EVENTS = 2**28
"""Events of a file at most."""

LARGEST_WHOLE = 2.0**53
"""Numbers above which a table's floating point leaves out whole ones."""


@dataclass(frozen=True)
class Stamps:
    """Events of a recording."""

    times: np.ndarray  # (n,): int64; times in ticks
    channels: np.ndarray  # (n,)
    tick_s: float  # seconds of a tick


def read_stamps(source: str | os.PathLike[str], unit_s: float | None = None) -> Stamps:
    """Time stamps of a Photon-HDF5 file, or of a table with columns of times and channels."""
    path = Path(source)
    if path.suffix.lower() not in HDF5:
        values = read_table(path).values
        if values.shape[1] != 2 or (values % 1 != 0).any() or np.abs(values).max() > LARGEST_WHOLE:
            raise InputError(
                f"{path} is no list of events: give two columns of whole numbers up to 2^53, the "
                "time and the channel of each"
            )
        times, channels = values.T.astype(np.int64)
        return Stamps(times, channels, _check_unit(unit_s, path))
    if not path.is_file():
        raise InputError(f"there is no file {path}: give a Photon-HDF5 file")
    found = list_variables(path, (0, 1))
    for name in (TIMES, CHANNELS):
        if len(found.get(name, ())) != 1:
            raise InputError(f"{path} is no Photon-HDF5 file of one spot: it lacks {name}")
    times, channels = (
        read_variable(path, name, found[name], MOST_EVENTS).astype(np.int64)
        for name in (TIMES, CHANNELS)
    )
    if times.shape != channels.shape:
        raise InputError(f"{path} has {len(times)} times and {len(channels)} detectors of them")
    if unit_s is None and UNIT in found:
        unit_s = float(read_variable(path, UNIT, found[UNIT], 1).ravel()[0])
    return Stamps(times, channels, _check_unit(unit_s, path))


def _check_unit(unit_s: float | None, path: Path) -> float:
    if unit_s is None or not TICKS_S[0] <= unit_s <= TICKS_S[1]:
        given = "no unit of its times" if unit_s is None else f"times in units of {unit_s:g} s"
        raise InputError(f"{path} has {given}: give `unit`, 1e-15 to 1 s, such as 1ps")
    return unit_s


def write_stamps(
    stamps: Stamps, path: str | os.PathLike[str], marker: int, inputs: tuple[int, ...] | None = None
) -> tuple[int, ...]:
    """Write events as a PTU file, and return the channels of its inputs."""
    there = np.unique(stamps.channels).tolist()
    known = f"there are some on {', '.join(map(str, there)) or 'none'}"
    chosen = tuple(each for each in there if each != marker) if inputs is None else inputs
    for each in (marker, *chosen):
        if each not in there:
            raise InputError(f"channel {each} has no events; {known}")
    if not chosen or len(chosen) > GENERIC_T2.inputs or len({marker, *chosen}) <= len(chosen):
        raise InputError(
            f"channels {', '.join(map(str, chosen)) or 'none'} for the detectors beside {marker} "
            f"for the trigger are not allowed: give 1 to {GENERIC_T2.inputs} other ones, each once"
        )
    codes = np.full(len(stamps.times), GENERIC_T2.inputs)
    codes[stamps.channels == marker] = -1
    for code, each in enumerate(chosen):
        codes[stamps.channels == each] = code
    kept = np.flatnonzero(codes < GENERIC_T2.inputs)
    order = kept[np.argsort(stamps.times[kept], kind="stable")]
    with Writer(path, stamps.tick_s) as writer:
        writer.write(stamps.times[order] - stamps.times[order[0]], codes[order])
    return chosen

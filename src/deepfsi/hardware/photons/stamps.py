"""Time stamps of any counter, an event at a time with its channel, written as a PTU file.

A time tagger records the trigger of the device as one channel among the others. Here it becomes a
marker, and the channels of the detectors become inputs, so that all that reads PTU files works.
"""

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepfsi.base.arrays import HDF5, list_variables, read_variable
from deepfsi.base.errors import InputError
from deepfsi.base.tables import as_whole, read_whole
from deepfsi.hardware.photons.header import GENERIC_T2, TICKS_S, refuse_foreign
from deepfsi.hardware.photons.writer import Writer

TIMES, CHANNELS = "photon_data/timestamps", "photon_data/detectors"
UNIT = "photon_data/timestamps_specs/timestamps_unit"
"""Names in a Photon-HDF5 file."""

MOST_EVENTS = 2**28
"""Events of a file at most."""

UNITS = {"fs": 1e-15, "ps": 1e-12, "ns": 1e-9, "us": 1e-6, "\u00b5s": 1e-6, "\u03bcs": 1e-6}
UNITS |= {"ms": 1e-3, "s": 1.0, "sec": 1.0, "seconds": 1.0}
"""Seconds of the units that a column's name may give, as `time_ps` or `time (ps)`."""

TIME_NAMES = {"t", "time", "times", "timetag", "timetags", "timestamp", "timestamps", "tag", "tags"}
TIME_NAMES |= {"macrotime", "abstime", "absolutetime", "arrivaltime", "truetime", "stamp", "stamps"}
CHANNEL_NAMES = {"c", "ch", "chan", "chn", "channel", "channels", "channelid", "chid", "input"}
CHANNEL_NAMES |= {"inputs", "detector", "detectors", "det", "event", "eventid", "source", "line"}
"""Names of the columns of times and of channels, without blanks and signs."""

MOST_CHANNELS = 64
"""Different channels of a table whose columns have no names, at most."""

NO_EVENTS = "of counts, not events, give `cumulative` or `bins`"
"""What to do with a table of counts."""

MOST_NAMED = 20
"""Columns or channels that one line names, at most."""

FINE_S = 1e-9
"""Ticks up to which a detector does not see half of its photons two at a time, seconds."""

BACK_S = 1e-6
"""By how much a time may be before that of the event before on its channel, seconds."""


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
        return _read_table(path, unit_s)
    if not path.is_file():
        raise InputError(f"there is no file {path}: give a Photon-HDF5 file")
    found = list_variables(path, (0, 1))
    for name in (TIMES, CHANNELS):
        if len(found.get(name, ())) != 1:
            raise InputError(f"{path} is no Photon-HDF5 file of one spot: it lacks {name}")
    times, channels = (
        as_whole(read_variable(path, name, found[name], MOST_EVENTS), f"{path}: {name}")
        for name in (TIMES, CHANNELS)
    )
    if times.shape != channels.shape:
        raise InputError(f"{path} has {len(times)} times and {len(channels)} detectors of them")
    if unit_s is None and UNIT in found:
        unit_s = float(read_variable(path, UNIT, found[UNIT], 1).ravel()[0])
    return Stamps(times, channels, _check_unit(unit_s, path))


def _read_table(path: Path, unit_s: float | None) -> Stamps:
    """Time stamps of a table, whose names say which column is what, or the time is the first."""
    refuse_foreign(path)
    units: list[float | None] = [None]

    def choose(names: tuple[str, ...], width: int) -> Sequence[int]:
        columns = [_column_of(name) for name in names]
        times = [place for place, (what, _) in enumerate(columns) if what == "time"]
        channels = [place for place, (what, _) in enumerate(columns) if what == "channel"]
        if width == 2 and len(times) + len(channels) == 1:  # the other column is the other
            times, channels = times or [1 - channels[0]], channels or [1 - times[0]]
        if len(times) == len(channels) == 1:
            units[0] = columns[times[0]][1]
            return times[0], channels[0]
        if width != 2 or times or channels:
            named = f" ({', '.join(names[:MOST_NAMED])})" if names else ""
            raise InputError(
                f"{path} has {width} columns{named}: give two, the time and the channel of each "
                f"event, or name those two 'time' and 'channel'; {NO_EVENTS}"
            )
        return 0, 1

    times, channels = read_whole(path, choose).T
    if not units[0] and len(np.unique(channels)) > MOST_CHANNELS:
        other = len(np.unique(times)) <= MOST_CHANNELS
        raise InputError(
            f"{path} has {len(np.unique(channels))} different numbers in its column of channels"
            f"{', and few in that of times' if other else ''}: give the time first and the channel "
            f"second, or name the columns 'time' and 'channel'; {NO_EVENTS}"
        )
    if units[0] and unit_s and not math.isclose(units[0], unit_s):
        raise InputError(
            f"{path} names its times as in units of {units[0]:g} s, and `unit` is {unit_s:g} s: "
            "leave `unit` out, or correct one of them"
        )
    return Stamps(times, channels, _check_unit(unit_s or units[0], path))


def _column_of(name: str) -> tuple[str, float | None]:
    """Content of a column of this name, "time", "channel" or "", and the unit of times."""
    words = re.sub(r"[^a-z\u00b5\u03bc]+", " ", name.lower()).split()
    units = [unit for unit in (UNITS.get(word) for word in words[1:]) if unit]
    text = "".join(word for place, word in enumerate(words) if not place or word not in UNITS)
    what = "time" if text in TIME_NAMES else "channel" if text in CHANNEL_NAMES else ""
    return what, units[-1] if units else None


def _check_unit(unit_s: float | None, path: Path) -> float:
    if unit_s is None or not TICKS_S[0] <= unit_s <= TICKS_S[1]:
        given = "no unit of its times" if unit_s is None else f"times in units of {unit_s:g} s"
        raise InputError(f"{path} has {given}: give `unit`, 1e-15 to 1 s, such as 1ps")
    return unit_s


def write_stamps(
    stamps: Stamps,
    path: str | os.PathLike[str],
    marker: int | None,
    inputs: tuple[int, ...] | None = None,
) -> tuple[int, ...]:
    """Write events as a PTU file, of no markers without a trigger; gives its inputs' channels."""
    there = np.unique(stamps.channels).tolist()
    more = f" and {len(there) - MOST_NAMED} more" if len(there) > MOST_NAMED else ""
    known = f"there are some on {', '.join(map(str, there[:MOST_NAMED])) or 'none'}{more}"
    chosen = tuple(each for each in there if each != marker) if inputs is None else inputs
    triggers = () if marker is None else (marker,)
    every = (*triggers, *chosen)
    for each in every:
        if each not in there:
            raise InputError(f"channel {each} has no events; {known}")
    if not chosen or len(chosen) > GENERIC_T2.inputs or len(set(every)) < len(every):
        trigger = "none" if marker is None else marker
        raise InputError(
            f"channels {', '.join(map(str, chosen)) or 'none'} for the detectors beside {trigger} "
            f"for the trigger are not allowed: give 1 to {GENERIC_T2.inputs} other ones, each once"
        )
    for each in every:
        _check_clock(stamps, each, each == marker)
    codes = np.full(len(stamps.times), GENERIC_T2.inputs)
    if marker is not None:
        codes[stamps.channels == marker] = -1
    for code, each in enumerate(chosen):
        codes[stamps.channels == each] = code
    kept = np.flatnonzero(codes < GENERIC_T2.inputs)
    order = kept[np.argsort(stamps.times[kept], kind="stable")]
    with Writer(path, stamps.tick_s) as writer:
        writer.write(stamps.times[order] - stamps.times[order[0]], codes[order])
    return chosen


def _check_clock(stamps: Stamps, channel: int, marker: bool) -> None:
    """Raise `InputError` where the clock of a channel ran back, or its events stand twice."""
    # Channels may follow each other in a list: each counts its time for itself
    places = np.flatnonzero(stamps.channels == channel)
    times = stamps.times[places]
    slack = max(round(BACK_S / stamps.tick_s), 1)
    back = np.flatnonzero(times[1:] < np.maximum.accumulate(times)[:-1] - slack)
    if len(back):
        first = back[0]
        raise InputError(
            f"time runs back on channel {channel}, event {places[first + 1] + 1}: from "
            f"{times[first]} to {times[first + 1]} ticks of {stamps.tick_s:g} s. The clock began "
            "anew or overflowed, or these are several recordings: give each alone, with times that "
            "count on"
        )
    twice = int(np.count_nonzero(np.diff(np.sort(times)) == 0))
    if marker and twice:
        raise InputError(
            f"channel {channel} of the trigger has {twice} events at the time of another: give "
            "each once"
        )
    if len(times) > 1 and 2 * twice >= len(times) - 1 and stamps.tick_s <= FINE_S:
        raise InputError(
            f"channel {channel} has {twice} of its {len(times)} events at the time of another: "
            "they stand twice in the file; give each once"
        )

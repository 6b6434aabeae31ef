"""Timestamps of other makes of counter, an event at a time with its channel, written as a PTU file.

A time tagger records the trigger of the device as one channel among the others. Here it becomes a
marker, and the channels of the detectors become inputs, so that all that reads PTU files works.

`EVENT_FORMATS` is the table of what is read. Another make's file is a class, as `_EventFormat`
describes, and its line in the table.
"""

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from deepfsi.base.errors import InputError, Message
from deepfsi.base.numeric.arrays import HDF5_ENDINGS, list_variables, read_variable
from deepfsi.base.numeric.tables import read_whole_numbers, whole_numbers
from deepfsi.hardware.photons.ptu import TICKS_S, PtuWriter, refuse_foreign

MOST_EVENTS_READ = 2**28
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

NO_EVENTS = Message(
    "of counts, not events, give {cumulative} or {bins}", setting=("cumulative", "bins")
)
"""What to do with a table of counts."""

MOST_NAMED_CHANNELS = 20
"""Columns or channels that one line names, at most."""

FINE_S = 1e-9
"""Ticks up to which a detector does not see half of its photons two at a time, seconds."""

BACK_S = 1e-6
"""By how much a time may be before that of the event before on its channel, seconds."""


@dataclass(frozen=True)
class Timestamps:
    """Events of a recording."""

    times: np.ndarray  # ticks, int64 (n,)
    channels: np.ndarray  # channel of each, integers (n,)
    tick_s: float  # seconds of a tick

    def write(
        self,
        path: str | os.PathLike[str],
        marker: int | None,
        inputs: tuple[int, ...] | None = None,
    ) -> tuple[int, ...]:
        """Write the events as a PTU file, whose clock begins with the first of them."""
        available = np.unique(self.channels).tolist()
        more = (
            f" and {len(available) - MOST_NAMED_CHANNELS} more"
            if len(available) > MOST_NAMED_CHANNELS
            else ""
        )
        some = ", ".join(map(str, available[:MOST_NAMED_CHANNELS])) or "none"
        if inputs is None:
            inputs = tuple(channel for channel in available if channel != marker)
        triggers = () if marker is None else (marker,)
        wanted = (*triggers, *inputs)
        for channel in wanted:
            if channel not in available:
                raise InputError(f"channel {channel} has no events; there are some on {some}{more}")
        most = PtuWriter.inputs
        if not inputs or len(inputs) > most or len(set(wanted)) < len(wanted):
            trigger = "none" if marker is None else marker
            raise InputError(
                f"channels {', '.join(map(str, inputs)) or 'none'} for the detectors beside "
                f"{trigger} for the trigger are not allowed: give 1 to {most} other ones, each once"
            )
        for channel in wanted:
            self._check_clock(channel, channel == marker)
        codes = np.full(len(self.times), most)
        if marker is not None:
            codes[self.channels == marker] = -1
        for code, channel in enumerate(inputs):
            codes[self.channels == channel] = code
        kept = np.flatnonzero(codes < most)
        order = kept[np.argsort(self.times[kept], kind="stable")]
        with PtuWriter(path, self.tick_s) as writer:
            writer.write(self.times[order] - self.times[order[0]], codes[order])
        return inputs

    def _check_clock(self, channel: int, is_marker: bool) -> None:
        """Raise `InputError` where the clock of a channel ran back, or its events stand twice."""
        # Channels may follow each other in a list: each counts its time for itself
        events = np.flatnonzero(self.channels == channel)
        times = self.times[events]
        slack = max(round(BACK_S / self.tick_s), 1)
        back = np.flatnonzero(times[1:] < np.maximum.accumulate(times)[:-1] - slack)
        if len(back):
            first = back[0]
            raise InputError(
                f"time runs back on channel {channel}, event {events[first + 1] + 1}: from "
                f"{times[first]} to {times[first + 1]} ticks of {self.tick_s:g} s. The clock began "
                "anew or overflowed, or these are several recordings: give each alone, with times "
                "that count on"
            )
        twice = int(np.count_nonzero(np.diff(np.sort(times)) == 0))
        if is_marker and twice:
            raise InputError(
                f"channel {channel} of the trigger has {twice} events at the time of another: give "
                "each once"
            )
        if len(times) > 1 and 2 * twice >= len(times) - 1 and self.tick_s <= FINE_S:
            raise InputError(
                f"channel {channel} has {twice} of its {len(times)} events at the time of another: "
                "they stand twice in the file; give each once"
            )


class _EventFormat(Protocol):
    """A sort of file that holds events: it says which files are its, and reads them."""

    def matches(self, path: Path) -> bool:
        """Return True for a file of this sort, by its name or its first bytes."""

    def read(self, path: Path, unit_s: float | None) -> Timestamps:
        """Read the events, `InputError` if there are none.

        Parameters
        ----------
        path
            The file, which may not be there.
        unit_s
            Seconds of a tick; the file's own unless given.
        """


class _PhotonHdf5:
    """Photon-HDF5 file of one spot; phconvert makes it of files of Becker & Hickl and others."""

    times = "photon_data/timestamps"
    channels = "photon_data/detectors"
    unit = "photon_data/timestamps_specs/timestamps_unit"

    def matches(self, path: Path) -> bool:
        """By the end of the name."""
        return path.suffix.lower() in HDF5_ENDINGS

    def read(self, path: Path, unit_s: float | None) -> Timestamps:
        """As of `_EventFormat`."""
        if not path.is_file():
            raise InputError(f"there is no file {path}: give a Photon-HDF5 file")
        shapes = list_variables(path, (0, 1))
        columns = []
        for name in (self.times, self.channels):
            if len(shapes.get(name, ())) != 1:
                raise InputError(f"{path} is no Photon-HDF5 file of one spot: it lacks {name}")
            values = read_variable(path, name, shapes[name], MOST_EVENTS_READ)
            columns.append(whole_numbers(values, f"{path}: {name}"))
        times, channels = columns
        if times.shape != channels.shape:
            raise InputError(f"{path} has {len(times)} times and {len(channels)} detectors of them")
        if unit_s is None and self.unit in shapes:
            unit_s = float(read_variable(path, self.unit, shapes[self.unit], 1).ravel()[0])
        return Timestamps(times, channels, _check_unit(unit_s, path))


class _EventTable:
    """Table with a column of times and one of channels, by their names, or the time first."""

    def matches(self, path: Path) -> bool:
        """Any file: what is no table is refused when it is read."""
        return True

    def read(self, path: Path, unit_s: float | None) -> Timestamps:
        """As of `_EventFormat`."""
        refuse_foreign(path)
        columns = _EventColumns(path)
        times, channels = read_whole_numbers(path, columns.choose).T
        named_s = columns.unit_s
        if not named_s and len(np.unique(channels)) > MOST_CHANNELS:
            swapped = len(np.unique(times)) <= MOST_CHANNELS
            raise InputError(
                "{path} has {count} different numbers in its column of channels{also}: give the "
                "time first and the channel second, or name the columns 'time' and 'channel'; "
                "{otherwise}",
                path=path,
                count=len(np.unique(channels)),
                also=", and few in that of times" if swapped else "",
                otherwise=NO_EVENTS,
            )
        if named_s and unit_s and not math.isclose(named_s, unit_s):
            raise InputError(
                "{path} names its times as in units of {named_s:g} s, and {unit} is {unit_s:g} s: "
                "leave {unit} out, or correct one of them",
                setting="unit",
                path=path,
                named_s=named_s,
                unit_s=unit_s,
            )
        return Timestamps(times, channels, _check_unit(unit_s or named_s, path))


EVENT_FORMATS: tuple[_EventFormat, ...] = (_PhotonHdf5(), _EventTable())
"""Files of events that are read; the first that matches reads a file."""


def read_timestamps(source: str | os.PathLike[str], unit_s: float | None = None) -> Timestamps:
    """Read the events of another make of counter: of a file of one of the `EVENT_FORMATS`."""
    path = Path(source)
    reader = next(form for form in EVENT_FORMATS if form.matches(path))
    return reader.read(path, unit_s)


@dataclass
class _EventColumns:
    """Columns of times and channels of a table, and the unit that the name of the times gives."""

    path: Path
    unit_s: float | None = field(default=None, init=False)

    def choose(self, names: tuple[str, ...], width: int) -> Sequence[int]:
        """Columns of the time and the channel, of a table of so many columns."""
        columns = [_column_of(name) for name in names]
        times = [index for index, (content, _) in enumerate(columns) if content == "time"]
        channels = [index for index, (content, _) in enumerate(columns) if content == "channel"]
        if width == 2 and len(times) + len(channels) == 1:  # the other column is the other
            times = times or [1 - channels[0]]
            channels = channels or [1 - times[0]]
        if len(times) == len(channels) == 1:
            self.unit_s = columns[times[0]][1]
            return times[0], channels[0]
        if width != 2 or times or channels:
            named = f" ({', '.join(names[:MOST_NAMED_CHANNELS])})" if names else ""
            raise InputError(
                "{path} has {width} columns{named}: give two, the time and the channel of each "
                "event, or name those two 'time' and 'channel'; {otherwise}",
                path=self.path,
                width=width,
                named=named,
                otherwise=NO_EVENTS,
            )
        return 0, 1


def _column_of(name: str) -> tuple[str, float | None]:
    """Content of a column of this name, "time", "channel" or "", and the unit of times."""
    words = re.sub(r"[^a-z\u00b5\u03bc]+", " ", name.lower()).split()
    units = [unit for unit in (UNITS.get(word) for word in words[1:]) if unit]
    text = "".join(word for index, word in enumerate(words) if not index or word not in UNITS)
    content = "time" if text in TIME_NAMES else "channel" if text in CHANNEL_NAMES else ""
    return content, units[-1] if units else None


def _check_unit(unit_s: float | None, path: Path) -> float:
    """Seconds of a tick; `InputError` where nothing says it, or it is none."""
    if unit_s is None or not TICKS_S[0] <= unit_s <= TICKS_S[1]:
        given = "no unit of its times" if unit_s is None else f"times in units of {unit_s:g} s"
        raise InputError(
            "{path} has {given}: give {unit}, 1e-15 to 1 s, such as 1ps",
            setting="unit",
            path=path,
            given=given,
        )
    return unit_s

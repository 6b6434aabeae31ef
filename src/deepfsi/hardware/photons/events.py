"""Events of other makes of counter, a time and a channel each, written as a PTU file.

The trigger of the device becomes a marker, and the channels of the detectors become inputs, so that
all that reads PTU files works.
"""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from deepfsi.base.errors import InputError
from deepfsi.base.numeric.tables import read_whole_numbers
from deepfsi.hardware.photons.ptu import PtuWriter, refuse_foreign

MOST_NAMED_CHANNELS = 20
"""Channels that one line names, at most."""


def write_ptu(
    path: str | os.PathLike[str],
    times: npt.ArrayLike,
    channels: npt.ArrayLike,
    *,
    marker: int | None = None,
    inputs: Sequence[int] = (),
    tick_s: float = 1e-12,
) -> tuple[int, ...]:
    """Write the events of another make of counter as a PTU file, as `camera count` reads it.

    Parameters
    ----------
    path : path
        File, whose clock begins with the first event.
    times : array, shape (n,)
        Time of each event, in any order of channels: integers are ticks, floats are seconds.
    channels : array of int, shape (n,)
        Channel of each event.
    marker : int, optional
        Channel of the device's trigger, which becomes marker 0.
    inputs : sequence of int
        Channel of each detector, in order: input 1, 2, …. All but the trigger unless given.
    tick_s : float
        Seconds of a tick, 1e-15 to 1.

    Returns
    -------
    tuple of int
        Channel of each input.

    Raises
    ------
    InputError
        If a channel has no events, stands twice, or its clock runs back.
    """
    times = np.asarray(times)
    if times.dtype.kind == "f":
        times = np.rint(times / tick_s).astype(np.int64)
    channels = np.asarray(channels)
    available = np.unique(channels).tolist()
    inputs = tuple(inputs) or tuple(channel for channel in available if channel != marker)
    wanted = (*(() if marker is None else (marker,)), *inputs)
    for channel in wanted:
        if channel not in available:
            more = len(available) - MOST_NAMED_CHANNELS
            some = ", ".join(map(str, available[:MOST_NAMED_CHANNELS])) or "none"
            raise InputError(
                f"channel {channel} has no events; there are some on {some}"
                + (f" and {more} more" if more > 0 else "")
            )
    most = PtuWriter.inputs
    if not inputs or len(inputs) > most or len(set(wanted)) < len(wanted):
        raise InputError(
            f"channels {', '.join(map(str, inputs)) or 'none'} for the detectors beside "
            f"{'none' if marker is None else marker} for the trigger are not allowed: give 1 to "
            f"{most} other ones, each once"
        )
    codes = np.full(len(times), most)
    for code, channel in enumerate(wanted, start=len(inputs) - len(wanted)):
        events = np.flatnonzero(channels == channel)
        _check_clock(times, events, channel, is_marker=code < 0, tick_s=tick_s)
        codes[events] = code
    kept = np.flatnonzero(codes < most)
    order = kept[np.argsort(times[kept], kind="stable")]
    with PtuWriter(path, tick_s) as writer:
        writer.write(times[order] - times[order[0]], codes[order])
    return inputs


def _check_clock(
    every: np.ndarray, events: np.ndarray, channel: int, *, is_marker: bool, tick_s: float
) -> None:
    """Raise `InputError` where the clock of a channel ran back, or its events stand twice."""
    # Channels may follow each other in a list: each counts its time for itself
    times = every[events]
    # By how much a time may be before that of the event before on its channel, seconds
    slack = max(round(1e-6 / tick_s), 1)
    back = np.flatnonzero(times[1:] < np.maximum.accumulate(times)[:-1] - slack)
    if len(back):
        first = back[0]
        raise InputError(
            f"time runs back on channel {channel}, event {events[first + 1] + 1}: from "
            f"{times[first]} to {times[first + 1]} ticks of {tick_s:g} s. The clock began "
            "anew or overflowed, or these are several recordings: give each alone, with times "
            "that count on"
        )
    twice = int(np.count_nonzero(np.diff(np.sort(times)) == 0))
    if (is_marker and twice) or (
        # Ticks up to which a detector does not see half of its photons two at a time, seconds
        len(times) > 1 and 2 * twice >= len(times) - 1 and tick_s <= 1e-9
    ):
        raise InputError(
            f"channel {channel} has {twice} of its {len(times)} events at the time of another: "
            "give each once"
        )


def read_events(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Times in ticks and channels (n,) of a table of events: columns `time` and `channel`."""
    refuse_foreign(path)
    times, channels = read_whole_numbers(path, _columns).T
    # Different channels of a table whose columns have no names, at most
    if (count := len(np.unique(channels))) > 64:
        raise InputError(
            f"{path} has {count} different numbers in its column of channels: name the columns "
            "'time' and 'channel', or give the time first"
        )
    return times, channels


def _columns(names: tuple[str, ...], width: int) -> tuple[int, int]:
    """Columns of the time and the channel: by these names, or the first two of two."""
    lower = [name.strip().lower() for name in names]
    if {"time", "channel"} <= set(lower):
        return lower.index("time"), lower.index("channel")
    if width != 2:
        raise InputError(
            f"a table of events has {width} columns: give two, the time and the channel of each "
            "event, or name those two 'time' and 'channel'"
        )
    return 0, 1

"""Markers of a recording brought to the frames that they start.

A device gives one marker at the start of each frame; a counter records them on its own clock. A
pass over the frames follows the schedule of its manifest, as that clock shows it (`clocks`), within
200 ppm. Between passes there may be pauses of any length.

A pass is followed from its first marker: the next markers are sought where the last ones and the
schedule say. What is not there is *missing* or *late*, what is there and not sought is *extra*.

Times alone cannot tell a pass that lacks its first marker from one that lacks its last, when all
frames are equally long. Wherever a fault leaves such a doubt, the photons decide: each pass begins
and ends with a frame that is all ON and one that is all OFF, and no frame is brighter or darker.
Where they cannot decide, the pass is given up.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.hardware.counting.clocks import measure_clock
from deepfsi.hardware.counting.passes import (
    MOST_DRIFT,
    MOST_SHIFT,
    Markers,
    Pass,
    Schedule,
    follow_passes,
    overlapping,
    spare_times,
    take_whole,
    walk,
)
from deepfsi.hardware.light.faults import Fault, name_faults
from deepfsi.hardware.patterns.sequence import Manifest

CERTAIN_SIGMAS = 6.0
"""Standard errors beyond which something is certain."""

LIKELY_SIGMAS = 3.0
"""Standard errors within which it is likely."""

LEAST_STEP = 0.8
"""Least that the step from ON to OFF may be, of the largest from any frame to the next."""

Counter = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Photons in windows from some times to others, seconds."""


@dataclass(frozen=True)
class Alignment:
    """Start of each frame, and the faults of the markers."""

    starts_s: np.ndarray  # (S, F): Seconds on the counter's clock; NaN where it is not known
    faults: tuple[Fault, ...]
    pictures_s: np.ndarray  # (F,): Picture times on that clock
    tolerance_s: float  # by how much a marker may be off


def align(
    times_s: np.ndarray,
    manifest: Manifest,
    scenes: int,
    *,
    tolerance_s: float | None = None,
    counter: Counter | None = None,
    cut: bool = False,
) -> Alignment:
    """Find the frame that each marker starts."""
    # times_s (n,)
    schedule = Schedule.of(manifest, tolerance_s)
    times = np.sort(np.asarray(times_s, dtype=np.float64))
    if not len(times):
        raise InputError("no frame markers: choose the marker's bit, or wire the device's trigger")
    markers = Markers(times, schedule, scenes, cut)
    whole = take_whole(markers)
    if whole is None:
        markers = _measured(markers)
        schedule = markers.schedule
        whole = take_whole(markers)
    if whole is not None:
        return Alignment(whole, (), schedule.pictures, schedule.tolerance)
    starts, faults = _follow(markers, counter)
    return Alignment(starts, faults, schedule.pictures, schedule.tolerance)


def _follow(markers: Markers, counter: Counter | None) -> tuple[np.ndarray, tuple[Fault, ...]]:
    """Starts of frames (S, F) and faults, pass by pass; photons decide where times do not."""
    schedule, passes = markers.schedule, follow_passes(markers)
    doubtful = _find_doubts(passes, markers)
    shifts = _find_shifts(passes, doubtful, schedule, counter)
    for place, shift in shifts.items():
        if shift:
            start = passes[place].expected[0] + shift * schedule.step
            passes[place] = walk(markers, start)
    if shifts and overlapping(passes, schedule) >= {len(passes) - 1}:
        passes.pop()  # made of markers that a shifted pass has now
    return name_faults(passes, doubtful - set(shifts), markers)


def _measured(markers: Markers) -> Markers:
    """Markers with their schedule as the clock shows it, where that differs from the planned."""
    schedule = markers.schedule
    clock = measure_clock(markers.times, schedule.pictures, schedule.tolerance)
    if clock is None:
        return markers
    measured = schedule.stretched(clock)
    if abs(measured.pictures.sum() / schedule.pictures.sum() - 1) <= MOST_DRIFT:
        return markers
    return replace(markers, schedule=measured)


def find_steps(
    counts: np.ndarray, seconds: np.ndarray, sigmas: float = CERTAIN_SIGMAS
) -> tuple[np.ndarray, bool]:
    """Frames that may be all ON with the next all OFF, as far as photons tell."""
    # counts, seconds (n,)
    known = seconds > 0
    length = np.where(known, seconds, 1.0)
    rates, variances = counts / length, (counts + 1) / length**2
    steps, variance = rates[:-1] - rates[1:], variances[:-1] + variances[1:]
    usable = known[:-1] & known[1:]
    steepest = int(np.argmax(np.where(usable, steps, -np.inf)))
    if not usable[steepest]:
        return np.ones(len(steps), bool), False
    clear = bool(steps[steepest] > CERTAIN_SIGMAS * np.sqrt(variance[steepest]))
    lacking = LEAST_STEP * steps[steepest] - steps
    less = lacking > sigmas * np.sqrt(LEAST_STEP**2 * variance[steepest] + variance)
    falls = -steps > sigmas * np.sqrt(variance)
    return ~usable | ~(less & clear | falls), clear


def _find_doubts(passes: list[Pass], markers: Markers) -> set[int]:
    """Passes that may be shifted by whole frames, as far as times tell."""
    # These are passes that lack half of their markers, or the first or last, or have a marker
    # beside them that could be of one of their frames, and all passes that follow or precede them
    # without a pause that is long enough to tell. Of a cut file the last pass is one too: nothing
    # says how many markers it should have, and they may be of two passes
    schedule = markers.schedule
    spare = spare_times(passes, markers.times)
    reach = (MOST_SHIFT + 0.5) * schedule.step
    beyond = np.arange(1, MOST_SHIFT + 1) * schedule.step
    doubts = set()
    begins = np.array([each.expected[0] for each in passes])
    ends = np.array([each.expected[-1] for each in passes]) + schedule.pictures[-1]
    for place, each in enumerate(passes):
        slots = np.concatenate([begins[place] - beyond, ends[place] + beyond - schedule.step])
        beside = np.abs(spare[:, None] - slots) < 4 * schedule.tolerance
        whole = each.places[0] >= 0 and each.places[-1] >= 0 and each.matched > schedule.frames / 2
        whole = whole and not (markers.cut and place == len(passes) - 1)
        fits = schedule.locks and each.matched >= 0.75 * schedule.frames
        if not fits and (beside.any() or not whole):
            doubts.add(place)
    pauses = begins[1:] - ends[:-1]
    linked = pauses < reach + schedule.tolerance
    overlap = pauses < -0.5 * schedule.step
    for place in np.flatnonzero(overlap).tolist():
        doubts |= {place, place + 1}
    for way in (range(len(linked)), range(len(linked) - 1, -1, -1)):
        for place in way:
            if linked[place] and {place, place + 1} & doubts and not schedule.locks:
                doubts |= {place, place + 1}
    return doubts


def _find_shifts(
    passes: list[Pass], doubtful: set[int], schedule: Schedule, counter: Counter | None
) -> dict[int, int]:
    """Shift of each doubtful pass in frames, of those of which photons tell."""
    # Those that lack half of their markers are left
    order = sorted(place for place in doubtful if passes[place].matched > schedule.frames / 2)
    if counter is None or not order:
        return {}
    beyond = np.arange(1, MOST_SHIFT + 1) * schedule.step
    # What a clock that runs slow may take from a frame, and what markers may be off.
    lost = MOST_DRIFT * schedule.pictures + 2 * schedule.tolerance
    length = np.pad(
        np.maximum(schedule.pictures - schedule.settle - lost, 0), MOST_SHIFT, mode="median"
    )
    begins = []
    for place in order:
        expected = passes[place].expected
        last = expected[-1] + schedule.pictures[-1] - schedule.step
        begins.append(np.concatenate([expected[0] - beyond[::-1], expected, last + beyond]))
    starts = np.concatenate(begins) + schedule.settle + schedule.tolerance
    counts = counter(starts, starts + np.tile(length, len(order)))
    shifts = {}
    for place, photons in zip(order, counts.reshape(len(order), -1), strict=True):
        maybe, clear = find_steps(photons, length)
        likely, _ = find_steps(photons, length, LIKELY_SIGMAS)
        possible = [
            first
            for first in range(2 * MOST_SHIFT + 1)
            if maybe[first] and maybe[first + schedule.frames - 2]
        ]
        if clear and len(possible) == 1:
            within = likely[possible[0] : possible[0] + schedule.frames - 1]
            if within[0] and within[-1] and not within[1:-1].any():
                shifts[place] = possible[0] - MOST_SHIFT
    return shifts

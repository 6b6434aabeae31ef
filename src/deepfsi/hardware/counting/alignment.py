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

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from deepfsi.base import InputError
from deepfsi.hardware.counting.clocks import measure_clock
from deepfsi.hardware.counting.passes import (
    MOST_DRIFT,
    MOST_SHIFT,
    Markers,
    Pass,
    Schedule,
    follow_passes,
    nearest,
    overlapping,
    spare_times,
    take_whole,
    walk,
)
from deepfsi.hardware.light import CERTAIN_SIGMAS, Fault
from deepfsi.hardware.patterns.sequence import Manifest

MOST_RESTORED = 3
"""Missing markers in a row that are restored; after more it is not sure that frames were shown."""

MOST_FAULTS = 10_000
"""Faults of a recording at most; one with more is refused."""

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


def name_faults(
    passes: list[Pass], unknown: set[int], markers: Markers
) -> tuple[np.ndarray, tuple[Fault, ...]]:
    """Starts of frames (S, F), and every fault of their markers, extra ones last."""
    # Starts are in seconds, NaN where they are not known
    times, schedule, scenes = markers.times, markers.schedule, markers.scenes
    spare = spare_times(passes, times)
    _check_certain(passes, markers, spare)
    unknown = unknown | overlapping(passes, schedule)
    end = times[-1] + schedule.tolerance
    late = _find_late(passes, spare, schedule)
    starts = np.full((scenes, schedule.frames), np.nan)
    faults: list[Fault] = []
    for scene in range(scenes):
        each = passes[scene] if scene < len(passes) else None
        if each is None or scene in unknown:
            detail = f"the recording has no markers after {times[-1]:.6f} s"
            if each is not None and each.expected[-1] <= end:
                detail = (
                    f"from {each.expected[0]:.6f} s, which frame its markers start is not "
                    "certain, and the all-ON and all-OFF frames do not tell"
                )
            faults.append(Fault(kind="lost", scene=scene, detail=detail))
            continue
        starts[scene] = np.where(each.places >= 0, times[each.places], each.expected)
        for frames in _runs(np.flatnonzero(each.places < 0)):
            faults += _name(scene, frames, each, starts[scene], end, late)
    explained = {marker for marker, _ in late.values()}
    until = passes[-1].expected[-1] if markers.cut else np.inf
    for place, time in enumerate(spare.tolist()):
        if place not in explained and time < until:  # after it, of a pass that was cut
            faults.append(_name_extra(time, passes, unknown, schedule))
    if len(faults) > MOST_FAULTS:
        raise InputError(f"{len(faults)} markers are missing, late or extra: record again")
    return starts, tuple(faults)


def _check_certain(passes: list[Pass], markers: Markers, spare: np.ndarray) -> None:
    """Raise `InputError` unless it is certain which pass is of which scene."""
    times, schedule, scenes = markers.times, markers.schedule, markers.scenes
    if len(spare) > min(MOST_FAULTS, len(times) / 2):
        raise InputError(
            f"{len(spare)} of {len(times)} markers do not follow the schedule: give the patterns "
            "that were shown, and one marker at the start of each frame"
        )
    lacking = np.count_nonzero(passes[-1].expected > times[-1] + schedule.tolerance)
    if len(passes) < scenes and lacking <= MOST_RESTORED and not markers.cut:
        raise InputError(
            f"markers of {len(passes)} whole passes, and there are {scenes} scenes: give those "
            "that were recorded"
        )
    before = times[0] < passes[0].expected[0] - schedule.tolerance
    ends = lacking > MOST_RESTORED or (lacking and before) or (markers.cut and len(passes) < scenes)
    if ends and _has_strays(passes, times, schedule):
        raise InputError(
            "the last pass is cut, and markers outside of all passes follow no schedule: which "
            "pass is of which scene is not certain; record again"
        )


def _name(
    scene: int,
    frames: np.ndarray,
    each: Pass,
    starts: np.ndarray,
    end: float,
    late: dict[tuple[int, int], tuple[int, float]],
) -> Iterator[Fault]:
    """Faults of frames in a row that have no marker; those that cannot be restored become NaN."""
    alone = [frame for frame in frames.tolist() if (scene, frame) not in late]
    if starts[frames[0]] > end:
        detail = f"the recording has no markers after {end:.6f} s"
    elif len(alone) > MOST_RESTORED:
        detail = f"{len(alone)} markers are missing from {starts[frames[0]]:.6f} s"
    else:
        for frame in frames.tolist():
            due = f"due at {each.expected[frame]:.6f} s"
            if (scene, frame) in late:
                off = late[scene, frame][1] * 1e6
                side = "late" if off > 0 else "early"
                detail = f"{abs(off):.1f} µs {side}, {due}"
                yield Fault(kind="late", scene=scene, frame=frame, detail=detail)
            else:
                yield Fault(kind="missing", scene=scene, frame=frame, detail=due)
        return
    starts[frames] = np.nan
    last = f" to {frames[-1]}" if len(frames) > 1 else ""
    yield Fault(
        kind="lost",
        scene=scene,
        frame=int(frames[0]),
        detail=f"frames {frames[0]}{last}: {detail}" if last else detail,
    )


def _name_extra(time: float, passes: list[Pass], unknown: set[int], schedule: Schedule) -> Fault:
    """An extra marker, with the frame in which it came."""
    scene = frame = None
    for place, each in enumerate(passes):
        if each.expected[0] <= time < each.expected[-1] + schedule.pictures[-1]:
            scene = place
            if place not in unknown:
                frame = int(np.searchsorted(each.expected, time, side="right")) - 1
    return Fault(kind="extra", scene=scene, frame=frame, detail=f"a marker at {time:.6f} s")


def _find_late(
    passes: list[Pass], spare: np.ndarray, schedule: Schedule
) -> dict[tuple[int, int], tuple[int, float]]:
    """Spare markers that came within half a frame of a frame that has none, and by how much."""
    # From (scene, frame) to (place among the spare ones, seconds)
    late: dict[tuple[int, int], tuple[int, float]] = {}
    taken: set[int] = set()
    if not len(spare):
        return late
    for scene, each in enumerate(passes):
        frames = np.flatnonzero(each.places < 0)
        near, distance = nearest(spare, each.expected[frames], 0)
        close = distance < 0.5 * schedule.step
        for frame, marker in zip(frames[close].tolist(), near[close].tolist(), strict=True):
            if marker not in taken:
                taken.add(marker)
                late[scene, frame] = (marker, float(spare[marker] - each.expected[frame]))
    return late


def _has_strays(passes: list[Pass], times: np.ndarray, schedule: Schedule) -> bool:
    """True if markers came before and between all passes, perhaps of one that was not found."""
    outside = times < passes[-1].expected[-1]
    for each in passes:
        until = each.expected[-1] + schedule.pictures[-1]
        outside &= (times < each.expected[0] - schedule.tolerance) | (times >= until)
    return bool(outside.any())


def _runs(places: np.ndarray) -> list[np.ndarray]:
    """Places that follow each other, in groups."""
    if not len(places):
        return []
    return np.split(places, np.flatnonzero(np.diff(places) > 1) + 1)

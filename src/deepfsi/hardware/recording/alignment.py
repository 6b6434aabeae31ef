"""Markers of a recording brought to the frames that they start.

A device gives one marker at the start of each frame; a counter records them on its own clock, which
may run up to 200 ppm fast or slow. A pass over the frames follows the schedule of its manifest.
Between passes there may be pauses of any length.

A pass is followed from its first marker: the next markers are sought where the last ones and the
schedule say. What is not there is *missing* or *late*, what is there and not sought is *extra*.

Times alone cannot tell a pass that lacks its first marker from one that lacks its last, when all
frames are equally long. Wherever a fault leaves such a doubt, the photons decide: each pass begins
and ends with a frame that is all ON and one that is all OFF, and no frame is brighter or darker.
Where they cannot decide, the pass is given up.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict

from deepfsi.errors import InputError
from deepfsi.hardware.patterns.sequence import Manifest

MOST_DRIFT = 2e-4
"""Largest difference of the two clocks' rates."""

STEADY = 1e-6
"""Change of the drift within a pass that is allowed for."""

MOST_RESTORED = 3
"""Missing markers in a row that are restored; after more it is not sure that frames were shown."""

MOST_SHIFT = 3
"""Frames by which a pass may be found to be shifted."""

MOST_PLACES = 2**20
"""Frames of all passes together."""

MOST_FAULTS = 10_000
BLOCK = 32
"""Frames that are sought at once."""

SIGMAS = 6.0
"""Standard errors beyond which something is certain."""

LIKELY = 3.0
"""Standard errors within which it is likely."""

STEEP = 0.8
"""Least that the step from ON to OFF may be, of the largest from any frame to the next."""

Counter = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Photons in windows from some times to others, seconds."""


class Fault(BaseModel):
    """Something that went wrong in a recording.

    Attributes
    ----------
    kind : {"missing", "extra", "late", "lost"}
        `missing`: the marker is restored from its neighbours and the schedule. `extra`: it is
        dropped. `late`, or early: replaced by the schedule's time. `lost`: the frame's time is not
        known, or of the whole pass.
    scene, frame : int or None
        Which, from 0; None where no pass or no one frame is meant.
    detail : str
        What was seen and when.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["missing", "extra", "late", "lost"]
    scene: int | None
    frame: int | None
    detail: str

    def __str__(self) -> str:
        where = ["" if self.scene is None else f" scene {self.scene}"]
        where += ["" if self.frame is None else f" frame {self.frame}"]
        return f"{self.kind}{','.join(part for part in where if part)}: {self.detail}"


@dataclass(frozen=True)
class Alignment:
    """When frames start.

    Attributes
    ----------
    starts_s : array, shape (S, F)
        Seconds on the counter's clock; NaN where it is not known.
    faults : tuple of Fault
    """

    starts_s: np.ndarray
    faults: tuple[Fault, ...]


def align(
    times_s: np.ndarray,
    manifest: Manifest,
    scenes: int,
    *,
    tolerance_s: float | None = None,
    counter: Counter | None = None,
) -> Alignment:
    """Find the frame that each marker starts.

    Parameters
    ----------
    times_s : array, shape (n,)
        When the markers came, seconds.
    manifest : Manifest
        Its frames begin and end with all ON and all OFF.
    scenes : int
        S, passes; one for each scene.
    tolerance_s : float, optional
        By how much a marker may be off. Default: a tenth of the shortest picture time, at most
        10 µs.
    counter : callable, optional
        Photons on the first input in some windows (starts, stops; they may overlap). Asked once,
        and only if times alone leave a doubt. Without it such passes are given up.

    Raises
    ------
    InputError
        If markers do not follow the schedule, or are of more or fewer passes than there are scenes.
        Fewer are allowed if the recording ends within a pass; they are of the first scenes.
    """
    schedule = _Schedule.of(manifest, tolerance_s)
    times = np.sort(np.asarray(times_s, dtype=np.float64))
    if not len(times):
        raise InputError("no frame markers: choose the marker's bit, or wire the device's trigger")
    if scenes * schedule.frames > MOST_PLACES:
        raise InputError(
            f"{scenes} scenes of {schedule.frames} frames are more than {MOST_PLACES} frames: "
            "split the acquisition"
        )
    whole = _take_whole(times, schedule, scenes)
    if whole is not None:
        return Alignment(whole, ())
    passes = _follow(times, schedule, scenes)
    doubtful = _find_doubts(passes, times, schedule)
    shifts = _judge(passes, doubtful, schedule, counter)
    for place, shift in shifts.items():
        if shift:
            start = passes[place].expected[0] + shift * schedule.step
            passes[place] = _walk(times, start, schedule)
    if shifts and _overlapping(passes, schedule) >= {len(passes) - 1}:
        passes.pop()  # made of markers that a shifted pass has now
    return _finish(passes, doubtful - set(shifts), times, schedule, scenes)


def find_steps(
    counts: np.ndarray, seconds: np.ndarray, sigmas: float = SIGMAS
) -> tuple[np.ndarray, bool]:
    """Which frames may be all ON, and the next all OFF, as far as photons tell.

    Parameters
    ----------
    counts, seconds : arrays, shape (n,)
        Photons in frames that follow each other, and for how long each was counted (0: not at all).
    sigmas : float
        Standard errors beyond which something is certain.

    Returns
    -------
    fits : bool array, shape (n - 1,)
        False where the step from a frame to the next is certainly less than `STEEP` of the largest
        of all, or certainly none.
    clear : bool
        Whether the largest is certain.
    """
    known = seconds > 0
    length = np.where(known, seconds, 1.0)
    rates, variances = counts / length, (counts + 1) / length**2
    steps, spread = rates[:-1] - rates[1:], variances[:-1] + variances[1:]
    usable = known[:-1] & known[1:]
    steepest = int(np.argmax(np.where(usable, steps, -np.inf)))
    if not usable[steepest]:
        return np.ones(len(steps), bool), False
    clear = bool(steps[steepest] > SIGMAS * np.sqrt(spread[steepest]))
    lacking = STEEP * steps[steepest] - steps
    less = lacking > sigmas * np.sqrt(STEEP**2 * spread[steepest] + spread)
    falls = -steps > sigmas * np.sqrt(spread)
    return ~usable | ~(less & clear | falls), clear


# Passes ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Schedule:
    """When frames start after the first, how long they last, and how exact markers are, seconds."""

    starts: np.ndarray
    pictures: np.ndarray
    settle: float
    tolerance: float

    @classmethod
    def of(cls, manifest: Manifest, tolerance_s: float | None) -> "_Schedule":
        shortest = float(manifest.picture_s.min())
        given = min(0.1 * shortest, 1e-5) if tolerance_s is None else tolerance_s
        if not 0 < given <= 0.2 * shortest:
            raise InputError(
                f"a tolerance of {given!r} s is not allowed: give more than 0, up to a fifth of "
                f"the shortest frame ({0.2 * shortest:g} s)"
            )
        settle = manifest.device.settle_us * 1e-6
        return cls(manifest.starts_s, manifest.picture_s, settle, given)

    @property
    def frames(self) -> int:
        """F."""
        return len(self.starts)

    @property
    def step(self) -> float:
        """Duration of a usual frame."""
        return float(np.median(self.pictures))

    @cached_property
    def locks(self) -> bool:
        """Whether frames differ so much that a shifted pass cannot fit."""
        for shift in range(1, min(MOST_SHIFT, self.frames - 1) + 1):
            apart = self.starts[shift:] - self.starts[:-shift]
            off = np.abs(apart - np.median(apart))
            if np.mean(off > 4 * self.tolerance + MOST_DRIFT * apart.max()) < 0.5:
                return False
        return True


@dataclass(frozen=True)
class _Pass:
    """One pass: when frames are expected (F,), and which marker starts each (F,), -1 for none."""

    expected: np.ndarray
    places: np.ndarray

    @property
    def matched(self) -> int:
        """Frames that have a marker."""
        return int(np.count_nonzero(self.places >= 0))

    @property
    def last(self) -> int:
        """Last marker of the pass."""
        return int(self.places.max())


def _take_whole(times: np.ndarray, schedule: _Schedule, scenes: int) -> np.ndarray | None:
    """Starts (S, F) if each marker is where it should be, else None."""
    if len(times) != scenes * schedule.frames:
        return None
    starts = times.reshape(scenes, schedule.frames)
    nominal = schedule.starts[-1]
    span = starts[:, -1] - starts[:, 0]
    rate = span / nominal if nominal else np.ones(scenes)
    steps, wanted = np.diff(starts), np.diff(schedule.starts)
    off = np.abs(steps - wanted * rate[:, None]).max(initial=0)
    drift = np.abs(span - nominal).max() - MOST_DRIFT * nominal
    ends = starts[:-1, -1] + schedule.pictures[-1] * (1 - MOST_DRIFT)
    overlap = (ends - starts[1:, 0]).max(initial=-np.inf)
    if max(off, drift, overlap) > schedule.tolerance:
        return None
    return starts


def _follow(times: np.ndarray, schedule: _Schedule, scenes: int) -> list[_Pass]:
    """Passes one after another, each from the first marker that those before leave."""
    passes: list[_Pass] = []
    first = extra = 0
    while first < len(times) and len(passes) < scenes:
        found = _next_pass(times, first, schedule)
        if found is None:
            first, extra = first + 1, extra + 1
            if extra > 100 + scenes:
                raise InputError(
                    f"markers do not follow the schedule, first at {times[first - extra]:.6f} s: "
                    "give the patterns that were shown, and one marker at the start of each frame"
                )
            continue
        passes.append(found)
        first, extra = found.last + 1, 0
    if not passes:
        raise InputError(
            f"none of {len(times)} markers follow the schedule: give the patterns that were shown"
        )
    left = len(times) - first
    if left > schedule.frames / 2:
        raise InputError(
            f"{left} markers follow the last of {scenes} passes: give as many scenes as were "
            "recorded"
        )
    return passes


def _next_pass(times: np.ndarray, first: int, schedule: _Schedule) -> _Pass | None:
    """Pass that begins at a marker or soon after, whose own first markers may be missing."""
    best, most = None, 0
    tries = range(MOST_SHIFT + 1)
    for skipped, absent in sorted(((i, j) for i in tries for j in tries), key=sum):
        if first + skipped >= len(times) or absent >= schedule.frames:
            continue
        start = times[first + skipped] - schedule.starts[absent]
        found = _walk(times, start, schedule, first + skipped)
        if found.matched - skipped > most:
            best, most = found, found.matched - skipped
        if found.matched == schedule.frames:
            break
    if best is None:
        return None
    until = best.expected[-1] + schedule.tolerance
    inside = np.searchsorted(times, until, side="right") - first
    return best if best.matched >= max(2, inside / 2) else None


def _walk(times: np.ndarray, start: float, schedule: _Schedule, first: int = 0) -> _Pass:
    """Follow the schedule from a time of frame 0, with the clock's drift as markers show it."""
    frames, starts, tolerance = schedule.frames, schedule.starts, schedule.tolerance
    widest = 0.4 * float(schedule.pictures.min())
    expected, places = np.empty(frames), np.full(frames, -1)
    offset, drift, slack, known, done = start, 0.0, MOST_DRIFT, 0.0, 0
    while done < frames:
        sure = int(np.searchsorted(starts, known + tolerance / slack, side="right"))
        stop = min(max(done + 1, min(sure, done + BLOCK)), frames)
        new = slice(done, stop)
        guess = offset + (1 + drift) * starts[new]
        window = np.minimum(tolerance + slack * np.abs(starts[new] - known), widest)
        near, distance = _nearest(times, guess, first)
        places[new] = np.where(distance <= window, near, -1)
        recent = np.flatnonzero(places[:stop] >= 0)[-2 * BLOCK :]
        if len(recent) > 1:
            at, came = starts[recent], times[places[recent]]
            half = len(recent) // 2
            apart = np.median(at[half:]) - np.median(at[:half])
            off = came - at
            change = float((np.median(off[half:]) - np.median(off[:half])) / apart)
            drift = min(max(change, -MOST_DRIFT), MOST_DRIFT)
            offset = float(np.median(came - (1 + drift) * at))
            known = float(at[-1])
            slack = min(MOST_DRIFT, max(STEADY, tolerance / (at[-1] - at[0])))
        elif len(recent) == 1:
            offset = float(times[places[recent[0]]] - (1 + drift) * starts[recent[0]])
            known = float(starts[recent[0]])
        expected[new] = offset + (1 + drift) * starts[new]
        near, distance = _nearest(times, expected[new], first)
        places[new] = np.where(distance <= tolerance, near, -1)
        done = stop
    return _Pass(expected, places)


def _nearest(times: np.ndarray, wanted: np.ndarray, first: int) -> tuple[np.ndarray, np.ndarray]:
    """Marker nearest to each wanted time, none before `first`, and how far it is."""
    after = np.clip(np.searchsorted(times, wanted), first, len(times) - 1)
    before = np.maximum(after - 1, first)
    near = np.where(np.abs(times[before] - wanted) < np.abs(times[after] - wanted), before, after)
    return near, np.abs(times[near] - wanted)


# Doubts ------------------------------------------------------------------------------------------


def _find_doubts(passes: list[_Pass], times: np.ndarray, schedule: _Schedule) -> set[int]:
    """Passes that may be shifted by whole frames, as far as times tell.

    These are passes that lack half of their markers, or the first or last, or have a marker beside
    them that could be of one of their frames, and all passes that follow or precede them without a
    pause that is long enough to tell.
    """
    used = np.zeros(len(times), bool)
    for each in passes:
        used[each.places[each.places >= 0]] = True
    spare = times[~used]
    reach = (MOST_SHIFT + 0.5) * schedule.step
    beyond = np.arange(1, MOST_SHIFT + 1) * schedule.step
    doubts = set()
    begins = np.array([each.expected[0] for each in passes])
    ends = np.array([each.expected[-1] for each in passes]) + schedule.pictures[-1]
    for place, each in enumerate(passes):
        slots = np.concatenate([begins[place] - beyond, ends[place] + beyond - schedule.step])
        beside = np.abs(spare[:, None] - slots) < 4 * schedule.tolerance
        whole = each.places[0] >= 0 and each.places[-1] >= 0 and each.matched > schedule.frames / 2
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


def _judge(
    passes: list[_Pass], doubtful: set[int], schedule: _Schedule, counter: Counter | None
) -> dict[int, int]:
    """By how many frames each doubtful pass is shifted, of those of which photons tell.

    Those that lack half of their markers are left.
    """
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
        likely, _ = find_steps(photons, length, LIKELY)
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


# Result ------------------------------------------------------------------------------------------


def _finish(
    passes: list[_Pass],
    unknown: set[int],
    times: np.ndarray,
    schedule: _Schedule,
    scenes: int,
) -> Alignment:
    """Times of frames, and everything that was not as it should be."""
    starts = np.full((scenes, schedule.frames), np.nan)
    faults: list[Fault] = []
    end = times[-1] + schedule.tolerance
    unknown = unknown | _overlapping(passes, schedule)
    used = np.zeros(len(times), bool)
    for each in passes:
        used[each.places[each.places >= 0]] = True
    spare = np.flatnonzero(~used)
    if len(spare) > min(MOST_FAULTS, len(times) / 2):
        raise InputError(
            f"{len(spare)} of {len(times)} markers do not follow the schedule: give the patterns "
            "that were shown, and one marker at the start of each frame"
        )
    lacking = np.count_nonzero(passes[-1].expected > end)
    if len(passes) < scenes and lacking <= MOST_RESTORED:  # of a cut, or just missing
        raise InputError(
            f"markers of {len(passes)} whole passes, and there are {scenes} scenes: give those "
            "that were recorded"
        )
    if lacking > MOST_RESTORED and _has_strays(passes, times, schedule):
        raise InputError(
            "the last pass is cut, and markers outside of all passes follow no schedule: which "
            "pass is of which scene is not certain; record again"
        )
    late = _find_late(passes, times[spare], schedule)
    explained = {marker for marker, _ in late.values()}
    for scene in range(scenes):
        if scene >= len(passes):
            detail = f"the recording has no markers after {times[-1]:.6f} s"
            faults.append(Fault(kind="lost", scene=scene, frame=None, detail=detail))
        elif scene in unknown:
            detail = (
                f"from {passes[scene].expected[0]:.6f} s, which frame its markers start is not "
                "certain, and the all-ON and all-OFF frames do not tell"
            )
            if passes[scene].expected[-1] > end:
                detail = f"the recording has no markers after {times[-1]:.6f} s"
            faults.append(Fault(kind="lost", scene=scene, frame=None, detail=detail))
        else:
            each = passes[scene]
            starts[scene] = np.where(each.places >= 0, times[each.places], each.expected)
            for frames in _runs(np.flatnonzero(each.places < 0)):
                faults += _name(scene, frames, each, starts[scene], end, late)
    for place, time in enumerate(times[spare].tolist()):
        if place not in explained:
            faults.append(_name_extra(time, passes, unknown, schedule))
    if len(faults) > MOST_FAULTS:
        raise InputError(f"{len(faults)} markers are missing, late or extra: record again")
    return Alignment(starts, tuple(faults))


def _name(
    scene: int,
    frames: np.ndarray,
    each: _Pass,
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


def _name_extra(time: float, passes: list[_Pass], unknown: set[int], schedule: _Schedule) -> Fault:
    """An extra marker, with the frame in which it came."""
    scene = frame = None
    for place, each in enumerate(passes):
        if each.expected[0] <= time < each.expected[-1] + schedule.pictures[-1]:
            scene = place
            if place not in unknown:
                frame = int(np.searchsorted(each.expected, time, side="right")) - 1
    return Fault(kind="extra", scene=scene, frame=frame, detail=f"a marker at {time:.6f} s")


def _find_late(
    passes: list[_Pass], spare: np.ndarray, schedule: _Schedule
) -> dict[tuple[int, int], tuple[int, float]]:
    """Spare markers that came within half a frame of a frame that has none, and by how much.

    From (scene, frame) to (place among the spare ones, seconds).
    """
    late: dict[tuple[int, int], tuple[int, float]] = {}
    taken: set[int] = set()
    if not len(spare):
        return late
    for scene, each in enumerate(passes):
        frames = np.flatnonzero(each.places < 0)
        near, distance = _nearest(spare, each.expected[frames], 0)
        close = distance < 0.5 * schedule.step
        for frame, marker in zip(frames[close].tolist(), near[close].tolist(), strict=True):
            if marker not in taken:
                taken.add(marker)
                late[scene, frame] = (marker, float(spare[marker] - each.expected[frame]))
    return late


def _has_strays(passes: list[_Pass], times: np.ndarray, schedule: _Schedule) -> bool:
    """Whether markers came outside of all passes, perhaps of one that was not found."""
    outside = np.ones(len(times), bool)
    for each in passes:
        until = each.expected[-1] + schedule.pictures[-1]
        outside &= (times < each.expected[0] - schedule.tolerance) | (times >= until)
    return bool(outside.any())


def _overlapping(passes: list[_Pass], schedule: _Schedule) -> set[int]:
    """Passes that begin before the one before has ended."""
    out = set()
    for place in range(len(passes) - 1):
        length = schedule.pictures[-1] * (1 - MOST_DRIFT)
        end = passes[place].expected[-1] + length - 2 * schedule.tolerance
        if passes[place + 1].expected[0] < end:
            out |= {place, place + 1}
    return out


def _runs(places: np.ndarray) -> list[np.ndarray]:
    """Places that follow each other, in groups."""
    if not len(places):
        return []
    return np.split(places, np.flatnonzero(np.diff(places) > 1) + 1)

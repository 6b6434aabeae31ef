"""Passes over the frames of a recording, followed marker by marker.

A pass is followed from its first marker: the next markers are sought where the last ones and the
schedule say.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from deepfsi.base import InputError, time_text
from deepfsi.hardware.counting.clocks import Clock
from deepfsi.hardware.patterns.sequence import Manifest
from deepfsi.hardware.patterns.timing import usual_tolerance

MOST_DRIFT = 2e-4
"""Largest difference of two clocks' rates, of those planned or of those measured."""

MOST_DRIFT_CHANGE = 1e-6
"""Change of the drift within a pass that is allowed for at most."""

MOST_SHIFT = 3
"""Frames by which a pass may be found to be shifted."""

FRAMES_AT_ONCE = 32
"""Frames that are sought at once."""


@dataclass(frozen=True)
class Schedule:
    """Schedule of a pass, in seconds."""

    starts: np.ndarray  # (F,): Start of each frame after the first, and its picture time
    pictures: np.ndarray  # (F,)
    settle: float
    tolerance: float  # by how much a marker may be off

    @classmethod
    def of(cls, manifest: Manifest, tolerance_s: float | None) -> "Schedule":
        """Schedule of a manifest; a marker may be off as usual unless a tolerance is given."""
        shortest = float(manifest.picture_s.min())
        given = usual_tolerance(manifest) if tolerance_s is None else tolerance_s
        if not 0 < given <= 0.2 * shortest:
            raise InputError(
                f"a tolerance of {given!r} s is not allowed: give more than 0, up to a fifth of "
                f"the shortest frame ({time_text(0.2 * shortest)})"
            )
        settle = manifest.device.settle_us * 1e-6
        return cls(manifest.starts_s, manifest.picture_s, settle, given)

    def stretched(self, clock: Clock) -> "Schedule":
        """Schedule as a counter's clock shows it."""
        pictures = clock.stretch(self.pictures)
        return replace(self, starts=np.append(0.0, np.cumsum(pictures)[:-1]), pictures=pictures)

    @property
    def frames(self) -> int:
        """Frames of a pass, F."""
        return len(self.starts)

    @property
    def step(self) -> float:
        """Duration of a usual frame."""
        return float(np.median(self.pictures))

    @cached_property
    def locks(self) -> bool:
        """True if frames differ so much that a shifted pass cannot fit."""
        for shift in range(1, min(MOST_SHIFT, self.frames - 1) + 1):
            apart = self.starts[shift:] - self.starts[:-shift]
            off = np.abs(apart - np.median(apart))
            if np.mean(off > 4 * self.tolerance + MOST_DRIFT * apart.max()) < 0.5:
                return False
        return True


@dataclass(frozen=True)
class Markers:
    """Markers of a recording, and what they should follow."""

    times: np.ndarray  # (n,): When they came, seconds, rising
    schedule: Schedule
    scenes: int  # S, passes that there should be
    # True if the file is known to end before the recording did: passes that lack are the last
    cut: bool = False

    @property
    def pace(self) -> str:
        """Usual time between markers, and the planned one, for messages."""
        came = float(np.median(np.diff(self.times))) if len(self.times) > 1 else math.nan
        return f"one each {1e3 * came:.4g} ms, planned {1e3 * self.schedule.step:.4g} ms"


@dataclass(frozen=True)
class Pass:
    """One pass over the frames."""

    expected: np.ndarray  # (F,): When each frame is expected, seconds
    places: np.ndarray  # (F,): Marker that starts each frame, -1 for none

    @property
    def matched(self) -> int:
        """Frames that have a marker."""
        return int(np.count_nonzero(self.places >= 0))

    @property
    def last(self) -> int:
        """Last marker of the pass."""
        return int(self.places.max())


def take_whole(markers: Markers) -> np.ndarray | None:
    """Starts (S, F) if each marker is where it should be, else None."""
    times, schedule, scenes = markers.times, markers.schedule, markers.scenes
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


def follow_passes(markers: Markers) -> list[Pass]:
    """Passes one after another, each from the first marker that those before leave."""
    times, scenes = markers.times, markers.scenes
    passes: list[Pass] = []
    first = extra = 0
    while first < len(times) and len(passes) < scenes:
        found = _next_pass(markers, first)
        if found is None:
            first, extra = first + 1, extra + 1
            if extra > 100 + scenes:
                raise InputError(
                    f"markers do not follow the schedule, first at {times[first - extra]:.6f} s "
                    f"({markers.pace}): "
                    "give the patterns that were shown, and one marker at the start of each frame"
                )
            continue
        passes.append(found)
        first, extra = found.last + 1, 0
    if not passes:
        raise InputError(
            f"none of {len(times)} markers follow the schedule ({markers.pace}): give the patterns "
            "that were shown, or a larger --tolerance"
        )
    left = len(times) - first
    if left > markers.schedule.frames / 2:
        raise InputError(
            f"{left} markers follow the last of {scenes} passes: give as many scenes as were "
            "recorded"
        )
    return passes


def _next_pass(markers: Markers, first: int) -> Pass | None:
    """Pass that begins at a marker or soon after, whose own first markers may be missing."""
    times, schedule = markers.times, markers.schedule
    best, most = None, 0
    tries = range(MOST_SHIFT + 1)
    for skipped, absent in sorted(((i, j) for i in tries for j in tries), key=sum):
        if first + skipped >= len(times) or absent >= schedule.frames:
            continue
        start = times[first + skipped] - schedule.starts[absent]
        found = walk(markers, start, first + skipped)
        if found.matched - skipped > most:
            best, most = found, found.matched - skipped
        if found.matched == schedule.frames:
            break
    if best is None:
        return None
    until = best.expected[-1] + schedule.tolerance
    inside = np.searchsorted(times, until, side="right") - first
    return best if best.matched >= max(2, inside / 2) else None


def walk(markers: Markers, start: float, first: int = 0) -> Pass:
    """Follow the schedule from a time of frame 0, with the clock's drift as markers show it."""
    times, schedule = markers.times, markers.schedule
    frames, starts, tolerance = schedule.frames, schedule.starts, schedule.tolerance
    widest = 0.4 * float(schedule.pictures.min())
    expected, places = np.empty(frames), np.full(frames, -1)
    offset, drift, slack, known, done = start, 0.0, MOST_DRIFT, 0.0, 0
    while done < frames:
        sure = int(np.searchsorted(starts, known + tolerance / slack, side="right"))
        stop = min(max(done + 1, min(sure, done + FRAMES_AT_ONCE)), frames)
        new = slice(done, stop)
        guess = offset + (1 + drift) * starts[new]
        window = np.minimum(tolerance + slack * np.abs(starts[new] - known), widest)
        near, distance = nearest(times, guess, first)
        places[new] = np.where(distance <= window, near, -1)
        recent = np.flatnonzero(places[:stop] >= 0)[-2 * FRAMES_AT_ONCE :]
        if len(recent) > 1:
            at, came = starts[recent], times[places[recent]]
            half = len(recent) // 2
            apart = np.median(at[half:]) - np.median(at[:half])
            off = came - at
            change = float((np.median(off[half:]) - np.median(off[:half])) / apart)
            drift = min(max(change, -MOST_DRIFT), MOST_DRIFT)
            offset = float(np.median(came - (1 + drift) * at))
            known = float(at[-1])
            slack = min(MOST_DRIFT, max(MOST_DRIFT_CHANGE, tolerance / (at[-1] - at[0])))
        elif len(recent) == 1:
            offset = float(times[places[recent[0]]] - (1 + drift) * starts[recent[0]])
            known = float(starts[recent[0]])
        expected[new] = offset + (1 + drift) * starts[new]
        near, distance = nearest(times, expected[new], first)
        places[new] = np.where(distance <= tolerance, near, -1)
        done = stop
    return Pass(expected, places)


def nearest(times: np.ndarray, wanted: np.ndarray, first: int) -> tuple[np.ndarray, np.ndarray]:
    """Marker nearest to each wanted time, none before `first`, and its distance."""
    # times (n,); wanted (k,)
    after = np.clip(np.searchsorted(times, wanted), first, len(times) - 1)
    before = np.maximum(after - 1, first)
    near = np.where(np.abs(times[before] - wanted) < np.abs(times[after] - wanted), before, after)
    return near, np.abs(times[near] - wanted)


def overlapping(passes: list[Pass], schedule: Schedule) -> set[int]:
    """Passes that begin before the one before has ended."""
    out = set()
    length = schedule.pictures[-1] * (1 - MOST_DRIFT)
    for place, (one, other) in enumerate(pairwise(passes)):
        if other.expected[0] < one.expected[-1] + length - 2 * schedule.tolerance:
            out |= {place, place + 1}
    return out


def spare_times(passes: list[Pass], times: np.ndarray) -> np.ndarray:
    """Times of the markers that start no frame of any pass."""
    spare = np.ones(len(times), bool)
    for each in passes:
        spare[each.places[each.places >= 0]] = False
    return times[spare]

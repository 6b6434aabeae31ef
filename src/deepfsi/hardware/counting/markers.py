"""Markers of a recording: which frame each of them starts, and when frames start.

A device gives one marker at the start of each frame; a counter records them on its own clock. A
pass over the frames follows the schedule of its manifest, as that clock shows it, within 200 ppm.
Between passes there may be pauses of any length.

The counter's clock and the device's may differ, and a device may add the same time to every frame.
Either stretches the whole schedule; which one is measured from markers that follow each other, at
many places of the recording, so that missing or doubled markers do not matter. Nothing is decided
by that: markers are then brought to the stretched schedule as closely as to the planned one.

A pass is followed from its first marker: the next markers are sought where the last ones and the
schedule say. What is not there is *missing* or *late*, what is there and not sought is *extra*.

Times alone cannot tell a pass that lacks its first marker from one that lacks its last, when all
frames are equally long. Wherever a fault leaves such a doubt, the photons decide: each pass begins
and ends with a frame that is all ON and one that is all OFF, and no frame is brighter or darker.
Where they cannot decide, the pass is given up.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from deepfsi.base import SILENT, InputError, Progress, time_text
from deepfsi.hardware.counting.acquisition import Acquisition
from deepfsi.hardware.counting.windows import FrameStarts, count_overlapping, in_ticks
from deepfsi.hardware.light import CERTAIN_SIGMAS, Fault
from deepfsi.hardware.patterns import Manifest
from deepfsi.hardware.photons import PhotonSource, marker_slack_s, read_markers

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

MOST_DRIFT = 2e-4
"""Largest difference of two clocks' rates, of those planned or of those measured."""

MOST_DRIFT_CHANGE = 1e-6
"""Change of the drift within a pass that is allowed for at most."""

MOST_SHIFT = 3
"""Frames by which a pass may be found to be shifted."""

FRAMES_AT_ONCE = 32
"""Frames that are sought at once."""

FRAMES_OF_BLOCK = 8
"""Frames in a row that are compared with the schedule, at most, and half of a pass."""

MOST_BLOCKS = 64
"""Places of a recording that are compared."""

MOST_PLACES = 4096
"""Places of the schedule that each is compared with, the first ones."""

MOST_RATE = 0.02
"""Most that all frames may be longer or shorter than planned, as a share of each."""

MOST_EXTRA = 0.2
"""Most that may be added to each frame, as a share of the shortest."""

GOLDEN = 0.6180339887498949
"""Golden section: fractional parts of its multiples are spread evenly, out of step with passes."""


@dataclass(frozen=True)
class Clock:
    """Frames on the counter's clock: 1 + `rate` times the planned time, and `extra_s` seconds."""

    rate: float = 0.0
    extra_s: float = 0.0

    def stretch(self, pictures: np.ndarray) -> np.ndarray:
        """Picture times on the counter's clock, from the planned ones, seconds."""
        return (1 + self.rate) * pictures + self.extra_s


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
        given = manifest.usual_tolerance_s if tolerance_s is None else tolerance_s
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


@dataclass(frozen=True)
class Alignment:
    """Start of each frame, and the faults of the markers."""

    starts_s: np.ndarray  # (S, F): Seconds on the counter's clock; NaN where it is not known
    faults: tuple[Fault, ...]
    pictures_s: np.ndarray  # (F,): Picture times on that clock
    tolerance_s: float  # by how much a marker may be off


def find_frames(
    source: PhotonSource,
    acquisition: Acquisition,
    manifest: Manifest,
    tolerance_s: float | None = None,
    *,
    progress: Progress = SILENT,
    by_light: bool = True,
) -> FrameStarts:
    """Frames of a recording by its markers, and by photons where markers leave a doubt."""
    tick_s = source.tick_s
    times, bits = read_markers(source, progress)
    _check_markers(source, bits, acquisition.marker_bit)
    times = times[bits & acquisition.marker_bit != 0]
    last = float(times.max(initial=0)) * tick_s
    # The file of a recording that was cut holds all photons up to the last marker.
    until = last - 2 * marker_slack_s(tick_s) if source.problems else np.inf
    inputs = acquisition.inputs[: manifest.detector_count]
    try:
        aligned = align(
            times * tick_s,
            manifest,
            len(acquisition.scenes),
            tolerance_s=tolerance_s,
            counter=_photon_counter(source, inputs, until) if by_light else None,
            cut=bool(source.problems),
        )
    except InputError as error:
        raise InputError(f"{source.path} has {len(times)} frame markers: {error}") from None
    starts = aligned.starts_s.copy()
    if source.problems:
        starts[starts >= last] = np.nan  # the frame that was being recorded when the file ended
    masks = starts[:, manifest.shown]
    # A mask's frame is complete if a marker came after it.
    complete = np.isfinite(masks).all(axis=1) & (masks[:, -1] < last)
    if not complete.any():
        why = aligned.faults[0] if aligned.faults else "it ends too early"
        raise InputError(f"{source.path} has no whole exposure ({why}): record again")
    return FrameStarts(
        starts_s=starts,
        complete=complete,
        pictures_s=aligned.pictures_s,
        tolerance_s=aligned.tolerance_s,
        drift=_find_drift(starts, manifest.starts_s),
        until_s=until,
        faults=aligned.faults,
    )


def _check_markers(source: PhotonSource, bits: np.ndarray, wanted: int) -> None:
    """Raise `InputError`, with the marker inputs that have some, if a file has none of a bit."""
    if (bits & wanted != 0).any():
        return
    others = [str(number) for number in range(4) if (bits & 1 << number != 0).any()]
    advice = "wire the device's trigger to the counter"
    if others:
        advice = f"there are some on {' and '.join(others)}: give --marker {others[0]}"
    raise InputError(
        f"{source.path} has 0 frame markers on marker input {wanted.bit_length() - 1}; {advice}"
    )


def _photon_counter(source: PhotonSource, inputs: tuple[int, ...], until: float) -> Counter:
    """Count photons on some inputs in any windows, as far as all are in the file."""
    end = max(int(until / source.tick_s), 0) if np.isfinite(until) else None

    def counter(starts: np.ndarray, stops: np.ndarray) -> np.ndarray:
        edges = np.clip(in_ticks(np.stack([starts, stops]), source.tick_s), 0, end)
        return count_overlapping(source, edges[0], edges[1], inputs).sum(axis=1)

    return counter


def _find_drift(starts: np.ndarray, planned: np.ndarray) -> float:
    """By how much passes (S, F) last longer than planned, as a share: their median."""
    drifts = []
    for times in starts:
        timed = np.flatnonzero(np.isfinite(times))
        if len(timed) > 1:
            drifts.append(np.ptp(times[timed]) / np.ptp(planned[timed]) - 1)
    return float(np.median(drifts))


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
    whole = _take_whole(markers)
    if whole is None:
        markers = _measured(markers)
        schedule = markers.schedule
        whole = _take_whole(markers)
    if whole is not None:
        return Alignment(whole, (), schedule.pictures, schedule.tolerance)
    starts, faults = _follow(markers, counter)
    return Alignment(starts, faults, schedule.pictures, schedule.tolerance)


def _follow(markers: Markers, counter: Counter | None) -> tuple[np.ndarray, tuple[Fault, ...]]:
    """Starts of frames (S, F) and faults, pass by pass; photons decide where times do not."""
    schedule = markers.schedule
    passes = _follow_passes(markers)
    doubtful = _find_doubts(passes, markers)
    shifts = _find_shifts(passes, doubtful, schedule, counter)
    for place, shift in shifts.items():
        if shift:
            start = passes[place].expected[0] + shift * schedule.step
            passes[place] = _walk(markers, start)
    if shifts and _overlapping(passes, schedule) >= {len(passes) - 1}:
        passes.pop()  # made of markers that a shifted pass has now
    return _name_faults(passes, doubtful - set(shifts), markers)


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


def _find_doubts(passes: list[Pass], markers: Markers) -> set[int]:
    """Passes that may be shifted by whole frames, as far as times tell."""
    # These are passes that lack half of their markers, or the first or last, or have a marker
    # beside them that could be of one of their frames, and all passes that follow or precede them
    # without a pause that is long enough to tell. Of a cut file the last pass is one too: nothing
    # says how many markers it should have, and they may be of two passes
    schedule = markers.schedule
    spare = _spare_times(passes, markers.times)
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


def find_steps(
    counts: np.ndarray, seconds: np.ndarray, sigmas: float = CERTAIN_SIGMAS
) -> tuple[np.ndarray, bool]:
    """Frames that may be all ON with the next all OFF, as far as photons tell."""
    # counts, seconds (n,)
    known = seconds > 0
    length = np.where(known, seconds, 1.0)
    rates = counts / length
    variances = (counts + 1) / length**2
    steps = rates[:-1] - rates[1:]
    variance = variances[:-1] + variances[1:]
    usable = known[:-1] & known[1:]
    steepest = int(np.argmax(np.where(usable, steps, -np.inf)))
    if not usable[steepest]:
        return np.ones(len(steps), bool), False
    clear = bool(steps[steepest] > CERTAIN_SIGMAS * np.sqrt(variance[steepest]))
    lacking = LEAST_STEP * steps[steepest] - steps
    less = lacking > sigmas * np.sqrt(LEAST_STEP**2 * variance[steepest] + variance)
    falls = -steps > sigmas * np.sqrt(variance)
    return ~usable | ~(less & clear | falls), clear


def measure_clock(times: np.ndarray, pictures: np.ndarray, tolerance: float) -> Clock | None:
    """Clock on which most markers in a row follow the schedule, None where there is none."""
    # times (n,); pictures (F,)
    size = min(FRAMES_OF_BLOCK, len(pictures) // 2)
    if len(times) <= size:
        return None
    planned = np.lib.stride_tricks.sliding_window_view(pictures[:-1], size)[:MOST_PLACES]
    steps = np.lib.stride_tricks.sliding_window_view(np.diff(times), size)
    places = np.unique((np.arange(MOST_BLOCKS) * GOLDEN % 1 * len(steps)).astype(np.int64))
    total = planned.sum(axis=1)
    shortest = float(pictures.min())
    rates = []
    extras = []
    for block in steps[places]:
        rate = block.sum() / total - 1
        extra = (block.sum() - total) / size
        proportional = np.abs(block - (1 + rate[:, None]) * planned).max(axis=1)
        constant = np.abs(block - planned - extra[:, None]).max(axis=1)
        proportional[np.abs(rate) > MOST_RATE] = np.inf
        constant[(extra > MOST_EXTRA * shortest) | (extra < -MOST_RATE * shortest)] = np.inf
        rates.append(_best(rate, proportional))
        extras.append(_best(extra, constant))
    by_rate, by_extra = (_agree(found, 2 * tolerance) for found in (rates, extras))
    if by_rate is None and by_extra is None:
        return None
    if by_extra is None or (by_rate is not None and by_rate[1] <= by_extra[1]):
        assert by_rate is not None
        return Clock(rate=by_rate[0])
    return Clock(extra_s=by_extra[0])


def _best(values: np.ndarray, off: np.ndarray) -> tuple[float, float]:
    """Value that fits best, and by how much it is off."""
    place = int(np.argmin(off))
    return float(values[place]), float(off[place])


def _agree(found: list[tuple[float, float]], most: float) -> tuple[float, float] | None:
    """Middle value of those that fit and by how much they are off; None if few fit."""
    fits = np.array([each for each in found if each[1] <= most])
    if len(fits) < len(found) / 8:
        return None
    values, off = np.median(fits, axis=0)
    return float(values), float(off)


def _take_whole(markers: Markers) -> np.ndarray | None:
    """Starts (S, F) if each marker is where it should be, else None."""
    times = markers.times
    schedule = markers.schedule
    scenes = markers.scenes
    if len(times) != scenes * schedule.frames:
        return None
    starts = times.reshape(scenes, schedule.frames)
    nominal = schedule.starts[-1]
    span = starts[:, -1] - starts[:, 0]
    rate = span / nominal if nominal else np.ones(scenes)
    steps = np.diff(starts)
    wanted = np.diff(schedule.starts)
    off = np.abs(steps - wanted * rate[:, None]).max(initial=0)
    drift = np.abs(span - nominal).max() - MOST_DRIFT * nominal
    ends = starts[:-1, -1] + schedule.pictures[-1] * (1 - MOST_DRIFT)
    overlap = (ends - starts[1:, 0]).max(initial=-np.inf)
    if max(off, drift, overlap) > schedule.tolerance:
        return None
    return starts


def _follow_passes(markers: Markers) -> list[Pass]:
    """Passes one after another, each from the first marker that those before leave."""
    times = markers.times
    scenes = markers.scenes
    passes: list[Pass] = []
    first = extra = 0
    while first < len(times) and len(passes) < scenes:
        found = _next_pass(markers, first)
        if found is None:
            first = first + 1
            extra = extra + 1
            if extra > 100 + scenes:
                raise InputError(
                    f"markers do not follow the schedule, first at {times[first - extra]:.6f} s "
                    f"({markers.pace}): "
                    "give the patterns that were shown, and one marker at the start of each frame"
                )
            continue
        passes.append(found)
        first = found.last + 1
        extra = 0
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
    times = markers.times
    schedule = markers.schedule
    best = None
    most = 0
    tries = range(MOST_SHIFT + 1)
    for skipped, absent in sorted(((i, j) for i in tries for j in tries), key=sum):
        if first + skipped >= len(times) or absent >= schedule.frames:
            continue
        start = times[first + skipped] - schedule.starts[absent]
        found = _walk(markers, start, first + skipped)
        if found.matched - skipped > most:
            best = found
            most = found.matched - skipped
        if found.matched == schedule.frames:
            break
    if best is None:
        return None
    until = best.expected[-1] + schedule.tolerance
    inside = np.searchsorted(times, until, side="right") - first
    return best if best.matched >= max(2, inside / 2) else None


def _walk(markers: Markers, start: float, first: int = 0) -> Pass:
    """Follow the schedule from a time of frame 0, with the clock's drift as markers show it."""
    times = markers.times
    schedule = markers.schedule
    frames = schedule.frames
    starts = schedule.starts
    tolerance = schedule.tolerance
    widest = 0.4 * float(schedule.pictures.min())
    expected = np.empty(frames)
    places = np.full(frames, -1)
    offset = start
    drift = 0.0
    slack = MOST_DRIFT
    known = 0.0
    done = 0
    while done < frames:
        sure = int(np.searchsorted(starts, known + tolerance / slack, side="right"))
        stop = min(max(done + 1, min(sure, done + FRAMES_AT_ONCE)), frames)
        new = slice(done, stop)
        guess = offset + (1 + drift) * starts[new]
        window = np.minimum(tolerance + slack * np.abs(starts[new] - known), widest)
        near, distance = _nearest(times, guess, first)
        places[new] = np.where(distance <= window, near, -1)
        recent = np.flatnonzero(places[:stop] >= 0)[-2 * FRAMES_AT_ONCE :]
        if len(recent) > 1:
            at = starts[recent]
            came = times[places[recent]]
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
        near, distance = _nearest(times, expected[new], first)
        places[new] = np.where(distance <= tolerance, near, -1)
        done = stop
    return Pass(expected, places)


def _nearest(times: np.ndarray, wanted: np.ndarray, first: int) -> tuple[np.ndarray, np.ndarray]:
    """Marker _nearest to each wanted time, none before `first`, and its distance."""
    # times (n,); wanted (k,)
    after = np.clip(np.searchsorted(times, wanted), first, len(times) - 1)
    before = np.maximum(after - 1, first)
    near = np.where(np.abs(times[before] - wanted) < np.abs(times[after] - wanted), before, after)
    return near, np.abs(times[near] - wanted)


def _overlapping(passes: list[Pass], schedule: Schedule) -> set[int]:
    """Passes that begin before the one before has ended."""
    out = set()
    length = schedule.pictures[-1] * (1 - MOST_DRIFT)
    for place, (one, other) in enumerate(pairwise(passes)):
        if other.expected[0] < one.expected[-1] + length - 2 * schedule.tolerance:
            out |= {place, place + 1}
    return out


def _spare_times(passes: list[Pass], times: np.ndarray) -> np.ndarray:
    """Times of the markers that start no frame of any pass."""
    spare = np.ones(len(times), bool)
    for each in passes:
        spare[each.places[each.places >= 0]] = False
    return times[spare]


def _name_faults(
    passes: list[Pass], unknown: set[int], markers: Markers
) -> tuple[np.ndarray, tuple[Fault, ...]]:
    """Starts of frames (S, F), and every fault of their markers, extra ones last."""
    # Starts are in seconds, NaN where they are not known
    times = markers.times
    schedule = markers.schedule
    scenes = markers.scenes
    spare = _spare_times(passes, times)
    _check_certain(passes, markers, spare)
    unknown = unknown | _overlapping(passes, schedule)
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
    times = markers.times
    schedule = markers.schedule
    scenes = markers.scenes
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
        near, distance = _nearest(spare, each.expected[frames], 0)
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

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
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Progress
from deepfsi.base.quantities import time_text
from deepfsi.hardware.counting.acquisition import Acquisition
from deepfsi.hardware.counting.windows import FrameStarts, count_overlapping, in_ticks
from deepfsi.hardware.light.checks import Fault
from deepfsi.hardware.light.curves import CERTAIN_SIGMAS
from deepfsi.hardware.patterns.manifest import Manifest
from deepfsi.hardware.photons.reader import PhotonSource, read_markers
from deepfsi.hardware.photons.records import marker_slack_s

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

FRAMES_SOUGHT = 32
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
class Alignment:
    """Start of each frame, and the faults of the markers."""

    starts_s: np.ndarray  # seconds on the counter's clock
    faults: tuple[Fault, ...]  # of the markers, extra ones last
    pictures_s: np.ndarray  # picture times on that clock
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
    wired = bits & acquisition.marker_bit != 0
    if not wired.any():
        advice = "wire the device's trigger to the counter"
        others = [str(number) for number in range(4) if (bits & 1 << number).any()]
        if others:
            advice = f"there are some on {' and '.join(others)}: give --marker {others[0]}"
        raise InputError(
            f"{source.path} has 0 frame markers on marker input "
            f"{acquisition.marker_bit.bit_length() - 1}; {advice}"
        )
    times = times[wired]
    last = float(times.max()) * tick_s
    # The file of a recording that was cut holds all photons up to the last marker
    until = last - 2 * marker_slack_s(tick_s) if source.problems else np.inf
    end = max(int(until / tick_s), 0) if source.problems else None

    def count(starts: np.ndarray, stops: np.ndarray) -> np.ndarray:
        edges = np.clip(in_ticks(np.stack([starts, stops]), tick_s), 0, end)
        inputs = acquisition.inputs[manifest.arm]
        return count_overlapping(source, edges[0], edges[1], inputs).sum(axis=1)

    try:
        aligned = align(
            times * tick_s,
            manifest,
            len(acquisition.scenes),
            tolerance_s=tolerance_s,
            counter=count if by_light else None,
            cut=bool(source.problems),
        )
    except InputError as error:
        raise InputError(f"{source.path} has {len(times)} frame markers: {error}") from None
    starts = aligned.starts_s.copy()
    if source.problems:
        starts[starts >= last] = np.nan  # the frame that was being recorded when the file ended
    masks = starts[:, manifest.shown]
    # A mask's frame is complete if a marker came after it
    complete = np.isfinite(masks).all(axis=1) & (masks[:, -1] < last)
    if not complete.any():
        why = aligned.faults[0] if aligned.faults else "it ends too early"
        raise InputError(f"{source.path} has no whole exposure ({why}): record again")
    drifts = [
        np.ptp(row[timed]) / np.ptp(manifest.starts_s[timed]) - 1
        for row, timed in zip(starts, np.isfinite(starts), strict=True)
        if np.count_nonzero(timed) > 1
    ]
    return FrameStarts(
        starts_s=starts,
        complete=complete,
        pictures_s=aligned.pictures_s,
        tolerance_s=aligned.tolerance_s,
        drift=float(np.median(drifts)),
        until_s=until,
        faults=aligned.faults,
    )


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
    times = np.sort(np.asarray(times_s, dtype=np.float64))
    schedule = _Schedule.of(manifest, tolerance_s)
    if not len(times):
        raise InputError("no frame markers: choose the marker's bit, or wire the device's trigger")
    markers = _Markers(times, schedule, scenes, cut)
    faults: tuple[Fault, ...] = ()
    starts = markers.whole_passes
    if starts is None:
        markers = replace(markers, schedule=schedule.as_measured(times))
        starts = markers.whole_passes
    if starts is None:
        starts, faults = markers.follow(counter)
    schedule = markers.schedule
    return Alignment(starts, faults, schedule.pictures, schedule.tolerance)


@dataclass(frozen=True)
class _Schedule:
    """Schedule of a pass on the counter's clock, in seconds."""

    pictures: np.ndarray  # (F,): Picture times
    settle: float
    tolerance: float  # by how much a marker may be off

    @classmethod
    def of(cls, manifest: Manifest, tolerance_s: float | None) -> "_Schedule":
        """Schedule of a manifest; a marker may be off as usual unless a tolerance is given."""
        tolerance = manifest.usual_tolerance_s if tolerance_s is None else tolerance_s
        most = 0.2 * float(manifest.picture_s.min())
        if not 0 < tolerance <= most:
            raise InputError(
                f"a tolerance of {tolerance!r} s is not allowed: give more than 0, up to a fifth "
                f"of the shortest frame ({time_text(most)})"
            )
        return cls(manifest.picture_s, manifest.device.settle_us * 1e-6, tolerance)

    def as_measured(self, times: np.ndarray) -> "_Schedule":
        """Schedule as the clock of markers (n,) shows it, where that differs from the planned."""
        pictures = _measure_pictures(times, self.pictures, self.tolerance)
        if pictures is None or abs(pictures.sum() / self.pictures.sum() - 1) <= MOST_DRIFT:
            return self
        return replace(self, pictures=pictures)

    @cached_property
    def starts(self) -> np.ndarray:
        """Start of each frame after that of the first, (F,)."""
        return np.append(0.0, np.cumsum(self.pictures)[:-1])

    @property
    def frames(self) -> int:
        """Frames of a pass, F."""
        return len(self.pictures)

    @cached_property
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


def _measure_pictures(
    times: np.ndarray, pictures: np.ndarray, tolerance: float
) -> np.ndarray | None:
    """Picture times (F,) on the clock on which most markers in a row follow the schedule.

    All frames are longer or shorter by a share of each, or by the same time, whichever fits better.
    """
    size = min(FRAMES_OF_BLOCK, len(pictures) // 2)
    if len(times) <= size:
        return None
    planned = np.lib.stride_tricks.sliding_window_view(pictures[:-1], size)[:MOST_PLACES]
    steps = np.lib.stride_tricks.sliding_window_view(np.diff(times), size)
    places = np.unique((np.arange(MOST_BLOCKS) * GOLDEN % 1 * len(steps)).astype(np.int64))
    total = planned.sum(axis=1)
    shortest = float(pictures.min())
    fits: dict[str, list[tuple[float, float]]] = {"rate": [], "extra": []}
    for block in steps[places]:
        rate = block.sum() / total - 1
        extra = (block.sum() - total) / size
        off_rate = np.abs(block - (1 + rate[:, None]) * planned).max(axis=1)
        off_extra = np.abs(block - planned - extra[:, None]).max(axis=1)
        off_rate[np.abs(rate) > MOST_RATE] = np.inf
        off_extra[(extra > MOST_EXTRA * shortest) | (extra < -MOST_RATE * shortest)] = np.inf
        for kind, values, off in (("rate", rate, off_rate), ("extra", extra, off_extra)):
            best = int(np.argmin(off))
            fits[kind].append((values[best], off[best]))
    medians = {}
    for kind, best_fits in fits.items():
        close = [fit for fit in best_fits if fit[1] <= 2 * tolerance]
        if len(close) >= len(best_fits) / 8:
            medians[kind] = np.median(close, axis=0)
    if not medians:
        return None
    kind = min(medians, key=lambda kind: float(medians[kind][1]))
    value = float(medians[kind][0])
    return (1 + value) * pictures if kind == "rate" else pictures + value


@dataclass(frozen=True)
class _Pass:
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
class _Markers:
    """Markers of a recording, and what they should follow."""

    times: np.ndarray  # (n,): When they came, seconds, rising
    schedule: _Schedule
    scenes: int  # S, passes that there should be
    cut: bool  # whether passes that lack are the last

    @property
    def whole_passes(self) -> np.ndarray | None:
        """Starts (S, F) if each marker is where it should be, else None."""
        schedule = self.schedule
        if len(self.times) != self.scenes * schedule.frames:
            return None
        starts = self.times.reshape(self.scenes, schedule.frames)
        nominal = schedule.starts[-1]
        span = starts[:, -1] - starts[:, 0]
        rate = span / nominal if nominal else np.ones(self.scenes)
        off = np.abs(np.diff(starts) - np.diff(schedule.starts) * rate[:, None]).max(initial=0)
        drift = np.abs(span - nominal).max() - MOST_DRIFT * nominal
        ends = starts[:-1, -1] + schedule.pictures[-1] * (1 - MOST_DRIFT)
        overlap = (ends - starts[1:, 0]).max(initial=-np.inf)
        return None if max(off, drift, overlap) > schedule.tolerance else starts

    def follow(self, counter: Counter | None) -> tuple[np.ndarray, tuple[Fault, ...]]:
        """Starts of frames (S, F), NaN where they are not known, and every fault of the markers."""
        passes = self._find_passes()
        doubtful = self._find_doubts(passes)
        shifts = self._find_shifts(passes, doubtful, counter)
        for number, shift in shifts.items():
            if shift:
                start = passes[number].expected[0] + shift * self.schedule.step
                passes[number] = self._walk(start)
        if shifts and len(passes) - 1 in self._overlapping(passes):
            passes.pop()  # made of markers that a shifted pass has now
        self._check_certain(passes)
        return self._name_faults(passes, (doubtful - set(shifts)) | self._overlapping(passes))

    def _find_passes(self) -> list[_Pass]:
        """Passes one after another, each from the first marker that those before leave."""
        # Usual time between markers, and the planned one
        came = float(np.median(np.diff(self.times))) if len(self.times) > 1 else math.nan
        pace = f"one each {1e3 * came:.4g} ms, planned {1e3 * self.schedule.step:.4g} ms"
        passes: list[_Pass] = []
        first = extra = 0
        while first < len(self.times) and len(passes) < self.scenes:
            following = self._next_pass(first)
            if following is not None:
                passes.append(following)
                first = following.last + 1
                extra = 0
                continue
            first += 1
            extra += 1
            if extra > 100 + self.scenes:
                raise InputError(
                    "markers do not follow the schedule, first at "
                    f"{self.times[first - extra]:.6f} s ({pace}): give the patterns that were "
                    "shown, and one marker at the start of each frame"
                )
        if not passes:
            raise InputError(
                f"none of {len(self.times)} markers follow the schedule ({pace}): give the "
                "patterns that were shown, or a larger --tolerance"
            )
        left = len(self.times) - first
        if left > self.schedule.frames / 2:
            raise InputError(
                f"{left} markers follow the last of {self.scenes} passes: give as many scenes as "
                "were recorded"
            )
        return passes

    def _next_pass(self, first: int) -> _Pass | None:
        """Pass that begins at a marker or soon after, whose own first markers may be missing."""
        best = None
        most = 0
        tries = range(MOST_SHIFT + 1)
        for skipped, absent in sorted(((i, j) for i in tries for j in tries), key=sum):
            if first + skipped >= len(self.times) or absent >= self.schedule.frames:
                continue
            start = self.times[first + skipped] - self.schedule.starts[absent]
            tried = self._walk(start, first + skipped)
            if tried.matched - skipped > most:
                best = tried
                most = tried.matched - skipped
            if tried.matched == self.schedule.frames:
                break
        if best is None:
            return None
        until = best.expected[-1] + self.schedule.tolerance
        inside = np.searchsorted(self.times, until, side="right") - first
        return best if best.matched >= max(2, inside / 2) else None

    def _walk(self, start: float, first: int = 0) -> _Pass:
        """Follow the schedule from a time of frame 0, with the clock's drift as markers show it."""
        schedule = self.schedule
        starts = schedule.starts
        tolerance = schedule.tolerance
        widest = 0.4 * float(schedule.pictures.min())
        expected = np.empty(schedule.frames)
        places = np.full(schedule.frames, -1)
        offset = start
        drift = 0.0
        slack = MOST_DRIFT
        anchor = 0.0  # start of the last frame that has a marker
        done = 0
        while done < schedule.frames:
            sure = int(np.searchsorted(starts, anchor + tolerance / slack, side="right"))
            stop = min(max(done + 1, min(sure, done + FRAMES_SOUGHT)), schedule.frames)
            new = slice(done, stop)
            window = np.minimum(tolerance + slack * np.abs(starts[new] - anchor), widest)
            near, distance = _nearest(self.times, offset + (1 + drift) * starts[new], first)
            places[new] = np.where(distance <= window, near, -1)
            recent = np.flatnonzero(places[:stop] >= 0)[-2 * FRAMES_SOUGHT :]
            at = starts[recent]
            came = self.times[places[recent]]
            if len(recent) > 1:
                half = len(recent) // 2
                apart = np.median(at[half:]) - np.median(at[:half])
                off = came - at
                change = float((np.median(off[half:]) - np.median(off[:half])) / apart)
                drift = min(max(change, -MOST_DRIFT), MOST_DRIFT)
                slack = min(MOST_DRIFT, max(MOST_DRIFT_CHANGE, tolerance / (at[-1] - at[0])))
            if len(recent):
                offset = float(np.median(came - (1 + drift) * at))
                anchor = float(at[-1])
            expected[new] = offset + (1 + drift) * starts[new]
            near, distance = _nearest(self.times, expected[new], first)
            places[new] = np.where(distance <= tolerance, near, -1)
            done = stop
        return _Pass(expected, places)

    def _find_doubts(self, passes: list[_Pass]) -> set[int]:
        """Passes that may be shifted by whole frames, as far as times tell."""
        # These are passes that lack half of their markers, or the first or last, or have a marker
        # beside them that could be of one of their frames, and all passes that follow or precede
        # them without a pause that is long enough to tell. Of a cut file the last pass is one too:
        # nothing says how many markers it should have, and they may be of two passes
        schedule = self.schedule
        spare = self._spare_times(passes)
        beyond = np.arange(1, MOST_SHIFT + 1) * schedule.step
        begins = np.array([one.expected[0] for one in passes])
        ends = np.array([one.expected[-1] for one in passes]) + schedule.pictures[-1]
        doubts = set()
        for number, one in enumerate(passes):
            if schedule.locks and one.matched >= 0.75 * schedule.frames:
                continue
            slots = np.concatenate([begins[number] - beyond, ends[number] + beyond - schedule.step])
            beside = np.abs(spare[:, None] - slots) < 4 * schedule.tolerance
            lacks = min(one.places[0], one.places[-1]) < 0 or one.matched <= schedule.frames / 2
            if lacks or beside.any() or (self.cut and number == len(passes) - 1):
                doubts.add(number)
        pauses = begins[1:] - ends[:-1]
        for number in np.flatnonzero(pauses < -0.5 * schedule.step).tolist():
            doubts |= {number, number + 1}
        if not schedule.locks:
            reach = (MOST_SHIFT + 0.5) * schedule.step + schedule.tolerance
            linked = np.flatnonzero(pauses < reach).tolist()
            for number in (*linked, *reversed(linked)):
                if {number, number + 1} & doubts:
                    doubts |= {number, number + 1}
        return doubts

    def _find_shifts(
        self, passes: list[_Pass], doubtful: set[int], counter: Counter | None
    ) -> dict[int, int]:
        """Shift of each doubtful pass in frames, of those of which photons tell."""
        # Those that lack half of their markers are left
        schedule = self.schedule
        order = [n for n in sorted(doubtful) if passes[n].matched > schedule.frames / 2]
        if counter is None or not order:
            return {}
        beyond = np.arange(1, MOST_SHIFT + 1) * schedule.step
        # What a clock that runs slow may take from a frame, and what markers may be off
        lost = MOST_DRIFT * schedule.pictures + 2 * schedule.tolerance
        length = np.pad(
            np.maximum(schedule.pictures - schedule.settle - lost, 0), MOST_SHIFT, mode="median"
        )
        begins = []
        for expected in (passes[number].expected for number in order):
            last = expected[-1] + schedule.pictures[-1] - schedule.step
            begins += [expected[0] - beyond[::-1], expected, last + beyond]
        starts = np.concatenate(begins) + schedule.settle + schedule.tolerance
        counts = counter(starts, starts + np.tile(length, len(order)))
        shifts = {}
        for number, photons in zip(order, counts.reshape(len(order), -1), strict=True):
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
                    shifts[number] = possible[0] - MOST_SHIFT
        return shifts

    def _overlapping(self, passes: list[_Pass]) -> set[int]:
        """Passes that begin before the one before has ended, and those before them."""
        length = self.schedule.pictures[-1] * (1 - MOST_DRIFT) - 2 * self.schedule.tolerance
        out = set()
        for number, (one, other) in enumerate(pairwise(passes)):
            if other.expected[0] < one.expected[-1] + length:
                out |= {number, number + 1}
        return out

    def _spare_times(self, passes: list[_Pass]) -> np.ndarray:
        """Times of the markers that start no frame of any pass."""
        spare = np.ones(len(self.times), bool)
        for one in passes:
            spare[one.places[one.places >= 0]] = False
        return self.times[spare]

    def _check_certain(self, passes: list[_Pass]) -> None:
        """Raise `InputError` unless it is certain which pass is of which scene."""
        times = self.times
        schedule = self.schedule
        spare = self._spare_times(passes)
        if len(spare) > min(MOST_FAULTS, len(times) / 2):
            raise InputError(
                f"{len(spare)} of {len(times)} markers do not follow the schedule: give the "
                "patterns that were shown, and one marker at the start of each frame"
            )
        few = len(passes) < self.scenes
        lacking = np.count_nonzero(passes[-1].expected > times[-1] + schedule.tolerance)
        if few and lacking <= MOST_RESTORED and not self.cut:
            raise InputError(
                f"markers of {len(passes)} whole passes, and there are {self.scenes} scenes: give "
                "those that were recorded"
            )
        # Markers before and between all passes are perhaps of one that was not found
        outside = times < passes[-1].expected[-1]
        for one in passes:
            until = one.expected[-1] + schedule.pictures[-1]
            outside &= (times < one.expected[0] - schedule.tolerance) | (times >= until)
        before = times[0] < passes[0].expected[0] - schedule.tolerance
        ends = lacking > MOST_RESTORED or (lacking and before) or (self.cut and few)
        if ends and outside.any():
            raise InputError(
                "the last pass is cut, and markers outside of all passes follow no schedule: which "
                "pass is of which scene is not certain; record again"
            )

    def _name_faults(
        self, passes: list[_Pass], unknown: set[int]
    ) -> tuple[np.ndarray, tuple[Fault, ...]]:
        """Starts of frames (S, F), NaN where they are not known, and every fault, extra last."""
        times = self.times
        end = times[-1] + self.schedule.tolerance
        spare = self._spare_times(passes)
        late = self._find_late(passes, spare)
        starts = np.full((self.scenes, self.schedule.frames), np.nan)
        faults: list[Fault] = []
        for scene in range(self.scenes):
            one = passes[scene] if scene < len(passes) else None
            if one is None or scene in unknown:
                detail = f"the recording has no markers after {times[-1]:.6f} s"
                if one is not None and one.expected[-1] <= end:
                    detail = (
                        f"from {one.expected[0]:.6f} s, which frame its markers start is not "
                        "certain, and the all-ON and all-OFF frames do not tell"
                    )
                faults.append(Fault(kind="lost", scene=scene, detail=detail))
                continue
            starts[scene] = np.where(one.places >= 0, times[one.places], one.expected)
            missing = np.flatnonzero(one.places < 0)
            for gap in np.split(missing, np.flatnonzero(np.diff(missing) > 1) + 1):
                restored = self._name_gap(scene, gap.tolist(), one.expected, late)
                faults += restored
                if any(fault.kind == "lost" for fault in restored):
                    starts[scene, gap] = np.nan
        late_markers = {marker for marker, _ in late.values()}
        until = passes[-1].expected[-1] if self.cut else np.inf  # after it, of a pass that was cut
        for marker, time in enumerate(spare.tolist()):
            if marker not in late_markers and time < until:
                faults.append(self._name_extra(time, passes, unknown))
        if len(faults) > MOST_FAULTS:
            raise InputError(f"{len(faults)} markers are missing, late or extra: record again")
        return starts, tuple(faults)

    def _find_late(
        self, passes: list[_Pass], spare: np.ndarray
    ) -> dict[tuple[int, int], tuple[int, float]]:
        """Spare markers that came within half a frame of a frame that has none, and by how much."""
        # From (scene, frame) to (place among the spare ones, seconds)
        late: dict[tuple[int, int], tuple[int, float]] = {}
        taken: set[int] = set()
        for scene, one in enumerate(passes if len(spare) else []):
            frames = np.flatnonzero(one.places < 0)
            near, distance = _nearest(spare, one.expected[frames])
            close = distance < 0.5 * self.schedule.step
            for frame, marker in zip(frames[close].tolist(), near[close].tolist(), strict=True):
                if marker not in taken:
                    taken.add(marker)
                    late[scene, frame] = (marker, float(spare[marker] - one.expected[frame]))
        return late

    def _name_gap(
        self,
        scene: int,
        gap: list[int],
        expected: np.ndarray,
        late: dict[tuple[int, int], tuple[int, float]],
    ) -> list[Fault]:
        """Faults of frames in a row that have no marker: one if they are lost, else one of each."""
        end = self.times[-1] + self.schedule.tolerance
        alone = sum((scene, frame) not in late for frame in gap)
        detail = ""
        if gap and expected[gap[0]] > end:
            detail = f"the recording has no markers after {end:.6f} s"
        elif alone > MOST_RESTORED:
            detail = f"{alone} markers are missing from {expected[gap[0]]:.6f} s"
        if detail:
            if len(gap) > 1:
                detail = f"frames {gap[0]} to {gap[-1]}: {detail}"
            return [Fault(kind="lost", scene=scene, frame=gap[0], detail=detail)]
        faults = []
        for frame in gap:
            due = f"due at {expected[frame]:.6f} s"
            if (scene, frame) not in late:
                faults.append(Fault(kind="missing", scene=scene, frame=frame, detail=due))
                continue
            off = late[scene, frame][1] * 1e6
            detail = f"{abs(off):.1f} µs {'late' if off > 0 else 'early'}, {due}"
            faults.append(Fault(kind="late", scene=scene, frame=frame, detail=detail))
        return faults

    def _name_extra(self, time: float, passes: list[_Pass], unknown: set[int]) -> Fault:
        """An extra marker, with the frame in which it came."""
        scene = frame = None
        for number, one in enumerate(passes):
            if one.expected[0] <= time < one.expected[-1] + self.schedule.pictures[-1]:
                scene = number
                if number not in unknown:
                    frame = int(np.searchsorted(one.expected, time, side="right")) - 1
        return Fault(kind="extra", scene=scene, frame=frame, detail=f"a marker at {time:.6f} s")


def find_steps(
    counts: np.ndarray, seconds: np.ndarray, sigmas: float = CERTAIN_SIGMAS
) -> tuple[np.ndarray, bool]:
    """Frames that may be all ON with the next all OFF, as far as photons tell."""
    timed = seconds > 0
    length = np.where(timed, seconds, 1.0)
    rates = counts / length
    variances = (counts + 1) / length**2
    steps = rates[:-1] - rates[1:]
    variance = variances[:-1] + variances[1:]
    usable = timed[:-1] & timed[1:]
    steepest = int(np.argmax(np.where(usable, steps, -np.inf)))
    if not usable[steepest]:
        return np.ones(len(steps), bool), False
    clear = bool(steps[steepest] > CERTAIN_SIGMAS * np.sqrt(variance[steepest]))
    lacking = LEAST_STEP * steps[steepest] - steps
    less = lacking > sigmas * np.sqrt(LEAST_STEP**2 * variance[steepest] + variance)
    falls = -steps > sigmas * np.sqrt(variance)
    return ~usable | ~(less & clear | falls), clear


def _nearest(
    times: np.ndarray, wanted: np.ndarray, first: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Marker nearest to each wanted time (k,), none before `first`, and its distance."""
    after = np.clip(np.searchsorted(times, wanted), first, len(times) - 1)
    before = np.maximum(after - 1, first)
    near = np.where(np.abs(times[before] - wanted) < np.abs(times[after] - wanted), before, after)
    return near, np.abs(times[near] - wanted)

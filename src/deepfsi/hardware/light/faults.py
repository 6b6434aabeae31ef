"""Faults of a recording: of its markers and its light, and how those of markers are named."""

from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.models import StrictModel
from deepfsi.hardware.counting.passes import (
    Markers,
    Pass,
    Schedule,
    nearest,
    overlapping,
    spare_times,
)

MOST_RESTORED = 3
"""Missing markers in a row that are restored; after more it is not sure that frames were shown."""

MOST_FAULTS = 10_000
"""Faults of a recording at most; one with more is refused."""

MARKERS = ("missing", "extra", "late", "lost")
"""Faults of the markers; the others are of the light."""

SPOILING = ("dark", "unsteady", "brighter", "flicker", "budget", "gain", "unsure", "unlike", "view")
"""Faults that leave a scene's counts without a meaning."""


class Fault(StrictModel):
    """Fault of a recording's markers or of its light."""

    # Markers: `missing`, restored from its neighbours and the schedule; `extra`, dropped; `late` or
    # early, replaced by the time of the schedule; `lost`, the time of the frame or of the whole
    # pass is not known. Light: `dark`, there is none; `unsteady`, it changed within the pass;
    # `brighter`, a mask sends more than all mirrors ON; `flicker`, it has a rhythm, in all passes;
    # `level`, its brightness is another from this scene on; `background`, so is that of the dark
    # frames. Detectors: `blind`, one of several saw almost no light in all scenes together; `gain`,
    # they share the light as in no scenes of the training. `budget`: there is less light than the
    # design was trained for, or, in a live run, not the stated light. Live runs: `unsure`, the
    # counts of a scene do not look like those of the training; `unlike`, nor do those of several
    # scenes before; `view`, the counts of all scenes so far are as if the picture on the
    # device were mirrored, blurred or the like
    kind: Literal[
        "missing", "extra", "late", "lost",
        "dark", "unsteady", "brighter", "flicker", "level", "background", "blind", "budget",
        "gain", "unsure", "unlike", "view",
    ]  # fmt: skip
    scene: int | None = None  # Which, from 0; None where no pass is meant
    frame: int | None = None  # Which, from 0; None where no one frame is meant
    detail: str  # What was seen and when

    def __str__(self) -> str:
        return self.words()

    def words(self, names: Sequence[str] = ()) -> str:
        """The fault in one line, with the name of its scene among those of all."""
        where = []
        if self.scene is not None:
            where += [f" scene {self.scene}", *(f" {name}" for name in names[self.scene :][:1])]
        if self.frame is not None:
            where.append(f" frame {self.frame}")
        return f"{self.kind}{','.join(where)}: {self.detail}"

    def line(self, names: Sequence[str] = ()) -> str:
        """The fault in one line that also says if it is of markers or light; as of `words`."""
        return f"{'marker' if self.kind in MARKERS else 'light'} {self.words(names)}"


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

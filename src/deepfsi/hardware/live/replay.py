"""A live run replayed from its files: photons counted again, and the decisions that follow.

The photon file and the frame log hold all that the run knew. `LiveCounts.count` finds each frame by
the number of its marker and counts its gate; `replay_run` hands the counts to the observer that
decided, asks of every list whether it is the one that was shown, and gives the decisions.

Processors round sums of products differently. So a look may differ from the one shown by rounding
(`LiveExposure.may_be`), and decisions follow from the one shown.
"""

import io
import json
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.files import hash_file, write_atomically
from deepfsi.base.numeric.arrays import read_npz
from deepfsi.base.progress import SILENT, Progress
from deepfsi.designfile.view_test import SceneReadouts
from deepfsi.hardware.counting.acquisition import Acquisition, read_run
from deepfsi.hardware.counting.streaming import FrameCounts
from deepfsi.hardware.light.curves import PARTS_OF_FRAME
from deepfsi.hardware.live.frame_log import DARK_SCENE, FrameLog, LoggedList, LoggedScene
from deepfsi.hardware.live.looks import FrameList, LiveExposure, LookChooser
from deepfsi.hardware.live.observer import (
    CHANCE_ROUNDING,
    SCENE_ENDS,
    Decision,
    SceneObserver,
)
from deepfsi.hardware.live.results import LiveAnswers, LiveScene
from deepfsi.hardware.patterns.manifest import Manifest
from deepfsi.hardware.photons.reader import count_windows, cut_windows, read_markers

PHOTONS = "photons.ptu"
"""File of the recording."""

HASHED_FILES = ("acquisition.json", FrameLog.NAME, PHOTONS)
"""Files whose hashes the counts hold."""


def is_live(folder: Path, *settings: object) -> bool:
    """True for the folder of a live run, which has a record of its frames."""
    live = (folder / FrameLog.NAME).exists()
    if live and any(setting is not None for setting in settings):
        raise InputError(
            "a live run is counted and classified as it was: its looks followed from these counts; "
            "leave the options out"
        )
    return live


@dataclass(frozen=True)
class LiveCounts:
    """Counts of the finished scenes of a live run."""

    NAME: ClassVar = "counts.npz"
    acquisition: Acquisition  # settings of the run
    manifest: Manifest  # patterns that were shown
    log: FrameLog  # scenes with their frames and gates
    frames: FrameCounts  # scene by scene, list by list, frame by frame

    @classmethod
    def count(cls, folder: Path, report: Progress = SILENT) -> Self:
        """Count the photons of a live run, and write the counts to its folder."""
        run = read_run(folder)
        log = FrameLog.read(folder)
        photons = run.open_photons()
        times, bits = read_markers(photons.path, report.between(0.0, 0.4))
        times = times[bits & run.acquisition.marker_bit != 0]
        numbers = np.concatenate([np.concatenate(scene.first_markers) for scene in log.scenes])
        if numbers.max() >= len(times):
            raise InputError(
                f"{photons.path} has {len(times)} frame markers, and {log.NAME} says at least "
                f"{numbers.max() + 1}: give the photon file of this run"
            )
        gate_ns = np.concatenate([shown.gate_ns for scene in log.scenes for shown in scene.lists])
        markers = times[numbers]
        starts = markers + round(run.acquisition.settle_s / photons.tick_s)
        lengths = np.rint(gate_ns * 1e-9 / photons.tick_s).astype(np.int64)
        starts, stops = cut_windows(starts, starts + lengths, PARTS_OF_FRAME)
        counts = count_windows(
            photons.path, starts, stops, run.acquisition.inputs, progress=report.between(0.4, 1.0)
        )
        counts = counts.reshape(len(markers), PARTS_OF_FRAME, -1)
        frames = FrameCounts(markers.astype(np.float64) * photons.tick_s, counts)
        about = np.frombuffer(json.dumps(_hashes(folder)).encode(), np.uint8)
        file = io.BytesIO()
        np.savez(file, counts=frames.parts, starts_s=frames.starts_s, about=about)
        write_atomically(folder / cls.NAME, file.getvalue())
        return cls(run.acquisition, run.manifest, log, frames)

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Counts as `count` wrote them."""
        path = folder / cls.NAME
        again = "count again with `deepfsi camera count`"
        log = FrameLog.read(folder)
        run = read_run(folder)
        manifest = run.patterns.manifest
        content = read_npz(path, again)
        try:
            counts = content["counts"]
            starts = content["starts_s"]
            about = json.loads(content["about"].tobytes())
        except (KeyError, ValueError, RecursionError):
            raise InputError(f"{path} is not a whole file of counts: {again}") from None
        frames = sum(len(shown.frames) for scene in log.scenes for shown in scene.lists)
        wanted = frames, PARTS_OF_FRAME, len(run.acquisition.inputs)
        fits = counts.shape == wanted and counts.dtype == np.int64
        fits &= starts.shape == (frames,) and starts.dtype == np.float64
        if not fits or about != _hashes(folder):
            raise InputError(f"{path} is of other files than those beside it: {again}")
        return cls(run.acquisition, manifest, log, FrameCounts(starts, counts))

    def as_dict(self) -> dict[str, Any]:
        """JSON types only: numbers of all, and the counts of each list of frames."""
        return {
            **self._totals,
            "counts": [
                [
                    {"look": shown.look, "frames": shown.frames, "counts": counts.counts.tolist()}
                    for shown, counts in zip(scene.lists, lists, strict=True)
                ]
                for scene, lists in self.by_scene
            ],
        }

    def lines(self) -> list[str]:
        """Say how much was counted."""
        totals = self._totals
        return [
            f"a live run: {totals['scenes']} scenes, {totals['looks']} looks, "
            f"{totals['frames']} frames",
            f"{totals['photons_counted']} photons counted",
        ]

    @property
    def _totals(self) -> dict[str, int]:
        """Numbers of all that was counted."""
        looks = [shown.look for scene in self.log.scenes for shown in scene.lists]
        return {
            "scenes": len(self.log.scenes),
            "looks": sum(look >= 0 for look in looks),
            "frames": len(self.frames.starts_s),
            "photons_counted": int(self.frames.parts.sum()),
        }

    @property
    def by_scene(self) -> Iterator[tuple[LoggedScene, list[FrameCounts]]]:
        """Scenes with the counts of their lists."""
        stop = 0
        for scene in self.log.scenes:
            lists = []
            for shown in scene.lists:
                start = stop
                stop += len(shown.frames)
                lists.append(self.frames[start:stop])
            yield scene, lists


def _hashes(folder: Path) -> dict[str, str]:
    """Hashes of the files that counts are of."""
    return {name: hash_file(folder / name) for name in HASHED_FILES}


class _LoggedFrames:
    """Frames of one scene, whose counts are looked up in place of being counted by devices."""

    def __init__(self, scene: LoggedScene, counts: list[FrameCounts]) -> None:
        self.left: deque[tuple[LoggedList, FrameCounts]] = deque(
            zip(scene.lists, counts, strict=True)
        )
        self.exact = True

    def count(self, asked: FrameList) -> FrameCounts:
        """Counts of the next list that was shown; `InputError` if another one is asked for."""
        if not self.left or not self.left[0][0].matches(asked):
            raise _another_look()
        return self.left.popleft()[1]

    @property
    def ended(self) -> bool:
        """True if no look was shown after those that were followed."""
        return not self.left or self.left[0][0].look == SCENE_ENDS

    def follow(self, asked: FrameList, exposure: LiveExposure) -> FrameList:
        """The next look as it was shown; `InputError` if not by rounding alone another one."""
        if not self.left:
            raise _another_look()
        logged = self.left[0][0]
        if logged.matches(asked):
            return asked
        shown = logged.as_shown(asked)
        if (asked.masks is None) == bool(logged.masks) or not exposure.may_be(asked, shown):
            raise _another_look()
        self.exact = False
        return shown


def _another_look() -> InputError:
    return InputError(
        "a look of this run is not the one that follows from its counts, and not by rounding: it "
        "was made with another version of the design or of deepfsi, or its files were changed"
    )


@dataclass(frozen=True)
class ReplayedScene:
    """A scene of a run replayed."""

    logged: LoggedScene  # as the run has it
    decisions: tuple[Decision, ...]  # after each look, from its counts
    answer: LiveScene
    rows: SceneReadouts | None = None  # its counts behind its masks


@dataclass(frozen=True)
class ReplayedRun:
    """A live run decided again from its counts."""

    exposure_s: float  # time of all looks, seconds
    scenes: tuple[ReplayedScene, ...]

    @property
    def answers(self) -> LiveAnswers:
        """Classes of its scenes."""
        last = [scene.decisions[-1] if scene.decisions else None for scene in self.scenes]
        return LiveAnswers.of(self.exposure_s, (scene.answer for scene in self.scenes), last)


def replay_run(counts: LiveCounts, looks: LookChooser) -> ReplayedRun:
    """Decide again from the counts of a live run."""
    observer = SceneObserver(looks, counts.manifest, counts.acquisition)
    replayed = []
    for scene, lists in counts.by_scene:
        source = _LoggedFrames(scene, lists)
        if scene.scene == DARK_SCENE:
            observer.measure_background(source)
            continue
        decisions = tuple(observer.observe(scene.scene, source, source))
        last = decisions[-1] if decisions else None
        agrees = not source.left and _agrees(scene, last)
        answer = LiveScene.of(
            counts.acquisition.scenes[scene.scene],
            last,
            looks,
            clock_s=scene.clock_s,
            agrees=agrees,
            bit_for_bit=agrees and source.exact and _is_same(scene, last),
        )
        rows = observer.rows if decisions else None
        replayed.append(ReplayedScene(scene, decisions, answer, rows))
    return ReplayedRun(counts.acquisition.exposure_s, tuple(replayed))


def _is_same(scene: LoggedScene, last: Decision | None) -> bool:
    """True if a scene's last decision is that of the run, bit for bit and word for word."""
    again = (tuple(last.chances.tolist()), last.faults) if last else ((), ())
    return again == (scene.chances, scene.faults)


def _agrees(scene: LoggedScene, last: Decision | None) -> bool:
    """True if a scene's last decision is that of the run, but for the rounding of probabilities.

    Words of a fault hold rounded numbers, so of faults only kind, scene and frame are compared.
    """
    before = np.array(scene.chances)
    again = last.chances if last else np.zeros(0)
    faults = [
        [(fault.kind, fault.scene, fault.frame) for fault in some]
        for some in (scene.faults, last.faults if last else ())
    ]
    return (
        before.shape == again.shape
        and faults[0] == faults[1]
        and (not len(again) or bool(before.argmax() == again.argmax()))
        and bool((abs(before - again) <= CHANCE_ROUNDING).all())
    )

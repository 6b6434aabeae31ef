"""A live run classified from its files: photons counted, and the classes that follow.

The photon file and the frame log hold all that the run knew. `LiveCounts.count` finds each frame by
the number of its marker and counts its gate; `replay_run` hands the counts, with the masks that
were shown, to the observer that decided.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Progress
from deepfsi.designfile.view_test import SceneReadouts
from deepfsi.hardware.counting.acquisition import Acquisition, read_run
from deepfsi.hardware.counting.streaming import FrameCounts
from deepfsi.hardware.light.curves import PARTS_OF_FRAME
from deepfsi.hardware.live.frame_log import FrameLog, LoggedScene
from deepfsi.hardware.live.looks import FrameList, LookChooser
from deepfsi.hardware.live.observer import (
    SCENE_ENDS,
    Decision,
    SceneObserver,
)
from deepfsi.hardware.live.results import LiveAnswers, LiveScene
from deepfsi.hardware.patterns.manifest import Manifest
from deepfsi.hardware.photons.reader import count_windows, cut_windows, read_markers


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

    acquisition: Acquisition  # settings of the run
    manifest: Manifest  # patterns that were shown
    log: FrameLog  # scenes with their frames and gates
    frames: FrameCounts  # scene by scene, list by list, frame by frame

    @classmethod
    def count(cls, folder: Path, report: Progress = SILENT) -> Self:
        """Count the photons of a live run."""
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
        return cls(run.acquisition, run.manifest, log, frames)

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


@dataclass(frozen=True)
class ReplayedScene:
    """A scene of a run, decided again from its counts."""

    decisions: tuple[Decision, ...]  # after each look
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


def replay_run(folder: Path, looks: LookChooser, report: Progress = SILENT) -> ReplayedRun:
    """Classes of a live run from its counts, behind the masks that were shown."""
    counts = LiveCounts.count(folder, report)
    observer = SceneObserver(looks, counts.manifest, counts.acquisition)
    replayed = []
    for scene, lists in counts.by_scene:
        source = _LoggedFrames(scene, lists)
        shown = _shown_looks(scene, counts.manifest)
        decisions = tuple(observer.observe(scene.scene, source, shown))
        answer = LiveScene.of(
            counts.acquisition.scenes[scene.scene],
            decisions[-1] if decisions else None,
            looks,
            clock_s=scene.clock_s,
        )
        replayed.append(ReplayedScene(decisions, answer, observer.rows if decisions else None))
    return ReplayedRun(counts.acquisition.exposure_s, tuple(replayed))


class _LoggedFrames:
    """Frames of one scene, whose counts are looked up in place of being counted by devices."""

    def __init__(self, scene: LoggedScene, counts: list[FrameCounts]) -> None:
        self._left = iter(zip(scene.lists, counts, strict=True))

    def count(self, asked: FrameList) -> FrameCounts:
        """Counts of the next list that was shown; `InputError` if another one is asked for."""
        shown, counts = next(self._left, (None, None))
        if shown is None or counts is None or not shown.matches(asked):
            raise _changed()
        return counts


def _shown_looks(scene: LoggedScene, manifest: Manifest) -> list[FrameList]:
    """Looks of a scene as they were shown; `InputError` where its patterns have no such ones."""
    assert manifest.looks is not None
    looks = [shown.as_shown(manifest) for shown in scene.lists if shown.look != SCENE_ENDS]
    masks = 0 if manifest.looks.dictionary else 1
    for number, look in enumerate(looks):
        if (
            look.look != number
            or number >= manifest.looks.count
            or len(look.frames) != 1
            or look.frames[0] not in manifest.shown
            or len(() if look.masks is None else look.masks) != masks
        ):
            raise _changed()
    if not looks and len(scene.lists) > 1:
        raise _changed()
    return looks


def _changed() -> InputError:
    return InputError(
        f"{FrameLog.NAME} does not fit the patterns and settings of this run: its files were "
        "changed, or it was made with another version of deepfsi"
    )

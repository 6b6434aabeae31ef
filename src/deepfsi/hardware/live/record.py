"""A live run afterwards: the record of what it showed, its answers, and its replay.

`shown.jsonl` has a line for each scene that is finished. It is written when the scene is decided,
so that a run that is stopped at any moment keeps all scenes before.

A recorded run is counted again, each gate after its own marker, and its looks are decided again
from these counts by the masks that were shown.
"""

from base64 import b64decode, b64encode
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator

from deepfsi.base.errors import InputError
from deepfsi.base.files import read_regular
from deepfsi.base.models.strict import StrictModel, WholeNumber
from deepfsi.base.progress import SILENT, Progress
from deepfsi.base.quantities import Table, plural
from deepfsi.designfile.provenance import Score, was_trained_on
from deepfsi.designfile.view_test import SceneReadouts, ViewResult
from deepfsi.hardware.counting.acquisition import Acquisition, Scene, read_run
from deepfsi.hardware.counting.streaming import FrameCounts
from deepfsi.hardware.light.checks import SPOILING, Fault
from deepfsi.hardware.light.curves import PARTS_OF_FRAME
from deepfsi.hardware.live.observer import (
    SCENE_ENDS,
    Decision,
    FrameList,
    LookChooser,
    SceneObserver,
)
from deepfsi.hardware.patterns.manifest import Manifest
from deepfsi.hardware.photons.reader import count_windows, cut_windows, read_markers


class LoggedList(StrictModel):
    """A list of frames as it was shown."""

    look: int = Field(ge=-1, le=1023)  # From 0; -1 for those that begin and end a scene
    frames: tuple[int, ...]  # Places among the frames of the manifest
    gate_ns: tuple[int, ...]  # For how long each was counted
    # Markers that each gave, and at the end those of the all-OFF frame that was shown while the
    # next list was chosen
    markers: tuple[int, ...]
    masks: tuple[str, ...] = ()  # Pixels ON of frames that were made for this list, base64 of bits

    @classmethod
    def of(cls, asked: FrameList, markers: np.ndarray) -> Self:
        """A list that was shown, with the markers (F + 1,) of its frames and of the last one."""
        return cls(
            look=asked.look,
            frames=tuple(asked.frames.tolist()),
            gate_ns=tuple(asked.gate_ns.tolist()),
            markers=tuple(markers.tolist()),
            masks=_packed(asked.masks),
        )

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if not len(self.frames) == len(self.gate_ns) == len(self.markers) - 1:
            raise ValueError("frames, gates and markers differ in number")
        if min(self.gate_ns, default=1) < 0 or min(self.markers, default=1) < 1:
            raise ValueError("gates are 0 or more, and each frame gives a marker")
        return self

    def matches(self, asked: FrameList) -> bool:
        """True if these are the frames and their gates."""
        return (
            self.look == asked.look
            and np.array_equal(self.frames, asked.frames)
            and np.array_equal(self.gate_ns, asked.gate_ns)
        )

    def as_shown(self, manifest: Manifest) -> FrameList:
        """The list as it was shown; its masks have the pixels of the patterns."""
        masks = None
        if self.masks:
            pixels = prod(manifest.image_shape)
            size = (pixels + 7) // 8
            try:
                bits = np.frombuffer(b"".join(map(b64decode, self.masks)), np.uint8)
                masks = np.unpackbits(bits.reshape(-1, size), axis=1, count=pixels).astype(bool)
            except ValueError:
                raise InputError(
                    f"masks in {FrameLog.NAME} are not of {pixels} pixels: the file was changed"
                ) from None
        return FrameList(self.look, np.array(self.frames), np.array(self.gate_ns), masks)


def _packed(masks: np.ndarray | None) -> tuple[str, ...]:
    """Masks (F, N) of bool, or none, each as the base64 of its bits."""
    if masks is None:
        return ()
    return tuple(b64encode(bits.tobytes()).decode() for bits in np.packbits(masks, axis=1))


class LoggedScene(StrictModel):
    """A scene as it was shown, and what was decided."""

    scene: WholeNumber  # From 0
    first_marker: WholeNumber  # Markers before those of this scene
    lists: tuple[LoggedList, ...]  # In their order
    chances: tuple[float, ...]  # Probabilities of the classes; none if there was no light
    faults: tuple[Fault, ...] = ()  # Of the scene
    light_s: float = Field(ge=0)  # Exposure used, seconds
    clock_s: float = Field(ge=0)  # From the scene's first command to its decision, seconds

    @property
    def line(self) -> bytes:
        """Its line in the record."""
        return f"{self.model_dump_json()}\n".encode()

    @property
    def first_markers(self) -> list[np.ndarray]:
        """Number of the marker that each frame begins with, list by list."""
        before = self.first_marker
        out = []
        for shown in self.lists:
            markers = np.array(shown.markers, np.int64)
            out.append((before + np.cumsum(markers) - markers)[:-1])
            before += int(markers.sum())
        return out


@dataclass(frozen=True)
class FrameLog:
    """Finished scenes of a live run, in their order."""

    NAME: ClassVar = "shown.jsonl"
    scenes: tuple[LoggedScene, ...]

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Record of a run, or `InputError` if it has no scenes or they do not follow."""
        # A last line that is not whole is that of a run that was killed, and is left out
        path = folder / cls.NAME
        content = read_regular(path, 2**31, "give a run of `camera live`")
        lines = content.split(b"\n")[:-1]
        try:
            scenes = tuple(LoggedScene.model_validate_json(line) for line in lines)
        except ValidationError:
            raise InputError(f"{path} is damaged: run `deepfsi camera live` again") from None
        numbers = [scene.scene for scene in scenes]
        if not numbers:
            raise InputError(f"{path} has no finished scene: run `deepfsi camera live` again")
        if numbers != list(range(len(numbers))):
            raise InputError(f"{path} has scenes that do not follow each other: it was changed")
        return cls(scenes)


@dataclass(frozen=True)
class LiveScene:
    """Class of a scene of a live run, from its looks."""

    name: str
    label: str | None  # class that it is known to be of
    predicted: str | None
    probability: float | None
    looks: int
    photons: float | None  # budget of a whole exposure
    light_s: float  # exposure that was used, seconds
    clock_s: float  # from the first command to the class, seconds
    faults: tuple[Fault, ...] = ()  # of its light, its budget and its counts
    trained_on: bool | None = None  # True if the design was

    @classmethod
    def of(
        cls, scene: Scene, decision: Decision | None, looks: LookChooser, *, clock_s: float
    ) -> Self:
        """Class of a scene after its last decision; none is of a scene without light."""
        [trained] = was_trained_on(looks.training_scenes, [scene.hash])
        best = None
        if decision and not any(fault.kind in SPOILING for fault in decision.faults):
            best = int(decision.chances.argmax())
        return cls(
            name=scene.name,
            label=scene.label,
            predicted=None if best is None else looks.classes[best],
            probability=None if decision is None or best is None else float(decision.chances[best]),
            looks=decision.look + 1 if decision else 0,
            photons=decision.photons if decision else None,
            light_s=decision.light_s if decision else 0.0,
            clock_s=clock_s,
            faults=decision.faults if decision else (),
            trained_on=trained,
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        names = {"name": "scene", "predicted": "class"}
        content = {names.get(name, name): value for name, value in vars(self).items()}
        content["faults"] = [str(fault) for fault in self.faults]
        return content

    def lines(self, exposure_s: float) -> list[str]:
        """Say the answer and each fault, of a whole exposure of so many seconds."""
        if not self.looks:
            return [f"{self.name}: no light"]
        faults = [f"  {fault.words()}" for fault in self.faults]
        if self.predicted is None:
            return [f"{self.name}: no class", *faults]
        return [
            f"{self.name}: {self.predicted}, confidence {self.probability:.3f}, "
            f"{plural(self.looks, 'look')}, light {self.light_s * 1e3:.4g} ms "
            f"({self.light_s / exposure_s:.0%}), clock {self.clock_s * 1e3:.4g} ms",
            *faults,
        ]


@dataclass(frozen=True)
class LiveAnswers:
    """Classes of the scenes of a live run, as it was made or decided again from its counts."""

    exposure_s: float  # time of all looks, seconds
    scenes: tuple[LiveScene, ...]
    view: ViewResult | None = None

    @classmethod
    def of(
        cls, exposure_s: float, scenes: Iterable[LiveScene], decisions: Iterable[Decision | None]
    ) -> Self:
        """Answers of a run with its last decisions, the latest of which tells of the view."""
        views = [decision.view for decision in decisions if decision and decision.view]
        return cls(exposure_s, tuple(scenes), views[-1] if views else None)

    def check_classes(self, folder: Path) -> None:
        """Raise `InputError` if no scene of a run has light, or none has a class."""
        if not any(scene.looks for scene in self.scenes):
            raise InputError(
                f"no scene of {folder} has light: no all-ON frame is brighter than the all-OFF "
                "ones; check the lamp, the inputs and the counter's trigger levels, or export "
                "with a longer `exposure`"
            )
        if all(scene.predicted is None for scene in self.scenes):
            first = next(fault for scene in self.scenes for fault in scene.faults)
            raise InputError(f"no scene of {folder} has a class: {first.words()}")

    def _score_lines(self) -> Iterator[str]:
        """Say how many scenes have no class, how many are right, and how the camera saw them."""
        none = sum(scene.predicted is None for scene in self.scenes)
        if none:
            yield f"no class: {none} of {len(self.scenes)} scenes"
        yield from self.score.lines("scene")
        if self.view is not None and self.view.remark:
            yield self.view.remark

    def run_lines(self) -> Iterator[str]:
        """Say how a run went that was just made, with the light and the time that it took."""
        yield from self._score_lines()
        count = len(self.scenes)
        light_s = sum(scene.light_s for scene in self.scenes) / count
        clock_s = sum(scene.clock_s for scene in self.scenes) / count
        yield (
            f"light used {light_s / self.exposure_s:.1%} of the exposures, clock time "
            f"{clock_s * 1e3:.4g} ms a scene"
        )

    def lines(self) -> Iterator[str | Table]:
        """Say the classes of a run that was replayed."""
        heads = ("scene", "class", "confidence", "looks", "light", "labelled", "remarks")
        rows = [
            (
                scene.name,
                scene.predicted or "none",
                "" if scene.probability is None else f"{scene.probability:.3f}",
                str(scene.looks),
                f"{scene.light_s / self.exposure_s:.0%}",
                scene.label or "",
                ", ".join(sorted({fault.kind for fault in scene.faults})),
            )
            for scene in self.scenes
        ]
        yield Table("a live run, replayed from its counts", heads, rows)
        names = [scene.name for scene in self.scenes]
        for scene in self.scenes:
            for fault in scene.faults:
                yield fault.words(names)
        yield from self._score_lines()

    @property
    def score(self) -> Score:
        """Right answers to the labelled scenes, of those that have a class."""
        return Score.of(
            (scene.trained_on, scene.predicted == scene.label, 1)
            for scene in self.scenes
            if scene.predicted is not None and scene.label is not None
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {
            "live": True,
            "score": self.score.as_dict(),
            "view": None if self.view is None else self.view.as_dict(),
            "scenes": [scene.as_dict() for scene in self.scenes],
        }


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
class _ReplayedScene:
    """A scene of a run, decided again from its counts."""

    decisions: tuple[Decision, ...]  # after each look
    answer: LiveScene
    rows: SceneReadouts | None = None  # its counts behind its masks


@dataclass(frozen=True)
class _ReplayedRun:
    """A live run decided again from its counts."""

    exposure_s: float  # time of all looks, seconds
    scenes: tuple[_ReplayedScene, ...]

    @property
    def answers(self) -> LiveAnswers:
        """Classes of its scenes."""
        last = [scene.decisions[-1] if scene.decisions else None for scene in self.scenes]
        return LiveAnswers.of(self.exposure_s, (scene.answer for scene in self.scenes), last)


def replay_run(folder: Path, looks: LookChooser, report: Progress = SILENT) -> _ReplayedRun:
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
        replayed.append(_ReplayedScene(decisions, answer, observer.rows if decisions else None))
    return _ReplayedRun(counts.acquisition.exposure_s, tuple(replayed))


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

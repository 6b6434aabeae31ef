"""Answers of recorded and of live runs, and the record of a live run.

`shown.jsonl` has a line for each scene that is finished. It is written when the scene is decided,
so that a run that is stopped at any moment keeps all scenes before.
"""

from base64 import b64encode
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import Field, ValidationError

from deepfsi.base.errors import InputError
from deepfsi.base.files import read_regular
from deepfsi.base.models import StrictModel, WholeNumber
from deepfsi.base.quantities import Table, plural
from deepfsi.counting.acquisition import Scene
from deepfsi.counting.checks import SPOILING, Fault
from deepfsi.designfile.distribution import ConsistencyResult
from deepfsi.designfile.provenance import Score
from deepfsi.designfile.view_test import ViewResult

LOG = "shown.jsonl"
"""File of the finished scenes of a live run."""


@dataclass(frozen=True)
class FrameList:
    """Frames that are shown one after another, and counted."""

    look: int  # from 0
    frames: np.ndarray  # places among the frames of the manifest
    gate_ns: np.ndarray  # for how long each is counted
    masks: np.ndarray | None = None


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
        packed = () if asked.masks is None else np.packbits(asked.masks, axis=1)
        return cls(
            look=asked.look,
            frames=tuple(asked.frames.tolist()),
            gate_ns=tuple(asked.gate_ns.tolist()),
            markers=tuple(markers.tolist()),
            masks=tuple(b64encode(bits.tobytes()).decode() for bits in packed),
        )


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


def read_log(folder: Path) -> tuple[LoggedScene, ...]:
    """Finished scenes of a live run; `InputError` if there are none or they do not follow."""
    # A last line that is not whole is that of a run that was killed, and is left out
    path = folder / LOG
    lines = read_regular(path, 2**31, "give a run of `camera live`").split(b"\n")[:-1]
    try:
        scenes = tuple(LoggedScene.model_validate_json(line) for line in lines)
    except ValidationError:
        raise InputError(f"{path} is damaged: run `deepfsi camera live` again") from None
    numbers = [scene.scene for scene in scenes]
    if not numbers:
        raise InputError(f"{path} has no finished scene: run `deepfsi camera live` again")
    if numbers != list(range(len(numbers))):
        raise InputError(f"{path} has scenes that do not follow each other: it was changed")
    return scenes


@dataclass(frozen=True, kw_only=True)
class Classified:
    """Class of a scene or a picture."""

    NAME_KEY = "scene"  # of JSON

    name: str
    label: str | None = None  # class that it is known to be of
    predicted: str | None = None
    trained_on: bool | None = None  # True if the design was; None where its file does not say

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        keys = {"name": self.NAME_KEY, "predicted": "class"}
        content = {keys.get(name, name): value for name, value in vars(self).items()}
        if "faults" in content:
            content["faults"] = [str(fault) for fault in content["faults"]]
        return content


@dataclass(frozen=True, kw_only=True)
class ClassifiedScene(Classified):
    """Class of a scene from its exposures."""

    probability: float | None = None
    exposures: int = 0
    guesses: tuple[str, ...] = ()  # class of each
    photons: float | None = None  # budget of an exposure
    faults: tuple[Fault, ...] = ()  # of the scene, and of the whole recording
    consistency: float | None = None  # p-value of its counts
    unsure: bool | None = None  # True if they do not look like those of the training

    def row(self, several: bool) -> tuple[str, ...]:
        """Cells of a table, with the exposures that have its class if some have several."""
        agreeing = ""
        if self.predicted:
            agreeing = f"{self.guesses.count(self.predicted)} of {self.exposures}"
        kinds = sorted({fault.kind for fault in self.faults})
        return (
            self.name,
            self.predicted or "none",
            "" if self.probability is None else f"{self.probability:.3f}",
            *([agreeing] if several else []),
            self.label or "",
            ", ".join(kinds + ["unsure"] * bool(self.unsure)),
        )


@dataclass(frozen=True)
class ClassifiedRun:
    """Classes of the scenes of a run or a table."""

    design: str
    masks: int
    classes: tuple[str, ...]  # those that the design tells apart
    scenes: tuple[ClassifiedScene, ...]
    remarks: tuple[str, ...]  # on the tests of the counts, for a reader
    faults: tuple[Fault, ...] = ()  # of the markers and the light
    consistency: ConsistencyResult | None = None
    view: ViewResult | None = None

    def lines(self) -> Iterator[str | Table]:
        """Say the class of each scene, what is wrong with it, and how many are right."""
        several = any(scene.exposures > 1 for scene in self.scenes)
        chances = ("mean probability", "of its exposures") if several else ("probability",)
        yield Table(
            f"{self.design}, {self.masks} masks",
            ("scene", "class", *chances, "labelled", "remarks"),
            [scene.row(several) for scene in self.scenes],
        )
        names = [scene.name for scene in self.scenes]
        for fault in self.faults:
            yield fault.words(names)
        yield from self.remarks
        labelled = sum(len(scene.guesses) for scene in self.scenes if scene.label)
        if foreign := labelled - self.score.answers:
            yield (
                f"{foreign} exposures have labels that are none of the design's classes: left out"
            )
        yield from self.score.lines("exposure")

    @property
    def score(self) -> Score:
        """Right answers to exposures of scenes whose label is a class of the design."""
        return Score.of(
            (scene.trained_on, scene.guesses.count(scene.label), len(scene.guesses))
            for scene in self.scenes
            if scene.label in self.classes
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {
            "score": self.score.as_dict(),
            "consistency": None if self.consistency is None else self.consistency.as_dict(),
            "view": None if self.view is None else self.view.as_dict(),
            "remarks": list(self.remarks),
            "scenes": [scene.as_dict() for scene in self.scenes],
        }


@dataclass(frozen=True, kw_only=True)
class LiveScene(Classified):
    """Class of a scene of a live run, from its looks."""

    probability: float | None
    looks: int
    photons: float | None  # budget of a whole exposure, known during the run alone
    light_s: float  # exposure that was used, seconds
    clock_s: float  # from the first command to the class, seconds
    faults: tuple[Fault, ...] = ()  # of its light, its budget and its counts

    @classmethod
    def of(
        cls,
        scene: Scene,
        logged: LoggedScene,
        classes: tuple[str, ...],
        trained_on: bool | None,
        photons: float | None = None,
    ) -> Self:
        """Class of a scene by its line of the log; none is of a scene with a fault that spoils."""
        chances = logged.chances
        if any(fault.kind in SPOILING for fault in logged.faults):
            chances = ()
        return cls(
            name=scene.name,
            label=scene.label,
            predicted=classes[int(np.argmax(chances))] if chances else None,
            probability=max(chances) if chances else None,
            looks=sum(shown.look >= 0 for shown in logged.lists),
            photons=photons,
            light_s=logged.light_s,
            clock_s=logged.clock_s,
            faults=logged.faults,
            trained_on=trained_on,
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        content = super().as_dict()
        if self.photons is None:  # the log has no budgets
            del content["photons"]
        return content

    def lines(self, exposure_s: float) -> list[str]:
        """Say the answer and each fault; a whole exposure lasts `exposure_s`."""
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
    """Classes of the scenes of a live run."""

    exposure_s: float  # time of all looks, seconds
    scenes: tuple[LiveScene, ...]
    view: ViewResult | None = None

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
        """Say the classes of a run that was recorded."""
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
        yield Table("a live run, as it was decided", heads, rows)
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
        content: dict[str, Any] = {"live": True, "score": self.score.as_dict()}
        if self.view is not None:
            content["view"] = self.view.as_dict()
        return content | {"scenes": [scene.as_dict() for scene in self.scenes]}

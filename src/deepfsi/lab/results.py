"""Classes of scenes and of pictures, and the record of a live run.

`shown.jsonl` has a line for each scene that is finished. It is written when the scene is decided,
so that a run that is stopped at any moment keeps all scenes before.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.files import read_regular
from deepfsi.base.models import StrictModel, WholeNumber
from deepfsi.base.quantities import Table, plural, time_text
from deepfsi.counting.acquisition import Scene
from deepfsi.counting.checks import SPOILING, Fault
from deepfsi.designfile.misfit import FALSE_ALARM
from deepfsi.designfile.provenance import Score, score_lines, score_of
from deepfsi.designfile.view_test import ViewResult
from deepfsi.lab.count_test import DARK_LABEL

LOG = "shown.jsonl"
"""File of the finished scenes of a live run."""


MARGIN_NS = 2000
"""Time by which a picture outlasts its gate at least, so that markers may be off, ns."""

OFF = 1
"""Index of the all-OFF frame in a manifest, after the all-ON one."""


@dataclass(frozen=True)
class FrameList:
    """Frames that are shown one after another, and counted."""

    look: int  # from 0
    frames: np.ndarray  # indices of frames of the manifest
    gate_ns: np.ndarray  # for how long each is counted
    masks: np.ndarray | None = None  # of frames that are loaded before


@dataclass(frozen=True)
class Decision:
    """Answer after a look at a scene."""

    scene: int  # from 0
    look: int  # from 0; -1 where the scene has no light
    probabilities: np.ndarray  # (C,): probabilities of the classes; none without light
    photons: float | None  # budget of a whole exposure, in counts
    light_s: float  # exposure so far, seconds
    final: bool  # true if no look follows
    faults: tuple[Fault, ...] = ()  # of the scene, after its last look
    view: ViewResult | None = None  # of all scenes so far, likewise; none where it is not tested
    clock_s: float = 0.0  # after the scene's first command, seconds
    answer: "ClassifiedScene | None" = None  # class of the scene, after its last look


class LoggedList(StrictModel):
    """A list of frames as it was shown."""

    look: int = Field(ge=-1, le=1023)  # From 0; -1 for those that begin and end a scene
    frames: tuple[int, ...]  # Indices of frames of the manifest
    gate_ns: tuple[int, ...]  # For how long each was counted
    # Markers that each gave, and at the end those of the all-OFF frame that was shown while the
    # next list was chosen
    markers: tuple[int, ...]
    masks: tuple[str, ...] = ()  # Pixels ON of frames that were made for this list, base64 of bits


class LoggedScene(StrictModel):
    """A scene as it was shown, and the decision on it."""

    scene: WholeNumber  # From 0
    first_marker: WholeNumber  # Markers before those of this scene
    lists: tuple[LoggedList, ...]  # In their order
    chances: tuple[float, ...]  # Probabilities of the classes; none if there was no light
    faults: tuple[Fault, ...] = ()  # Of the scene
    light_s: float = Field(ge=0)  # Exposure used, seconds
    clock_s: float = Field(ge=0)  # From the scene's first command to its decision, seconds

    def answer(
        self, scene: Scene, classes: tuple[str, ...], trained_on: bool | None, tested: bool
    ) -> "ClassifiedScene":
        """Class of the scene; it has none if a fault spoils its counts."""
        spoilt = any(fault.kind in SPOILING for fault in self.faults)
        probabilities = () if spoilt else self.chances
        return ClassifiedScene(
            name=scene.name,
            label=scene.label,
            predicted=classes[int(np.argmax(probabilities))] if probabilities else None,
            probability=max(probabilities, default=None),
            trained_on=trained_on,
            faults=self.faults,
            unlike=any(fault.kind == "unlike" for fault in self.faults) if tested else None,
            looks=sum(shown.look >= 0 for shown in self.lists),
            light_s=self.light_s,
            clock_s=self.clock_s,
        )


def lag_remarks(scenes: Sequence[Scene]) -> tuple[str, ...]:
    """Sentence on a display that lags, unless a scene that is to be dark would tell."""
    words = "a display that lags by a whole scene cannot be seen: begin with a black one, labelled"
    told = len(scenes) < 2 or any(scene.label == DARK_LABEL for scene in scenes)
    return () if told else (f"{words} `{DARK_LABEL}`",)


def mark_early(answers: Sequence["ClassifiedScene"]) -> tuple["ClassifiedScene", ...]:
    """Answers of a live run; those before a fault of the whole run say so."""
    whole = [any(f.scene is None and f.kind in SPOILING for f in one.faults) for one in answers]
    first = whole.index(True) if any(whole) else 0
    detail = f"the class was given before the run was refused, at scene {first}"
    early = Fault(kind="early", detail=detail)
    before = [replace(one, faults=(*one.faults, early)) for one in answers[:first]]
    return (*before, *answers[first:])


def read_log(folder: Path) -> tuple[LoggedScene, ...]:
    """Finished scenes of a live run; `InputError` if there are none or they do not follow."""
    # A run that was killed may leave an unfinished last line, which is dropped
    path = folder / LOG
    lines = read_regular(path, 2**31, "give a run of `camera live`").split(b"\n")[:-1]
    with as_input_error(f"{path} is damaged and", "run `deepfsi camera live` again"):
        scenes = tuple(LoggedScene.model_validate_json(line) for line in lines)
    numbers = [scene.scene for scene in scenes]
    if not scenes or numbers != list(range(len(scenes))):
        raise InputError(
            f"{path} has no scenes, or scenes that do not follow each other: run `deepfsi camera "
            "live` again"
        )
    return scenes


@dataclass(frozen=True, kw_only=True)
class ClassifiedScene:
    """Class of a scene, or of a picture."""

    name: str
    label: str | None = None  # class that it is known to be of
    predicted: str | None = None
    probability: float | None = None
    trained_on: bool | None = None  # True if the design was; None where its file does not say
    unlike: bool | None = None  # True if its counts are unlike the training's; None if not tested
    faults: tuple[Fault, ...] = ()  # of the scene, and of the whole recording
    photons: float | None = None  # budget of an exposure
    # Of a recording
    guesses: tuple[str, ...] | None = None  # class of each exposure
    # Of a live run
    looks: int | None = None
    light_s: float | None = None  # exposure that was used, seconds
    clock_s: float | None = None  # from the first command to the class, seconds

    @property
    def answers(self) -> tuple[str, ...]:
        """Class of each exposure, or the one that was decided on."""
        if self.guesses is not None:
            return self.guesses
        return () if self.predicted is None else (self.predicted,)

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        content = dict(vars(self), faults=[str(fault) for fault in self.faults])
        content = {"scene": content.pop("name"), "class": content.pop("predicted"), **content}
        always = ("class", "label", "probability", "trained_on", "unlike")
        return {key: value for key, value in content.items() if value is not None or key in always}

    def cells(self) -> dict[str, str]:
        """Cells of a table by their heads."""
        repeated = len(self.answers) > 1
        agreeing = f"{self.answers.count(str(self.predicted))} of {len(self.answers)}"
        kinds: set[str] = {fault.kind for fault in self.faults}
        if self.unlike:
            kinds.add("unlike")
        return {
            "scene": self.name,
            "class": self.predicted or "none",
            "probability": "" if self.probability is None else f"{self.probability:.3f}",
            "of its exposures": agreeing if repeated else "",
            "looks": "" if self.looks is None else str(self.looks),
            "light": "" if self.light_s is None else time_text(self.light_s),
            "labelled": self.label or "",
            "remarks": ", ".join(sorted(kinds)),
        }


@dataclass(frozen=True, kw_only=True)
class ClassifiedRun:
    """Classes of the scenes of a run or a table, or of pictures."""

    title: str  # design, and the light
    classes: tuple[str, ...]  # those that the design tells apart
    scenes: tuple[ClassifiedScene, ...]
    noun: str = "exposure"  # what each answer is to
    remarks: tuple[str, ...] = ()  # on the tests of the counts, for a reader
    faults: tuple[Fault, ...] = ()  # of the markers and the light
    view: ViewResult | None = None

    @property
    def score(self) -> Score:
        """Right answers to scenes whose label is a class of the design."""
        return score_of(
            (scene.trained_on, scene.answers.count(scene.label), len(scene.answers))
            for scene in self.scenes
            if scene.label in self.classes
        )

    def lines(self) -> Iterator[str | Table]:
        """Say the class of each scene, its faults, and how many answers are right."""
        rows = [scene.cells() for scene in self.scenes]
        heads = [head for head in rows[0] if any(row[head] for row in rows)]
        yield Table(self.title, heads, [[row[head] for head in heads] for row in rows])
        names = [scene.name for scene in self.scenes]
        for fault in self.faults:
            yield fault.words(names)
        yield from self.summary()

    def summary(self) -> Iterator[str]:
        """Say the results of the tests of counts, and how many answers are right."""
        yield from self.remarks
        if unlike := sum(bool(scene.unlike) for scene in self.scenes):
            yield (
                f"unlike: {unlike} of {len(self.scenes)} do not look like those of the training, "
                f"as 1 sound scene in {1 / FALSE_ALARM:g} does not"
            )
        unclassified = sum(scene.predicted is None for scene in self.scenes)
        if unclassified:
            yield f"no class: {unclassified} of {plural(len(self.scenes), 'scene')}"
        labelled = sum(len(scene.answers) for scene in self.scenes if scene.label)
        if foreign := labelled - sum(kind["answers"] for kind in self.score.values()):
            answers = plural(foreign, self.noun)
            yield f"{answers} with labels that are none of the design's classes: left out"
        yield from score_lines(self.score, self.noun)

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {
            "score": self.score,
            **({} if self.view is None else {"view": self.view.as_dict()}),
            "remarks": list(self.remarks),
            "scenes": [scene.as_dict() for scene in self.scenes],
        }

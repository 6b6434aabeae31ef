"""Classes of scenes as a run or a table gives them."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from deepfsi.designfile import was_trained_on
from deepfsi.hardware.light import SPOILING, Fault
from deepfsi.lab.score import Score

if TYPE_CHECKING:
    from deepfsi.designfile import ConsistencyResult, ViewResult
    from deepfsi.hardware.counting import Scene
    from deepfsi.hardware.live.decisions import Decision
    from deepfsi.hardware.live.looks import LiveLooks


def _in_json(scene: object) -> dict[str, Any]:
    """Fields of a scene by the names that they have in JSON."""
    names = {"name": "scene", "predicted": "class"}
    return {names.get(name, name): value for name, value in vars(scene).items()}


@dataclass(frozen=True)
class ClassifiedScene:
    """Class of a scene from its exposures."""

    name: str
    label: str | None  # class that it is known to be of
    predicted: str | None  # class of the mean probabilities; none without a sound exposure
    probability: float | None  # of that class, mean over the exposures
    exposures: int  # that are sound
    guesses: tuple[str, ...]  # class of each
    photons: float | None  # budget of an exposure
    faults: tuple[Fault, ...]  # of the scene, and of the whole recording
    consistency: float | None  # p-value of its counts; none where they were not tested
    unsure: bool | None  # true if they do not look like those of the training
    trained_on: bool | None = None  # true if the design was; none where it is not known

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return _in_json(self) | {"faults": [str(fault) for fault in self.faults]}


@dataclass(frozen=True)
class ClassifiedRun:
    """Classes of the scenes of a run or a table."""

    design: str
    masks: int
    classes: tuple[str, ...]  # those that the design tells apart
    scenes: tuple[ClassifiedScene, ...]
    faults: tuple[Fault, ...]  # of the markers and the light
    consistency: "ConsistencyResult | None"  # with the training; none where it was not tested
    remarks: tuple[str, ...]  # on the consistency, for a reader
    view: "ViewResult | None" = None  # of the camera; none where it was not tested

    @property
    def score(self) -> Score:
        """Right answers to exposures of scenes whose label is a class of the design."""
        return Score.of(
            (each.trained_on, each.guesses.count(each.label), len(each.guesses))
            for each in self.scenes
            if each.label in self.classes
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


@dataclass(frozen=True)
class LiveScene:
    """Class of a scene of a live run, from its looks."""

    name: str
    label: str | None  # class that it is known to be of
    predicted: str | None  # none without light, or with a fault that spoils it
    probability: float | None
    looks: int  # that were shown
    photons: float | None  # budget of a whole exposure
    light_s: float  # exposure that was used, seconds
    clock_s: float  # from the first command to the class, seconds
    agrees: bool | None = None  # of a replay: true if it decides as the run did, bit for bit
    faults: tuple[Fault, ...] = ()  # of its light, its budget and its counts
    trained_on: bool | None = None  # true if the design was; none where it is not known

    @classmethod
    def of(
        cls,
        scene: "Scene",
        decision: "Decision | None",
        looks: "LiveLooks",
        clock_s: float,
        agrees: bool | None = None,
    ) -> "LiveScene":
        """A scene after its last decision; none is of a scene without light."""
        known, replay, classes = (scene.name, scene.label), (clock_s, agrees), looks.classes
        [trained] = was_trained_on(looks.training_scenes, [scene.hash])
        if decision is None:
            return cls(*known, None, None, 0, None, 0.0, *replay, trained_on=trained)
        best = decision.chances.argmax()
        spoilt = any(fault.kind in SPOILING for fault in decision.faults)
        return cls(
            *known,
            None if spoilt else classes[best],
            None if spoilt else float(decision.chances[best]),
            decision.look + 1,
            decision.photons,
            decision.light_s,
            *replay,
            faults=decision.faults,
            trained_on=trained,
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        known = _in_json(self) | {"faults": [str(fault) for fault in self.faults]}
        if self.agrees is None:
            del known["agrees"]
        return known


@dataclass(frozen=True)
class ReplayedRun:
    """Classes of the scenes of a live run, decided again from its counts."""

    exposure_s: float  # of all looks
    scenes: tuple[LiveScene, ...]
    view: "ViewResult | None" = None  # of the camera; none where it was not tested

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {
            "live": True,
            "score": score_of(self.scenes).as_dict(),
            "view": None if self.view is None else self.view.as_dict(),
            "scenes": [scene.as_dict() for scene in self.scenes],
        }


def score_of(scenes: Iterable[LiveScene]) -> Score:
    """Right answers to the labelled scenes of a live run, of those that have a class."""
    return Score.of(
        (each.trained_on, each.predicted == each.label, 1)
        for each in scenes
        if each.predicted is not None and each.label is not None
    )

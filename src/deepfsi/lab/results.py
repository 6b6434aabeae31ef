"""Classes of scenes as a counted run or a table gives them."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from deepfsi.designfile import Score
from deepfsi.hardware.light import Fault

if TYPE_CHECKING:
    from deepfsi.designfile import ConsistencyResult, ViewResult


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
        names = {"name": "scene", "predicted": "class"}
        content = {names.get(name, name): value for name, value in vars(self).items()}
        return content | {"faults": [str(fault) for fault in self.faults]}


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

"""Looks of a live run: the frames that one asks for, and what is to be known of a design."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from deepfsi.camera import StopRule
from deepfsi.designfile import SceneModel, TrainingScenes
from deepfsi.hardware.counting import FrameCounts
from deepfsi.hardware.light import Arrivals


@dataclass(frozen=True)
class FrameList:
    """Frames that are shown one after another, and counted."""

    look: int  # from 0; `SENTINELS` for the frames that begin and end a scene
    frames: np.ndarray  # (F,): Places among the frames of the manifest
    gate_ns: np.ndarray  # (F,): For how long each is counted
    # (F, N): Pixels that are ON, bool, of frames made now, which are loaded in place of those of
    # the folder; none where these are shown
    masks: np.ndarray | None = None


Count = Callable[[FrameList], FrameCounts]
"""Counts of a list of frames."""


class Conditions(NamedTuple):
    """Conditions of an exposure; rates are counts/s that are no scene's."""

    photons: float  # budget
    exposure_ns: int  # of all looks
    shortest_ns: int  # gate
    dark: np.ndarray  # (inputs,): Dark counts
    # (2, f, inputs): What the masks' frames count beyond them with the scenes dark, and its
    # variance
    ambient: np.ndarray


class AllOn(NamedTuple):
    """Counts of the all-ON frames of a scene, all together."""

    counts: float  # less what is no scene's
    noise: float  # beyond the counts' own
    seconds: float


class Likeness(NamedTuple):
    """Comparison of a scene's counts with those of the training."""

    chance: float  # p-value
    unsure: bool  # true if it is below that of a sound scene's false alarm
    detail: str  # on what differs


class LiveExposure(Protocol):
    """One exposure of a scene, look after look."""

    def ask(self, look: int) -> FrameList:
        """Frames of the next look."""

    def take(self, asked: FrameList, found: Arrivals) -> np.ndarray:
        """Probabilities (C,) of the classes, from the photons of a look and those before."""

    def compare(self, on: AllOn) -> Likeness | None:
        """Comparison of all counts with the training; none where nothing of it is known."""


class LiveLooks(Protocol):
    """Looks of a design, as a live run needs them."""

    shares: tuple[float, ...]  # of the exposure that each look takes
    classes: tuple[str, ...]
    photons: float | None  # budget of the training
    rule: StopRule | None  # of the design, where it has one
    shortest: float  # dwell that it was made for, a share of the exposure
    decision_s: float  # usual time of a decision on one core, seconds
    training_scenes: TrainingScenes | None  # hashes of the scenes that the design was made with
    scene_model: SceneModel | None  # of the training; none where runs are not tested against it

    def expose(self, scene: int, conditions: Conditions) -> LiveExposure:
        """Begin an exposure of a scene."""

    def lit(self, asked: FrameList) -> np.ndarray:
        """Share of each pixel's mirrors that are ON in frames of a look, (F, N)."""

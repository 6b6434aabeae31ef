"""Looks of a live run: which frames come next, and the classes that their counts tell.

A design chooses the mask of each look. A run hands counts to whatever keeps to `LookChooser`.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from deepfsi.camera.dead_time import StopRule
from deepfsi.designfile.provenance import TrainingScenes
from deepfsi.designfile.view_test import SceneModel
from deepfsi.hardware.counting.streaming import FrameCounts
from deepfsi.hardware.light.curves import Arrivals


@dataclass(frozen=True)
class FrameList:
    """Frames that are shown one after another, and counted."""

    look: int  # from 0
    frames: np.ndarray  # places among the frames of the manifest
    gate_ns: np.ndarray  # for how long each is counted
    masks: np.ndarray | None = None


class FrameSource(Protocol):
    """Source of counts of frames: devices that show and count them, or the record of a run."""

    def count(self, asked: FrameList) -> FrameCounts:
        """Counts of the frames of a list."""


class SceneSignal(NamedTuple):
    """Counts of frames that are a scene's, and the variance beyond that of Poisson counts."""

    counts: np.ndarray  # (F, inputs)
    noise: np.ndarray  # (F, inputs)


@dataclass(frozen=True)
class ExposureState:
    """Conditions of one exposure, as far as they are measured when it begins."""

    photons: float  # budget of all looks together, counts
    exposure_ns: int  # time of all looks together
    dark: np.ndarray  # dark counts, counts/s

    def signal(self, asked: FrameList, arrivals: Arrivals) -> SceneSignal:
        """Counts of a look less those that are no scene's."""
        counts = arrivals.photons.sum(axis=1)
        variance = arrivals.variance.sum(axis=1)
        seconds = (asked.gate_ns * 1e-9)[:, None]
        dark = self.dark * seconds
        noise = dark.clip(min=0) + (variance - counts).clip(min=0)
        return SceneSignal(counts - dark, noise)


@dataclass(frozen=True)
class AllOnCounts:
    """Counts of the all-ON frames of a scene, all together."""

    counts: float  # less what is no scene's
    noise: float  # variance beyond the counts' own
    seconds: float  # time of the frames


@dataclass(frozen=True)
class SceneComparison:
    """Comparison of a scene's counts with those of the training."""

    chance: float
    unsure: bool  # True if it is below that of a sound scene's false alarm
    detail: str


class LiveExposure(Protocol):
    """One exposure of a scene, look after look."""

    def ask(self, look: int) -> FrameList:
        """Frames of the next look."""

    def take(self, asked: FrameList, arrivals: Arrivals) -> np.ndarray:
        """Probabilities (C,) of the classes, from the photons of a look and those before."""

    def compare(self, on: AllOnCounts) -> SceneComparison | None:
        """Comparison of all counts with the training; none where nothing of it is known."""


class LookChooser(Protocol):
    """Looks of a design, as a live run needs them."""

    shares: tuple[float, ...]  # of the exposure that each look takes
    classes: tuple[str, ...]
    photons: float | None  # budget of the training
    rule: StopRule | None  # of the design, where it has one
    decision_s: float  # usual time of a decision on one core, seconds
    training_scenes: TrainingScenes | None  # hashes of the scenes that the design was made with
    scene_model: SceneModel | None  # of the training; none where runs are not tested against it

    def expose(self, scene: int, state: ExposureState) -> LiveExposure:
        """Begin an exposure of a scene."""

    def lit(self, asked: FrameList) -> np.ndarray:
        """Share of each pixel's mirrors that are ON in frames of a look, (F, N)."""

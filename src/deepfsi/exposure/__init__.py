"""What is shown when, and what it tells: a kind of exposure each."""

from deepfsi.exposure.adaptive import AdaptiveExposure, AdaptiveTraining, prior_of
from deepfsi.exposure.fixed import FixedExposure
from deepfsi.exposure.kind import Clicks, TrainedMasks
from deepfsi.exposure.kinds import KINDS, build
from deepfsi.exposure.posterior import ScenePrior
from deepfsi.exposure.training import CHUNK, ExposureTraining, JobGroup, matrix_seeds
from deepfsi.exposure.training_set import (
    Matrices,
    TrainingSet,
    dtypes,
    network_dtype,
)

__all__ = [
    "CHUNK",
    "KINDS",
    "AdaptiveExposure",
    "AdaptiveTraining",
    "Clicks",
    "ExposureTraining",
    "FixedExposure",
    "JobGroup",
    "Matrices",
    "ScenePrior",
    "TrainedMasks",
    "TrainingSet",
    "build",
    "dtypes",
    "matrix_seeds",
    "network_dtype",
    "prior_of",
]

"""What is shown when, and what it tells: a kind of exposure each."""

from deepfsi.exposure.adaptive import AdaptiveTraining, prior_of
from deepfsi.exposure.kinds import build
from deepfsi.exposure.prior import ScenePrior
from deepfsi.exposure.training import CHUNK, ExposureTraining, JobGroup, matrix_seeds
from deepfsi.exposure.training_set import (
    Matrices,
    TrainingSet,
    dtypes,
    network_dtype,
)

__all__ = [
    "CHUNK",
    "AdaptiveTraining",
    "ExposureTraining",
    "JobGroup",
    "Matrices",
    "ScenePrior",
    "TrainingSet",
    "build",
    "dtypes",
    "matrix_seeds",
    "network_dtype",
    "prior_of",
]

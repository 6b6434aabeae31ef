"""What is shown when, and what it tells: a kind of exposure each."""

from deepfsi.exposure.fixed import FixedExposure
from deepfsi.exposure.kind import (
    EXPOSED_AT_ONCE,
    Answer,
    CappedRule,
    Clicks,
    CountedLight,
    ExposureKind,
    MaskExposure,
    Observation,
    ReadsCounts,
    Stops,
    TrainedMasks,
    Use,
)
from deepfsi.exposure.kinds import MASK_KINDS, build_training
from deepfsi.exposure.looks import LooksExposure
from deepfsi.exposure.passing import PassingExposure
from deepfsi.exposure.training import CHUNK, ExposureTraining, JobGroup, matrix_seeds
from deepfsi.exposure.training_set import Matrices, TrainingSet, dtypes, network_dtype

__all__ = [
    "CHUNK",
    "EXPOSED_AT_ONCE",
    "MASK_KINDS",
    "Answer",
    "CappedRule",
    "Clicks",
    "CountedLight",
    "ExposureKind",
    "ExposureTraining",
    "FixedExposure",
    "JobGroup",
    "LooksExposure",
    "MaskExposure",
    "Matrices",
    "Observation",
    "PassingExposure",
    "ReadsCounts",
    "Stops",
    "TrainedMasks",
    "TrainingSet",
    "Use",
    "build_training",
    "dtypes",
    "matrix_seeds",
    "network_dtype",
]

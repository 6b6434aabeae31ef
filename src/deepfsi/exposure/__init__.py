"""What is shown when, and what it tells: a kind of exposure each."""

from deepfsi.exposure.adaptive import (
    MISFIT_BUDGETS,
    MISFIT_SCENES,
    AdaptiveExposure,
    AdaptiveTraining,
    LookedAt,
    prior_of,
    squared_distance,
)
from deepfsi.exposure.choice import candidate_masks, look_at, next_masks
from deepfsi.exposure.clicking import ClickTraining
from deepfsi.exposure.fixed import FixedExposure
from deepfsi.exposure.kind import (
    EXPOSED_AT_ONCE,
    Answer,
    Clicks,
    CountedLight,
    ExposureKind,
    MaskExposure,
    Observation,
    Stops,
    TrainedMasks,
)
from deepfsi.exposure.kinds import MASK_KINDS, adaptive_kind, build_training
from deepfsi.exposure.looks import LooksExposure
from deepfsi.exposure.passing import PassingExposure
from deepfsi.exposure.posterior import AdaptivePosterior, ScenePrior, class_chances
from deepfsi.exposure.training import CHUNK, ExposureTraining, JobGroup, matrix_seeds
from deepfsi.exposure.training_set import Matrices, TrainingSet, dtypes, network_dtype

__all__ = [
    "CHUNK",
    "EXPOSED_AT_ONCE",
    "MASK_KINDS",
    "MISFIT_BUDGETS",
    "MISFIT_SCENES",
    "AdaptiveExposure",
    "AdaptivePosterior",
    "AdaptiveTraining",
    "Answer",
    "ClickTraining",
    "Clicks",
    "CountedLight",
    "ExposureKind",
    "ExposureTraining",
    "FixedExposure",
    "JobGroup",
    "LookedAt",
    "LooksExposure",
    "MaskExposure",
    "Matrices",
    "Observation",
    "PassingExposure",
    "ScenePrior",
    "Stops",
    "TrainedMasks",
    "TrainingSet",
    "adaptive_kind",
    "build_training",
    "candidate_masks",
    "class_chances",
    "dtypes",
    "look_at",
    "matrix_seeds",
    "network_dtype",
    "next_masks",
    "prior_of",
    "squared_distance",
]

"""Masks that are made while the camera looks, of the counts so far: prior, choice and exposure."""

from deepfsi.adaptive.choice import candidate_masks, look_at, next_masks
from deepfsi.adaptive.clicking import ClickTraining, adaptive_kind
from deepfsi.adaptive.dictionary import DictionaryPosterior, MaskDictionary
from deepfsi.adaptive.exposure import (
    AdaptiveExposure,
    AdaptiveTraining,
    LeftOutAnswers,
    LookedAt,
    prior_of,
    squared_distance,
)
from deepfsi.adaptive.posterior import AdaptivePosterior, LookOptics, ScenePrior, class_chances

__all__ = [
    "AdaptiveExposure",
    "AdaptivePosterior",
    "AdaptiveTraining",
    "ClickTraining",
    "DictionaryPosterior",
    "LeftOutAnswers",
    "LookOptics",
    "LookedAt",
    "MaskDictionary",
    "ScenePrior",
    "adaptive_kind",
    "candidate_masks",
    "class_chances",
    "look_at",
    "next_masks",
    "prior_of",
    "squared_distance",
]

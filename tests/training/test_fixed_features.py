"""Features of fixed masks in a step of training: those of the formula, in few passes."""

from collections import Counter

import pytest
import torch
from torch.profiler import ProfilerActivity, profile

from deepfsi.datasets import Dataset
from deepfsi.exposure.draws import SeedStream
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.physics import Detection, FixedMasks, TrainingNoise, light_law
from deepfsi.training.features import FixedFeatures
from shared.noises import training_noise

BATCH, MASKS = 50, 8
PASSES = {"aten::add", "aten::add_", "aten::sub", "aten::mul", "aten::div", "aten::addcmul"}
"""Operations that pass over all features of a step."""


def made(
    digits: Dataset, kind: str, budgets: list[float], replicas: int
) -> tuple[FixedFeatures, FixedMasks, TrainingNoise]:
    """Features of so many masks, side by side where there are several budgets."""
    training_set = TrainingSet(digits, "cpu")
    noise = training_noise(kind, budgets, [2.0] * len(budgets), [0] * len(budgets), "cpu")
    drawn = torch.randn(replicas, MASKS, 64, generator=torch.Generator().manual_seed(1))
    masks = FixedMasks(torch.stack([light_law("column").fit(each, "dual") for each in drawn]))
    stream = SeedStream(0, slice(0, len(budgets)), noise, training_set.labels, BATCH)
    stream.shuffle()
    features = FixedFeatures([stream], masks, training_set.full, noise, "each", Detection())
    return features, masks, noise


@pytest.mark.parametrize(("budgets", "replicas"), [([9.0], 1), ([1.0, 80.0], 2)])
def test_a_step_passes_over_its_features_twice(digits, budgets, replicas):
    """Noise times its deviation, and the sum: features are standardised before the first step."""
    features, *_ = made(digits, "ml_gauss", budgets, replicas)
    with profile(activities=[ProfilerActivity.CPU]) as seen:
        features.at(0)
    counted = Counter(event.name for event in seen.events())
    assert sum(counted[name] for name in PASSES) == 2

"""Features of fixed masks in a step of training: those of the formula, in few passes."""

from collections import Counter

import pytest
import torch
from torch import Tensor
from torch.profiler import ProfilerActivity, profile

from deepfsi.datasets import Dataset
from deepfsi.optics.constraints import fit
from deepfsi.optics.detection import Detection
from deepfsi.optics.features import FeatureNoise, feature_statistics
from deepfsi.optics.masks import FixedMasks
from deepfsi.optics.noise import root
from deepfsi.training.draws import SeedStream
from deepfsi.training.features import FixedFeatures
from deepfsi.training.training_set import TrainingSet

BATCH, MASKS = 50, 8
PASSES = {"aten::add", "aten::add_", "aten::sub", "aten::mul", "aten::div", "aten::addcmul"}
"""Operations that pass over all features of a step."""


def made(
    digits: Dataset, kind: str, budgets: list[float], replicas: int
) -> tuple[FixedFeatures, FixedMasks, FeatureNoise]:
    """Features of so many masks, side by side where there are several budgets."""
    training_set = TrainingSet(digits, "cpu")
    noise = FeatureNoise.of(kind, budgets, [2.0] * len(budgets), [0] * len(budgets), "cpu")
    drawn = torch.randn(replicas, MASKS, 64, generator=torch.Generator().manual_seed(1))
    masks = FixedMasks(torch.stack([fit(each, "column", "dual") for each in drawn]))
    stream = SeedStream(0, slice(0, len(budgets)), noise, training_set.labels, BATCH)
    stream.shuffle()
    features = FixedFeatures([stream], masks, training_set.full, noise, "each", Detection())
    return features, masks, noise


def by_formula(
    digits: Dataset, features: FixedFeatures, masks: FixedMasks, noise: FeatureNoise
) -> Tensor:
    """(x D − mean + deviation · ε) / std of the first step, with the draws of the same seed."""
    x = torch.from_numpy(digits.x_train)
    rails = masks()
    mean, std, _ = feature_statistics(x, masks, noise, "each", Detection())
    again = SeedStream(0, slice(0, len(std)), noise, torch.from_numpy(digits.y_train), BATCH)
    again.shuffle()
    rows = x[again.rows[0]]
    expected = torch.einsum("bn,rmn->brm", rows, rails.difference)
    light = root(torch.einsum("bn,rmn->brm", rows, rails.total)) * noise.unit
    if noise.kind == "gaussian":
        light = noise.variance(mean, features.read).sqrt().expand_as(light)
    return (expected - mean + light * again.normal(MASKS)) / std


@pytest.mark.parametrize("kind", ["ml_gauss", "gaussian"])
@pytest.mark.parametrize(("budgets", "replicas"), [([9.0], 1), ([1.0, 80.0], 1), ([1.0, 80.0], 2)])
def test_features_are_those_of_the_formula(digits, kind, budgets, replicas):
    """Rounding in float32 of products of 64 pixels, in units of the features' deviation."""
    features, masks, noise = made(digits, kind, budgets, replicas)
    found = features.at(0)
    assert torch.allclose(found, by_formula(digits, features, masks, noise), rtol=0, atol=2e-5)


@pytest.mark.parametrize(("budgets", "replicas"), [([9.0], 1), ([1.0, 80.0], 2)])
def test_a_step_passes_over_its_features_three_times(digits, budgets, replicas):
    """Features over their deviation, noise times its own, and the sum."""
    features, *_ = made(digits, "ml_gauss", budgets, replicas)
    with profile(activities=[ProfilerActivity.CPU]) as seen:
        features.at(0)
    counted = Counter(event.name for event in seen.events())
    assert sum(counted[name] for name in PASSES) == 3

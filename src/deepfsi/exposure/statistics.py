"""Statistics of features in units of the scene: what they are divided by, and their means."""

from collections.abc import Iterable

import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.jobs import Scale
from deepfsi.physics import (
    Detection,
    FixedMasks,
    LearnedMasks,
    TrainingNoise,
    project,
    project_rails,
)

CHUNK = 4096
"""Scenes that are multiplied at once outside the steps."""

LEAST_POWER = 1e-20
"""Mean square of features, in units of the scene, below which they do not vary."""


def standardise(features: Tensor, scale: Scale, shown: Tensor | None = None) -> Tensor:
    """Divide centred features by the standard deviation of their batch."""
    # features (B, R, m)
    if shown is not None:
        over = (0,) if scale == "each" else (0, 2)
        power = (features.square() * shown).sum(dim=over, keepdim=True)
        power = power / shown.sum(dim=over, keepdim=True).clamp(min=1)
        return features / power.clamp(min=LEAST_POWER).sqrt()
    if scale == "each":
        columns = functional.batch_norm(
            features.flatten(1), None, None, training=True, eps=LEAST_POWER
        )
        return columns.view_as(features)
    size = torch.linalg.vector_norm(features, dim=(0, 2)) / (features[:, 0].numel() ** 0.5)
    return features / size.clamp(min=LEAST_POWER**0.5)[:, None]


def deviation(power: Tensor, scale: Scale, weights: Tensor | None = None) -> Tensor:
    """Standard deviation (..., m) of features of known variance; 1 where that is 0."""
    # power (..., m); weights (m,)
    if scale == "common":
        weights = torch.ones_like(power) if weights is None else weights
        common = (power * weights).sum(dim=-1, keepdim=True) / weights.sum(dim=-1, keepdim=True)
        power = common.expand_as(power)
    return torch.where(power > 0, power, 1.0).sqrt()


def moments(parts: Iterable[Tensor]) -> tuple[Tensor, Tensor]:
    """Mean and variance (R, k) of features (n_i, R, k) in parts, summed in float64."""
    count, sums = 0, []
    for part in parts:
        wide = part.double()
        count += len(part)
        sums.append(torch.stack([wide.sum(dim=0), wide.square().sum(dim=0)]))
    mean, square = torch.stack(sums).sum(dim=0) / count
    return mean.to(part), (square - mean.square()).clamp(min=0).to(part)


def feature_statistics(
    scenes: Tensor,
    masks: FixedMasks | LearnedMasks,
    noise: TrainingNoise,
    scale: Scale,
    detection: Detection,
    exposures: tuple[Tensor, Tensor] | None = None,
    means: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Mean and standard deviation of features over scenes and noise, and mean x S."""
    # scenes (n, N); means (n, R or 1, k)
    arranged = masks().map(detection.arrange)
    read, frames = detection.readouts(arranged), detection.read_of(arranged)
    middle = detection.arrange(scenes.mean(dim=0))
    mean, counts = (
        project(middle, sums, detection.count) for sums in (frames.difference, frames.total)
    )
    if not noise.kind.unbiased:  # what it draws is taken
        light = (
            project_rails(detection.arrange(x), frames, detection.count)
            for x in scenes.split(CHUNK)
        )
        first, power = moments(noise.counted(*pair, read) for pair in light)
        std = deviation(power, scale)
        return first, std, counts.expand_as(std)
    power = torch.zeros_like(mean)
    for index, x in enumerate(scenes.split(CHUNK)):
        rows = slice(index * CHUNK, index * CHUNK + len(x))
        expected = (
            project(detection.arrange(x), frames.difference, detection.count)
            if means is None
            else means[rows]
        )
        power += (expected - mean).square().sum(dim=0)
    factor, often = exposures or (1.0, None)
    std = deviation(power / len(scenes) + noise.variance(mean, counts, read) * factor, scale, often)
    return mean.expand_as(std), std, counts.expand_as(std)

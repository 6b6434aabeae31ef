"""Training on scenes that pass a static pattern: what it starts from, its features, their scale."""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from deepfsi.exposure.draws import SeedStream, side_by_side
from deepfsi.exposure.statistics import CHUNK, deviation, moments, standardise
from deepfsi.jobs import Scale
from deepfsi.physics import (
    FixedPattern,
    LearnedPattern,
    ScenePath,
    TrainingNoise,
    in_levels,
    project,
)

Pattern = FixedPattern | LearnedPattern
"""A pattern of a training."""


def initial_pattern(
    transit: ScenePath, seeds: Sequence[int], learned: bool, levels: int, device: torch.device
) -> Pattern:
    """Pattern before training, drawn from each seed: ON and OFF, or logits that learn."""
    size = transit.shape[0], transit.width
    draws = [torch.Generator().manual_seed(seed) for seed in seeds]
    if learned:
        start = torch.stack([torch.randn(size, generator=each) for each in draws])
        return LearnedPattern(start, transit, levels).to(device)
    pattern = torch.stack([torch.rand(size, generator=each) for each in draws])
    return FixedPattern(in_levels(pattern, 2), transit).to(device)


class PassingFeatures:
    """Inputs of the classifiers: bins of scenes (n, N), each at a place drawn in each step."""

    def __init__(self, streams: list[SeedStream], masks: Pattern, x: Tensor, scale: Scale) -> None:
        self.streams, self.masks, self.x, self.scale = streams, masks, x, scale
        self.transit = masks.transit
        self.read = self.transit.readouts(x.device)
        # of a pattern that does not learn these are taken once
        self.products = None
        if isinstance(masks, FixedPattern):
            shifts = self.transit.every_shift(masks.pattern)
            self.products = torch.cat([project(part, shifts) for part in x.split(CHUNK)])

    def at(self, step: int) -> Tensor:
        """Features (B, R, T), standardised in their batch."""
        shifts = None
        if self.products is None:
            shifts = self.transit.every_shift(self.masks.pattern)
        drawn = side_by_side([self._of(stream, step, shifts) for stream in self.streams])
        return standardise(drawn - drawn.mean(dim=0), self.scale)

    def _of(self, stream: SeedStream, step: int, shifts: Tensor | None) -> Tensor:
        """Features (B, R_i, T) of the jobs of one seed."""
        if self.products is not None:
            every = stream.products(self.products, step)
        else:
            assert shifts is not None
            every = project(self.x.index_select(0, stream.rows[step]), stream.of_jobs(shifts, -3))
        edges = self.transit.edges((len(every), 1), stream.generator, every.device)
        expected = self.transit.means(every, edges) / self.transit.bins
        if expected.shape[1] == 1:
            expected = stream.repeated(expected)
        return stream.noise.features(expected, expected, self.read, stream.normal)


def passing_statistics(
    scenes: Tensor, masks: Pattern, noise: TrainingNoise, scale: Scale, seed: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Mean and standard deviation (R, T) of features over scenes (n, N), places and noise.

    And their mean in light, as `features.feature_statistics` gives them.
    """
    transit, shifts = masks.transit, masks.transit.every_shift(masks.pattern)
    read, generator = transit.readouts(scenes.device), torch.Generator(scenes.device)
    generator.manual_seed(seed)
    light = []

    def drawn() -> Iterator[Tensor]:
        for x in scenes.split(CHUNK):
            edges = transit.edges((len(x), 1), generator, x.device)
            expected = transit.means(project(x, shifts), edges) / transit.bins
            light.append(expected.sum(dim=0))
            yield expected if noise.kind.unbiased else noise.counted(expected, expected, read)

    mean, power = moments(drawn())
    counts = torch.stack(light).sum(dim=0) / len(scenes)
    if noise.kind.unbiased:
        power = power + noise.variance(counts, counts, read)
    std = deviation(power, scale)
    return mean.expand_as(std), std, counts.expand_as(std)

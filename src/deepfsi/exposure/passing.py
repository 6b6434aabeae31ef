"""Exposures of scenes that pass a static pattern: the bins of a transit are the readouts."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import torch
from torch import Tensor

from deepfsi.base import InputError
from deepfsi.camera import LightLawName
from deepfsi.exposure.trained import Observation, TrainedExposure
from deepfsi.exposure.training import (
    CHUNK,
    ExposureTraining,
    FeatureStatistics,
    JobGroup,
    TrainedMasks,
    deviation,
    matrix_seeds,
    moments,
    standardise,
)
from deepfsi.jobs import STATIC, ExposureEntry, Passing, PassingEntry
from deepfsi.physics import (
    Draws,
    FixedPattern,
    LearnedPattern,
    Rails,
    Scanner,
    ScenePath,
    SeedStream,
    in_levels,
    project,
)

MEAN_OF = 1024
"""Transits whose mean is taken for expected counts of all."""


@dataclass(frozen=True)
class PassingExposure(TrainedExposure):
    """Exposure of a scene that passes a pattern, in each exposure at another place.

    The masks' rails are those of the transit without jitter.
    """

    transit: ScenePath
    pattern: Tensor | None = None  # (H, P), from the end of the training on
    kind = "passing"
    comparable: ClassVar[bool] = False

    def entry(self) -> PassingEntry:
        """Entry of the design file's header."""
        path = self.transit
        return PassingEntry(
            shape=path.shape,
            bins=path.bins,
            speed=path.speed,
            jitter=path.jitter,
            speed_jitter=path.speed_jitter,
        )

    @classmethod
    def restored(
        cls,
        entry: ExposureEntry,
        weights: dict[str, Tensor],
        features: int,
        rails: Rails,
        light: LightLawName,
    ) -> "PassingExposure":
        """The exposure with its pattern; parameters as for `TrainedExposure.restored`."""
        assert isinstance(entry, PassingEntry)
        pattern = weights["pattern"]
        height, width = pattern.shape
        if height != entry.shape[0] or rails.masks != entry.bins or rails.count != 1:
            raise ValueError("the pattern is not of these scenes")
        if float(pattern.min()) < 0 or float(pattern.max()) > 1:
            raise ValueError("the pattern is not between dark and open")
        path = ScenePath(
            shape=entry.shape,
            width=width,
            bins=entry.bins,
            speed=entry.speed,
            jitter=entry.jitter,
            speed_jitter=entry.speed_jitter,
        )
        return cls(path, pattern)

    @property
    def weights(self) -> dict[str, Tensor]:
        """The pattern, for the design file."""
        return {"pattern": self.passed}

    @property
    def passed(self) -> Tensor:
        """The pattern (H, P) that scenes pass."""
        assert self.pattern is not None
        return self.pattern

    def to(self, device: str | torch.device) -> "PassingExposure":
        """The kind on a device."""
        return replace(self, pattern=self.passed.to(device))

    def check(self, rails: Rails, light: LightLawName, image_shape: tuple[int, ...]) -> None:
        """Raise `ValueError` unless rails are those of the pattern; parameters as for `Design`."""
        wanted = self.transit.matrix(self.passed).unsqueeze(0)
        if image_shape != self.transit.shape or not torch.allclose(rails.stacked, wanted, 1e-4):
            raise ValueError("masks are not of the pattern")

    def quantised(
        self, rails: Tensor, light: LightLawName, levels: int
    ) -> tuple[Tensor, "PassingExposure"]:
        """Rails and exposure of the pattern in grey levels."""
        shown = in_levels(self.passed, levels)
        return self.transit.matrix(shown).unsqueeze(0), replace(self, pattern=shown)

    def front(self, rails: Tensor) -> Tensor:
        """Rails of a scanner that reads every bin for the same time."""
        return self.transit.open(rails.device)

    def rates(self, scanner: Scanner, scenes: Tensor) -> Tensor:
        """Expected counts (..., 1, K) at every whole shift, of scenes (..., N)."""
        return project(scenes, self.transit.every_shift(self.passed)).unsqueeze(-2) / (
            self.transit.bins
        )

    def placed(self, rates: Tensor, generator: torch.Generator | None) -> Tensor:
        """Expected counts (..., 1, T) of exposures, each at a place of its own."""
        edges = self.transit.edges(rates.shape[:-1], generator, rates.device)
        return self.transit.means(rates, edges)

    def shown(self, rates: Tensor, seen: Observation) -> Tensor:
        """Expected counts (..., 1, T), in the mean over places."""
        return rates @ self._mean_bins.to(rates)

    @cached_property
    def _mean_bins(self) -> Tensor:
        """Share (K, T) that each shift has in each bin, in the mean over places."""
        device, generator = self.passed.device, torch.Generator(self.passed.device)
        every = torch.eye(self.transit.shifts, device=device).unsqueeze(1)
        count = MEAN_OF if self.transit.moves else 1
        edges = self.transit.edges((count,), generator.manual_seed(0), device)
        return self.transit.means(every, edges).mean(dim=1)

    def mask_dwells(self, rails: Rails, light: LightLawName, mean: Tensor, std: Tensor) -> None:
        """None: bins have one length."""
        return

    def drawing(
        self, matrix: Tensor, mask_shape: tuple[int, ...]
    ) -> tuple[Tensor, tuple[int, ...]]:
        """The pattern as one row, and its shape."""
        return self.passed.flatten().unsqueeze(0), tuple(self.passed.shape)

    def check_device(self) -> None:
        """Raise `InputError`: no sequence of frames shows a pattern that scenes pass."""
        raise InputError(STATIC)

    def check_alone(self) -> None:
        """Raise `InputError`: a scene's place is not known, and moves its counts."""
        raise InputError(
            "counts of passing scenes are not compared with the training, as each passes at a "
            "place of its own: use Design.classify"
        )


class PassingTraining(ExposureTraining):
    """A pattern of each seed, and bins of scenes that pass it, at other places in each step."""

    masks: FixedPattern | LearnedPattern

    def __init__(self, group: JobGroup) -> None:
        super().__init__(group)
        asked = self.job.exposure
        shape = self.scenes.data.image_shape
        assert isinstance(asked, Passing)
        height, width = shape
        self.transit = ScenePath(
            shape=(height, width),
            width=asked.columns(shape),
            bins=asked.bins,
            speed=asked.speed,
            jitter=asked.jitter,
            speed_jitter=asked.speed_jitter,
        )
        seeds = [job.seed for job in self.jobs] if self.learns else matrix_seeds(self.jobs)
        draws = [torch.Generator().manual_seed(seed) for seed in seeds]
        size = height, self.transit.width
        if self.learns:  # logits
            start = torch.stack([torch.randn(size, generator=each) for each in draws])
            self.masks = LearnedPattern(start, self.transit, self.levels).to(self.scenes.device)
        else:  # ON and OFF
            pattern = torch.stack([torch.rand(size, generator=each) for each in draws])
            self.masks = FixedPattern(in_levels(pattern, 2), self.transit).to(self.scenes.device)

    def prepare(self) -> None:
        """Take the products of all scenes with a pattern that does not learn."""
        scenes = self.scenes.full
        self.read = self.transit.readouts(scenes.device)
        if not self.learns:
            shifts = self.transit.every_shift(self.masks.pattern)
            self.products = torch.cat([project(x, shifts) for x in scenes.split(CHUNK)])

    def inputs(self, draws: Draws) -> Tensor:
        """Features (B, R, T), standardised in their batch."""
        shifts = self.transit.every_shift(self.masks.pattern) if self.learns else None

        def features(stream: SeedStream) -> Tensor:
            if shifts is None:
                every = stream.products(self.products)
            else:
                x = self.scenes.full.index_select(0, stream.rows)
                every = project(x, stream.of_jobs(shifts, -3))
            edges = self.transit.edges((len(every), 1), stream.generator, every.device)
            expected = self.transit.means(every, edges) / self.transit.bins
            if expected.shape[1] == 1:
                expected = stream.repeated(expected)
            return stream.noise.features(expected, expected, self.read, stream.normal)

        drawn = draws.side_by_side(features)
        return standardise(drawn - drawn.mean(dim=0), self.scale)

    def fix(self) -> None:
        """Take the pattern as it is at the end of the training."""
        with torch.no_grad():
            self.masks = FixedPattern(self.masks.pattern, self.transit)
        patterns = self.masks.pattern
        self.exposures = [
            PassingExposure(self.transit, patterns[job % len(patterns)].clone())
            for job in range(len(self.jobs))
        ]

    def finish(self) -> list[TrainedMasks]:
        """Pattern of each job, with the statistics of its bins over scenes, places and noise."""
        transit = self.transit
        noise = self.noise
        scenes = self.scenes.full
        shifts = transit.every_shift(self.masks.pattern)
        read = transit.readouts(scenes.device)
        generator = torch.Generator(scenes.device).manual_seed(self.job.seed)
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
        std = deviation(power, self.scale)
        light_of_jobs = counts.expand_as(std)
        return self.trained(FeatureStatistics(mean.expand_as(std), std, light_of_jobs))

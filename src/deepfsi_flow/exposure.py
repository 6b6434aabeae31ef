"""Exposures of scenes that pass a static pattern: the bins of a transit are the readouts."""

from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import torch
from torch import Tensor

from deepfsi.exposure.kind import UNTRAINED, MaskExposure, Observation, TrainedMasks, Use
from deepfsi.exposure.training import (
    CHUNK,
    ExposureTraining,
    FeatureStatistics,
    JobGroup,
    deviation,
    matrix_seeds,
    moments,
    standardise,
)
from deepfsi.jobs.exposures import ExposureEntry
from deepfsi.physics.detection import Rails
from deepfsi.physics.noise import NoiseFunction
from deepfsi.physics.scanner import Scanner, project
from deepfsi.physics.training_noise import Draws, SeedStream
from deepfsi_flow.settings import STATIC, Passing, PassingEntry
from deepfsi_flow.transit import FixedPattern, LearnedPattern, ScenePath, in_levels

MEAN_OF = 1024
"""Transits whose mean is taken for expected counts of all."""


@dataclass(frozen=True, eq=False)
class PassingExposure(MaskExposure):
    """Exposure of a scene that passes a pattern, in each exposure at another place.

    The masks' rails are those of the transit without jitter.
    """

    transit: ScenePath
    pattern: Tensor | None = None  # (H, P), from the end of the training on
    _: KW_ONLY
    optics: TrainedMasks = UNTRAINED
    kind = "passing"
    comparable: ClassVar[bool] = False
    refusals: ClassVar[dict[Use, str]] = {
        "frames": STATIC,
        "comparison": "counts of passing scenes are not compared with the training, as each passes "
        "at a place of its own: use Design.classify",
        "page": "this design is of scenes that pass a static pattern, and a page shows masks one "
        "after the other: give a design of scenes at rest",
        "ideal observer": "scenes that pass a pattern have a place of their own in each exposure, "
        "which the ideal observer does not know: use evaluate",
    }

    def entry(self) -> Any:
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
        cls, entry: ExposureEntry | PassingEntry, weights: dict[str, Tensor], optics: TrainedMasks
    ) -> "PassingExposure":
        """The exposure with its pattern; parameters as for `MaskExposure.restored`."""
        assert isinstance(entry, PassingEntry)
        pattern = weights["pattern"]
        height, width = pattern.shape
        if height != entry.shape[0] or optics.rails.masks != entry.bins or optics.rails.count != 1:
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
        made = cls(path, pattern, optics=optics)
        made.check_masks()
        return made

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
        return replace(super().to(device), pattern=self.passed.to(device))

    def check_masks(self) -> None:
        """Raise `ValueError` unless the masks are those of the pattern."""
        wanted = self.transit.matrix(self.passed).unsqueeze(0)
        rails = self.optics.rails.stacked
        if self.image_shape != self.transit.shape or not torch.allclose(rails, wanted, 1e-4):
            raise ValueError("masks are not of the pattern")

    def quantised(self, levels: int) -> "PassingExposure":
        """The exposure of the pattern in grey levels."""
        shown = in_levels(self.passed, levels)
        rails = Rails.of(self.transit.matrix(shown).unsqueeze(0))
        return replace(self, optics=replace(self.optics, rails=rails), pattern=shown)

    def scanner(
        self, noise: str | NoiseFunction = "poisson", sigma: float = 1.0, dark: float = 0.0
    ) -> Scanner:
        """A front end that reads every bin for the same time; parameters as for `Scanner`."""
        rails = self.transit.open(self.device)
        return Scanner.from_rails(rails, noise, sigma=sigma, dark=dark, detection=self.detection)

    def rates(self, front: Scanner, scenes: Tensor) -> Tensor:
        """Expected counts (..., 1, K) at every whole shift, of reflectances (..., N)."""
        photons = scenes.to(self.device) / self.summed_reflectance
        return project(photons, self.transit.every_shift(self.passed)).unsqueeze(-2) / (
            self.transit.bins
        )

    def placed(self, rates: Tensor, generator: torch.Generator | None) -> Tensor:
        """Expected counts (..., 1, T) of exposures, each at a place of its own."""
        edges = self.transit.edges(rates.shape[:-1], generator, rates.device)
        return self.transit.means(rates, edges)

    def expected(self, rates: Tensor, seen: Observation) -> Tensor:
        """Photons (..., 1, T) of an exposure, in the mean over places."""
        return rates @ self._mean_bins.to(rates)

    @cached_property
    def _mean_bins(self) -> Tensor:
        """Share (K, T) that each shift has in each bin, in the mean over places."""
        device = self.passed.device
        generator = torch.Generator(self.passed.device)
        every = torch.eye(self.transit.shifts, device=device).unsqueeze(1)
        count = MEAN_OF if self.transit.moves else 1
        edges = self.transit.edges((count,), generator.manual_seed(0), device)
        return self.transit.means(every, edges).mean(dim=1)

    def mask_dwells(self) -> None:
        """None: bins have one length."""
        return

    def drawing(self) -> tuple[Tensor, tuple[int, ...]]:
        """The pattern as one row, and its shape."""
        return self.passed.flatten().unsqueeze(0), tuple(self.passed.shape)


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

    def finish(self) -> list[MaskExposure]:
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

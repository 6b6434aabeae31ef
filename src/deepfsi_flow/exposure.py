"""Exposures of scenes that pass a static pattern: the bins of a transit are the readouts.

A scene of H × W pixels moves along the rows of a pattern of H × P pixels, at v pixels a bin, for T
bins of one length. At the shift p column j of the scene lies on column j + p of the pattern, and

    C(p) = Σ_j P_{j + p} x_j

is linear between whole shifts, as pixels are squares: all whole shifts, one product with a matrix,
give it everywhere. A bin counts while the scene moves on, so that its rate is the mean of C over
the v pixels that the scene passes in it, and Φ / T of the light times that.

With jitter the middle of the path, and the speed, are others in each exposure.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from deepfsi.exposure.kind import MaskExposure, Use
from deepfsi.exposure.training import (
    CHUNK,
    ExposureTraining,
    JobGroup,
    deviation,
    matrix_seeds,
    moments,
    standardise_batch,
)
from deepfsi.physics.detection import Rails, Readouts
from deepfsi.physics.laws import FixedMasks, LearnedMasks, check_levels, straight_through
from deepfsi.physics.noise import NoiseFunction
from deepfsi.physics.scanner import Scanner, project
from deepfsi.physics.training_noise import Draws, SeedStream, side_by_side
from deepfsi_flow.settings import STATIC, Passing, PassingEntry


@dataclass(frozen=True)
class ScenePath:
    """Path of scenes along a pattern, and its jitter."""

    shape: tuple[int, int]  # H and W of a scene
    width: int  # P, columns of the pattern
    bins: int  # T
    speed: float  # v, pixels a bin
    jitter: float = 0.0
    speed_jitter: float = 0.0

    @property
    def shifts(self) -> int:
        """K, number of whole shifts, from one beside the pattern to the other."""
        return self.width + self.shape[1] + 1

    @property
    def moves(self) -> bool:
        """True if exposures differ in place or speed."""
        return self.jitter > 0 or self.speed_jitter > 0

    def every_shift(self, pattern: Tensor) -> Tensor:
        """Windows (..., K, N) of a pattern (..., H, P), one at every whole shift."""
        width = self.shape[1]
        windows = functional.pad(pattern, (width, width)).unfold(-1, width, 1)
        return windows.movedim(-2, -3).flatten(-2)

    def edges(
        self, shape: Sequence[int], generator: torch.Generator | None, device: torch.device
    ) -> Tensor:
        """Shifts (*shape, T + 1) at the ends of bins, drawn with the jitter."""
        time = torch.arange(self.bins + 1, device=device) - self.bins / 2
        middle = (self.shifts - 1) / 2
        if not self.moves:
            return (middle + self.speed * time).expand(*shape, -1)
        draws = torch.randn(2, *shape, 1, generator=generator, device=device)
        # Least speed of an exposure over the mean one, where a draw is less
        speed = self.speed * (1 + self.speed_jitter * draws[1]).clamp(min=0.01)
        return middle + self.jitter * draws[0] + speed * time

    def means(self, correlation: Tensor, edges: Tensor) -> Tensor:
        """Means (..., T) of C over each bin, from its values (..., K) at whole shifts."""
        # the integral of C: trapezoids up to the shift below, and a fraction of the next one
        *_, shifts = correlation.shape
        lead = torch.broadcast_shapes(correlation.shape[:-1], edges.shape[:-1])
        between = (correlation[..., 1:] + correlation[..., :-1]) / 2
        summed = functional.pad(between.cumsum(dim=-1), (1, 0))
        shift = edges.clamp(0, shifts - 1)
        low = shift.floor().clamp(max=shifts - 2)
        beyond = shift - low
        index = low.long().expand(*lead, -1)
        lower, upper, total = (
            sums.expand(*lead, -1).gather(-1, index + step)
            for sums, step in ((correlation, 0), (correlation, 1), (summed, 0))
        )
        integral = total + beyond * lower + beyond.square() / 2 * (upper - lower)
        return (integral.diff(dim=-1) / edges.diff(dim=-1)).clamp(min=0)  # of rounding

    def matrix(self, pattern: Tensor) -> Tensor:
        """Sensing matrix (..., T, N) of a pattern (..., H, P) without jitter."""
        columns = self.every_shift(pattern).transpose(-2, -1)
        edges = ScenePath(self.shape, self.width, self.bins, self.speed).edges(
            (), None, pattern.device
        )
        return self.means(columns, edges).transpose(-2, -1) / self.bins

    def open(self, device: torch.device) -> Tensor:
        """Rails (1, T, N) of an open pattern as wide as the path: all of the light."""
        pixels = self.shape[0] * self.shape[1]
        return torch.full((1, self.bins, pixels), 1 / self.bins, device=device)

    def readouts(self, device: torch.device) -> Readouts:
        """Readouts of the bins: all are counted, for one time."""
        shown = torch.ones(2, 1, self.bins, dtype=torch.bool, device=device)
        shown[1] = False
        bins = torch.arange(self.bins, device=device)
        return Readouts(shown, shown / self.bins, bins.expand_as(shown))


class FixedPattern(FixedMasks):
    """A pattern that does not learn; `forward` gives rails of its nominal matrix."""

    pattern: Tensor  # (R, H, P)

    def __init__(self, pattern: Tensor, transit: ScenePath) -> None:
        super().__init__(transit.matrix(pattern).unsqueeze(-3))
        self.transit = transit
        self.register_buffer("pattern", pattern)


class LearnedPattern(LearnedMasks):
    """A pattern that learns, in [0, 1], from logits (R, H, P).

    Grey levels have the gradient of the continuous pattern.
    """

    def __init__(self, start: Tensor, transit: ScenePath, levels: int = 0) -> None:
        nn.Module.__init__(self)
        self.transit = transit
        self.levels = levels
        self.weight = nn.Parameter(start)

    @property
    def pattern(self) -> Tensor:
        """The pattern (R, H, P)."""
        grey = torch.sigmoid(self.weight)
        if not self.levels:
            return grey
        with torch.no_grad():
            shown = in_levels(grey, self.levels)
        return straight_through(grey, shown)

    def forward(self) -> Rails:
        """Rails of the nominal matrix, (R, T, N)."""
        return Rails(self.transit.matrix(self.pattern))


def in_levels(pattern: Tensor, levels: int) -> Tensor:
    """A pattern (..., H, P) in grey levels from dark to open; `InputError` if these are too few."""
    check_levels(levels)
    steps = levels - 1
    return (pattern * steps).round() / steps


@dataclass(frozen=True, eq=False, kw_only=True)
class PassingExposure(MaskExposure):
    """Exposure of a scene that passes a pattern, each time at another place.

    The rails belong to the transit without jitter.
    """

    entry: PassingEntry
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

    def __post_init__(self) -> None:
        """Raise `ValueError` unless the masks belong to the pattern."""
        bounds = float(self.pattern.min()), float(self.pattern.max())
        if len(self.pattern) != self.entry.shape[0] or bounds[0] < 0 or bounds[1] > 1:
            raise ValueError("the pattern is not of these scenes, or not between dark and open")
        rails = self.rails.stacked
        wanted = self.transit.matrix(self.pattern).unsqueeze(0)
        shapes = self.image_shape, rails.shape
        if shapes != (self.entry.shape, wanted.shape) or not torch.allclose(rails, wanted, 1e-4):
            raise ValueError("masks are not of the pattern")

    @property
    def pattern(self) -> Tensor:
        """The pattern (H, P) that scenes pass."""
        return self.weights["pattern"]

    @cached_property
    def transit(self) -> ScenePath:
        """Path of scenes along the pattern."""
        path = self.entry.model_dump(exclude={"kind"})
        return ScenePath(width=self.pattern.shape[-1], **path)

    def quantised(self, levels: int) -> "PassingExposure":
        """The exposure of the pattern in grey levels."""
        shown = in_levels(self.pattern, levels)
        rails = Rails.of(self.transit.matrix(shown).unsqueeze(0))
        return replace(self, rails=rails, weights={"pattern": shown})

    def scanner(
        self, noise: str | NoiseFunction = "poisson", sigma: float = 1.0, dark: float = 0.0
    ) -> Scanner:
        """A scanner that reads every bin for the same time."""
        rails = self.transit.open(self.device)
        return Scanner.from_rails(rails, noise, sigma=sigma, dark=dark, detection=self.detection)

    def rates(self, scanner: Scanner, scenes: Tensor) -> Tensor:
        """Expected counts (..., 1, K) at every whole shift, of reflectances (..., N)."""
        photons = scenes.to(self.device) / self.summed_reflectance
        shifts = self.transit.every_shift(self.pattern)
        return project(photons, shifts).unsqueeze(-2) / self.transit.bins

    def placed(self, rates: Tensor, generator: torch.Generator | None) -> Tensor:
        """Expected counts (..., 1, T) of exposures, each along its own path, or in the mean."""
        if generator is None:
            return rates @ self._mean_bins.to(rates)
        edges = self.transit.edges(rates.shape[:-1], generator, rates.device)
        return self.transit.means(rates, edges)

    @cached_property
    def _mean_bins(self) -> Tensor:
        """Share (K, T) of each shift in each bin, in the mean over paths."""
        device = self.device
        generator = torch.Generator(device)
        unit_rates = torch.eye(self.transit.shifts, device=device).unsqueeze(1)
        # Transits whose mean is taken for expected counts of all
        count = 1024 if self.transit.moves else 1
        # a fixed seed: the mean is the same wherever it is taken
        edges = self.transit.edges((count,), generator.manual_seed(0), device)
        return self.transit.means(unit_rates, edges).mean(dim=1)

    def drawing(self) -> tuple[Tensor, tuple[int, ...], None]:
        """The pattern as one row, and its shape; bins have one length."""
        return self.pattern.flatten().unsqueeze(0), tuple(self.pattern.shape), None


class PassingTraining(ExposureTraining):
    """A pattern of each seed, and bins of scenes that pass it, along other paths in each step."""

    masks: FixedPattern | LearnedPattern

    def __init__(self, group: JobGroup) -> None:
        super().__init__(group)
        asked = self.job.exposure
        shape = self.scenes.data.image_shape
        assert isinstance(asked, Passing)
        height, width = shape
        entry = PassingEntry(
            shape=(height, width),
            bins=asked.bins,
            speed=asked.speed,
            jitter=asked.jitter,
            speed_jitter=asked.speed_jitter,
        )
        self.entries = [entry] * len(self.jobs)
        path = entry.model_dump(exclude={"kind"})
        self.transit = ScenePath(width=asked.columns(shape), **path)
        seeds = [job.seed for job in self.jobs] if self.learns else matrix_seeds(self.jobs)
        draws = [torch.Generator().manual_seed(seed) for seed in seeds]
        size = height, self.transit.width
        if self.learns:  # logits
            start = torch.stack([torch.randn(size, generator=draw) for draw in draws])
            self.masks = LearnedPattern(start, self.transit, self.levels).to(self.scenes.device)
        else:  # ON and OFF
            pattern = torch.stack([torch.rand(size, generator=draw) for draw in draws])
            self.masks = FixedPattern(in_levels(pattern, 2), self.transit).to(self.scenes.device)

    def prepare(self) -> None:
        """Take the products of scenes with a pattern that does not learn."""
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
                seen = stream.products(self.products)
            else:
                x = self.scenes.full.index_select(0, stream.rows)
                seen = project(x, stream.of_jobs(shifts, -3))
            edges = self.transit.edges((len(seen), 1), stream.generator, seen.device)
            expected = self.transit.means(seen, edges) / self.transit.bins
            if expected.shape[1] == 1:
                expected = stream.repeated(expected)
            return stream.noise.features(expected, expected, self.read, stream.normal)

        drawn = side_by_side([features(stream) for stream in draws.streams])
        return standardise_batch(drawn - drawn.mean(dim=0), self.scale)

    def fix(self) -> None:
        """Take the pattern as it is at the end of the training."""
        with torch.no_grad():
            self.masks = FixedPattern(self.masks.pattern, self.transit)
        patterns = self.masks.pattern
        self.weights = [
            {"pattern": patterns[job % len(patterns)].clone()} for job in range(len(self.jobs))
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
            # unbiased noise adds its variance, so that none was drawn
            power = power + noise.variance(counts, counts, read)
        std = deviation(power, self.scale)
        light_of_jobs = counts.expand_as(std)
        return self.trained((mean.expand_as(std), std, light_of_jobs))

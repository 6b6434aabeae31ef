"""Features in units of the scene: their noise, of trainings side by side, and their scales."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.jobs import Scale
from deepfsi.optics.detection import Detection, Readouts
from deepfsi.optics.masks import FixedMasks, LearnedMasks
from deepfsi.optics.noise import Click, OwnNoise, attach_gradient, readout, root, variance
from deepfsi.optics.rails import Rails
from deepfsi.optics.scanner import project, project_rails

CHUNK = 4096
"""Scenes that are multiplied at once outside the steps."""


@dataclass
class FeatureNoise:
    """Noise of the features x D, whose unit is one fully reflecting pixel: Φ / s counts."""

    kind: str  # name of a noise, the same for all
    gain: Tensor  # (R, 1): Counts of one fully reflecting pixel, Φ / s
    sigma: Tensor  # (R, 1): Read noise, counts rms per readout
    dark: Tensor  # (R, 1): Expected dark counts of a detector in a whole exposure
    own: OwnNoise | None  # the noise, where it is a user's own
    # One for each training, since what a Poisson draw takes from its generator depends on rates
    generators: list[torch.Generator]
    unit: Tensor = field(init=False)  # (R, 1): Standard deviation of photon noise where x S is 1

    def __post_init__(self) -> None:
        self.unit = self.gain.rsqrt()

    @classmethod
    def of(
        cls,
        kind: str,
        gains: Sequence[float],
        sigmas: Sequence[float],
        seeds: Sequence[int],
        device: torch.device,
        darks: Sequence[float] | None = None,
        own: OwnNoise | None = None,
    ) -> "FeatureNoise":
        """Noise of R trainings: parameters as of the class, of each training."""
        # Gains are Φ / s, counts. The Poisson draws of a seed are others than those of a generator
        # of the same seed
        numbers = (gains, sigmas, darks or [0.0] * len(gains))
        gain, sigma, dark = (torch.tensor(each, device=device).unsqueeze(1) for each in numbers)
        generators = [torch.Generator(device).manual_seed(seed ^ 2**31) for seed in seeds]
        return cls(kind, gain, sigma, dark, own, generators)

    def part(self, replicas: slice) -> "FeatureNoise":
        """Noise of some of the trainings, which draw from the same generators."""
        return replace(
            self,
            gain=self.gain[replicas],
            sigma=self.sigma[replicas],
            dark=self.dark[replicas],
            generators=self.generators[replicas],
        )

    @property
    def counting(self) -> bool:
        """True if counts of each rail are drawn, rather than a normal number for each feature."""
        return self.own is not None or self.kind in ("poisson", "camera")

    def counted(self, mean: Tensor, total: Tensor, read: Readouts | None) -> Tensor:
        """Features (B, R, m) from counts of two rails."""
        # mean, total (B, R, m)
        with torch.set_grad_enabled(self.own is not None and torch.is_grad_enabled()):
            rates = self._rates(mean, total)
            shown = torch.ones_like(rates[:1], dtype=torch.bool)
            if read is not None:
                shown = read.shown.unsqueeze(1)
            if self.own is not None:
                rates = torch.where(shown, rates, 1.0)  # the slope of a root at 0 is infinite
            drawn = [self._drawn(each, r, read) for r, each in enumerate(rates.unbind(dim=2))]
            plus, minus = torch.where(shown, torch.stack(drawn, dim=2), 0.0)
        features = (plus - minus) / self.gain
        if self.own is not None:
            return features
        return attach_gradient(features, mean, self._power(total, read))

    def expected(self, mean: Tensor, total: Tensor) -> Tensor:
        """Counts (R,) of an exposure, in the mean over noise and scenes."""
        # mean, total (B, R, m)
        rates = self._rates(mean, total)
        counts = self.own.expected(rates) if isinstance(self.own, Click) else rates
        return counts.sum(dim=(0, 3)).mean(dim=0)

    def _rates(self, mean: Tensor, total: Tensor) -> Tensor:
        """Expected photons (2, B, R, m) of the rails."""
        return torch.stack([total + mean, total - mean]).mul(self.gain / 2).clamp(min=0)

    def _drawn(self, rates: Tensor, replica: int, read: Readouts | None) -> Tensor:
        """Counts (2, B, m) of the rails of one training."""
        generator = self.generators[replica]
        if self.own is not None:
            return self.own(rates, generator)
        if read is None:
            return readout(rates, self.kind, generator=generator)
        time = read.time.unsqueeze(1) if read.time.ndim == 3 else read.time
        time = time[:, :, replica % time.shape[2]]
        dark = self.dark[replica] * time.detach()
        return readout(rates, self.kind, self.sigma[replica], generator, dark)

    def deviation(self, total: Tensor, lit: Tensor) -> Tensor:
        """Standard deviation of features (..., R, m) under a noise that is no counting."""
        # total (..., R, m); lit (R, m)
        if self.kind == "ml_gauss":
            return root(total) * self.unit
        return root(variance(total, lit, self.kind, self.sigma) / self.gain.square())

    def variance(self, total: Tensor, read: Readouts) -> Tensor:
        """Variance of features (..., R, m) of `total` = x S, but of a user's own noise."""
        return self._power(total, read) / self.gain

    def _power(self, total: Tensor, read: Readouts | None) -> Tensor:
        """Variance of features over that of photon noise where x S is 1."""
        if read is None or self.kind in ("ml_gauss", "poisson"):
            return total
        dark = self.dark * read.time.sum(dim=0)
        return variance(total * self.gain, read.lit, self.kind, self.sigma, dark) / self.gain


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


def feature_statistics(
    scenes: Tensor,
    masks: FixedMasks | LearnedMasks,
    noise: FeatureNoise,
    scale: Scale,
    detection: Detection,
    exposures: tuple[Tensor, Tensor] | None = None,
    means: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Mean and standard deviation of features over scenes and noise, and mean x S."""
    # scenes (n, N); means (n, R or 1, k)
    arranged = masks().each(detection.arrange)
    if noise.own is not None:
        return _sampled_statistics(scenes, arranged, noise, scale, detection)
    frames = detection.read_of(arranged)
    middle = detection.arrange(scenes.mean(dim=0))
    mean, counts = (
        project(middle, sums, detection.count) for sums in (frames.difference, frames.total)
    )
    power = torch.zeros_like(mean)
    for place, x in enumerate(scenes.split(CHUNK)):
        rows = slice(place * CHUNK, place * CHUNK + len(x))
        expected = (
            project(detection.arrange(x), frames.difference, detection.count)
            if means is None
            else means[rows]
        )
        power += (expected - mean).square().sum(dim=0)
    drawn = noise.variance(counts, detection.readouts(arranged))
    factor, often = exposures or (1.0, None)
    std = deviation(power / len(scenes) + drawn * factor, scale, often)
    return mean.expand_as(std), std, counts.expand_as(std)


def _sampled_statistics(
    scenes: Tensor,
    arranged: Rails,
    noise: FeatureNoise,
    scale: Scale,
    detection: Detection,
) -> tuple[Tensor, Tensor, Tensor]:
    """Statistics as `feature_statistics` gives them, of a draw of a user's own noise."""
    # Parameters as there, but for the arranged rails of the masks
    read, moments = detection.readouts(arranged), []
    frames = detection.read_of(arranged)
    for x in scenes.split(CHUNK):
        light = detection.arrange(x)
        mean, counts = project_rails(light, frames, detection.count)
        drawn = noise.counted(mean, counts, read).double()
        moments.append(torch.stack([drawn.sum(dim=0), drawn.square().sum(dim=0)]))
    first, second = torch.stack(moments).sum(dim=0) / len(scenes)
    std = deviation((second - first.square()).clamp(min=0).to(scenes.dtype), scale)
    counts = project(detection.arrange(scenes.mean(dim=0)), frames.total, detection.count)
    return first.to(scenes.dtype), std, counts.expand_as(std)


def mean_over_exposures(used: Tensor, span: float, chances: Tensor) -> tuple[Tensor, Tensor]:
    """Noise of each mask in the mean over the budgets and numbers of masks of a training."""
    # used (R or 1, m); chances (m,)
    dim = (1 - 1 / span) / math.log(span) if span > 1 else 1.0
    later = (chances * used / used[..., -1:]).flip(-1).cumsum(-1).flip(-1)
    often = chances.flip(-1).cumsum(-1).flip(-1)
    return dim * later / often, often

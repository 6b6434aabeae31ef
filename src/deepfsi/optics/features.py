"""Features in units of the scene: their noise, of trainings side by side, and their scales."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.optics.masks import Fixed, Learned
from deepfsi.optics.noise import Noise, attach_gradient, poisson, root, variance
from deepfsi.optics.scanner import lit, project

Scale = Literal["each", "common"]
"""Whether each feature has a standard deviation of its own, or all a common one."""

CHUNK = 4096
"""Scenes that are multiplied at once outside the steps."""


@dataclass
class FeatureNoise:
    """Noise of the features x D, whose unit is one fully reflecting pixel: Φ / s counts.

    Attributes
    ----------
    kind : str
        Of `noise.Noise`, the same for all.
    gain : tensor, shape (R, 1)
        Counts of one fully reflecting pixel, Φ / s.
    sigma : tensor, shape (R, 1)
        Read noise, counts per readout.
    generators : list of torch.Generator
        One for each training, since what a Poisson draw takes from its generator depends on rates.
    unit : tensor, shape (R, 1)
        Standard deviation of photon noise where x S is 1.
    """

    kind: Noise
    gain: Tensor
    sigma: Tensor
    generators: list[torch.Generator]
    unit: Tensor = field(init=False)

    def __post_init__(self) -> None:
        self.unit = self.gain.rsqrt()

    @classmethod
    def of(
        cls,
        kind: Noise,
        gains: Sequence[float],
        sigmas: Sequence[float],
        seeds: Sequence[int],
        device: torch.device,
    ) -> "FeatureNoise":
        """Noise of R trainings: parameters as of the class, of each training.

        Gains are Φ / s, counts. The Poisson draws of a seed are others than those of a generator of
        the same seed.
        """
        gain, sigma = (torch.tensor(each, device=device).unsqueeze(1) for each in (gains, sigmas))
        generators = [torch.Generator(device).manual_seed(seed ^ 2**31) for seed in seeds]
        return cls(kind, gain, sigma, generators)

    def part(self, replicas: slice) -> "FeatureNoise":
        """Noise of some of the trainings, which draw from the same generators."""
        return replace(
            self,
            gain=self.gain[replicas],
            sigma=self.sigma[replicas],
            generators=self.generators[replicas],
        )

    def counted(self, mean: Tensor, total: Tensor) -> Tensor:
        """Features (B, R, m) from exact counts of two rails with `mean` = x D and `total` = x S."""
        with torch.no_grad():
            rates = torch.stack([total + mean, total - mean]).mul(self.gain / 2).clamp(min=0)
            drawn = zip(rates.unbind(dim=2), self.generators, strict=True)
            plus, minus = torch.stack([poisson(*each) for each in drawn], dim=2)
        return attach_gradient((plus - minus) / self.gain, mean, total)

    def deviation(self, total: Tensor, lit: Tensor) -> Tensor:
        """Standard deviation of features; as `variance`."""
        if self.kind == "ml_gauss":
            return root(total) * self.unit
        return root(self.variance(total, lit))

    def variance(self, total: Tensor, lit: Tensor) -> Tensor:
        """Variance of features (..., R, m) of `total` = x S; `lit` (R, m) rails are read out."""
        if self.kind in ("ml_gauss", "poisson"):
            return total / self.gain
        return variance(total, lit, self.kind, self.sigma) / self.gain.square()


def standardise(features: Tensor, scale: Scale, shown: Tensor | None = None) -> Tensor:
    """Divide centred features by the standard deviation of their batch.

    Parameters
    ----------
    features : tensor, shape (B, R, m)
    scale : {"each", "common"}
    shown : tensor, broadcastable to (B, R, m), optional
        Which features count; all unless given.
    """
    if shown is not None:
        over = (0,) if scale == "each" else (0, 2)
        power = (features.square() * shown).sum(dim=over, keepdim=True)
        return features / (power / shown.sum(dim=over, keepdim=True).clamp(min=1)).sqrt()
    if scale == "each":
        columns = functional.batch_norm(features.flatten(1), None, None, training=True, eps=1e-20)
        return columns.view_as(features)
    size = torch.linalg.vector_norm(features, dim=(0, 2)) / (features[:, 0].numel() ** 0.5)
    return features / size[:, None]


def deviation(power: Tensor, scale: Scale, weights: Tensor | None = None) -> Tensor:
    """Standard deviation (..., m) of features of known variance; 1 where that is 0.

    Parameters
    ----------
    power : tensor, shape (..., m)
        Variance.
    scale : {"each", "common"}
    weights : tensor, shape (m,), optional
        Of the features in a common scale; equal unless given.
    """
    if scale == "common":
        weights = torch.ones_like(power) if weights is None else weights
        common = (power * weights).sum(dim=-1, keepdim=True) / weights.sum(dim=-1, keepdim=True)
        power = common.expand_as(power)
    return torch.where(power > 0, power, 1.0).sqrt()


def feature_statistics(
    scenes: Tensor,
    masks: Fixed | Learned,
    noise: FeatureNoise,
    scale: Scale,
    exposures: tuple[Tensor, Tensor] | None = None,
    means: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Mean and standard deviation of features over scenes and noise, and mean x S.

    Parameters
    ----------
    scenes : tensor, shape (n, N)
    masks : Fixed or Learned
        Of R replicas, or of one for all.
    noise : FeatureNoise
        Of R jobs.
    scale : {"each", "common"}
    exposures : tuple of tensor, optional
        From `mean_over_exposures`, where budgets or numbers of masks differ.
    means : tensor, shape (n, R or 1, m), optional
        x D of all scenes, where it is known.

    Returns
    -------
    tuple of tensor
        Each (R, m), for scenes of unit reflectance: to be divided by the summed reflectance s.
    """
    difference, total = masks()
    mean, counts = (project(scenes.mean(dim=0), rails) for rails in (difference, total))
    power = torch.zeros_like(mean)
    for place, x in enumerate(scenes.split(CHUNK)):
        rows = slice(place * CHUNK, place * CHUNK + len(x))
        expected = project(x, difference) if means is None else means[rows]
        power += (expected - mean).square().sum(dim=0)
    drawn = noise.variance(counts, lit(difference, total))
    factor, often = exposures or (1.0, None)
    std = deviation(power / len(scenes) + drawn * factor, scale, often)
    return mean.expand_as(std), std, counts.expand_as(std)


def mean_over_exposures(used: Tensor, span: float, chances: Tensor) -> tuple[Tensor, Tensor]:
    """Noise of each mask in the mean over the budgets and numbers of masks of a training.

    Parameters
    ----------
    used : tensor, shape (R or 1, m)
        Share of the light constraint that the first masks take, from `constraints.used`.
    span : float
        Highest budget over the lowest.
    chances : tensor, shape (m,)
        Of each number of masks to be shown.

    Returns
    -------
    tuple of tensor
        Noise variance (R or 1, m) over that of the lowest budget and all masks, in the mean over
        exposures that show the mask; and the share (m,) of exposures that do.
    """
    dim = (1 - 1 / span) / math.log(span) if span > 1 else 1.0
    later = (chances * used / used[..., -1:]).flip(-1).cumsum(-1).flip(-1)
    often = chances.flip(-1).cumsum(-1).flip(-1)
    return dim * later / often, often

"""Noise of features in units of the scene, of trainings side by side."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from deepfsi.optics.noise import Noise, attach_gradient, poisson, root, variance


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
        """Noise of R trainings.

        Parameters
        ----------
        kind : {"none", "gaussian", "poisson", "ml_gauss"}
        gains : sequence of float
            Φ / s of each training, counts.
        sigmas : sequence of float
            Read noise of each, counts per readout.
        seeds : sequence of int
            Of each; their Poisson draws are others than those of a generator of the same seed.
        device : torch.device
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

"""Noises as users write them, importable as `shared.noises:NAME`."""

from collections.abc import Sequence

import torch
from torch import Tensor

from deepfsi.camera import find_noise
from deepfsi.physics import TrainingNoise, noise, root


def photons(rates: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """The package's ml_gauss, written again."""
    return rates + root(rates) * torch.randn(rates.shape, generator=generator, device=rates.device)


def saturating(rates: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """A detector that saturates at a thousand counts: another mean than the rates."""
    seen = rates / (1 + rates / 1000)
    return seen + root(seen) * torch.randn(rates.shape, generator=generator, device=rates.device)


def exact(rates: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Exact counts, whose draws have no gradient."""
    return torch.poisson(rates, generator)


def offset(rates: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Photon noise on an offset that is far above it."""
    return photons(rates, generator) + 1e7


def training_noise(
    kind: str,
    gains: Sequence[float],
    sigmas: Sequence[float],
    seeds: Sequence[int],
    device: torch.device,
    darks: Sequence[float] | None = None,
) -> TrainingNoise:
    """A noise of trainings side by side, of the numbers of each."""
    darks = darks if find_noise(kind).dark else None
    each = zip(sigmas, darks or [0.0] * len(sigmas), strict=True)
    noises = [noise.make_noise(kind, sigma=sigma, dark=dark) for sigma, dark in each]
    return TrainingNoise.of(noises, gains, seeds, device)

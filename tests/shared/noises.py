"""Noises as users write them, importable as `shared.noises:NAME`."""

import torch
from torch import Tensor

from deepfsi.physics.noise import root


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


PLUS = torch.tensor([[0.5, 0.0], [0.25, 0.2], [0.0, 0.0], [0.0, 0.0]], dtype=torch.float64)
MINUS = torch.tensor([[0.0, 0.25], [0.0, 0.0], [0.25, 0.5], [0.0, 0.0]], dtype=torch.float64)
RAILS = torch.stack([PLUS, MINUS])
"""Rails (2, 4, 2): of the masks both are lit, one alone, the other alone, and none."""

TIMES = torch.tensor([[0.5, 0.25, 0.0, 0.0], [0.25, 0.0, 0.5, 0.0]], dtype=torch.float64)
"""Shares of the exposure that each is shown, by hand."""

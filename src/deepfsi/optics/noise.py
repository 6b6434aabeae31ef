"""Detector noise F, applied to each rail on its own.

    none      F(r) = r
    gaussian  F(r) = r + σ ε          read noise, σ in counts per readout (the paper's AGN)
    poisson   F(r) ~ Poisson(r)       photon noise, exact; used for testing
    ml_gauss  F(r) = r + √r ε         its smooth stand-in; used for training

ε is standard normal. Exact counts train masks too, with the gradient of `attach_gradient`.
A rail that is dark by construction is not read out and adds no noise.
"""

from typing import Any, Literal, get_args

import torch
from torch import Tensor

from deepfsi.errors import check_known

Noise = Literal["none", "gaussian", "poisson", "ml_gauss"]
"""Name of a detector noise."""

POISSON_LIMIT = 1e6
"""Rate in counts above which `poisson` samples the rounded Gaussian limit.

There the skewness, 1/√rate, is below 1e-3, while Poisson samplers on GPUs are poor for small
differences and wrong at 1e10 (PyTorch issues 86782 and 136750).
"""


def check_noise(name: str) -> Noise:
    """Return the name of a noise, or raise `InputError` that names the closest."""
    check_known("noise", name, get_args(Noise))
    return name  # type: ignore[return-value]


def poisson(rate: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Draw photon counts.

    Parameters
    ----------
    rate : tensor, any shape
        Expected counts, at least 0. In float32 counts above 2²⁴ = 1.7e7 are no longer exact; up to
        1e10 the rounding stays below 1/190 of their photon noise.
    generator : torch.Generator, optional
        On the device of `rate`.

    Returns
    -------
    tensor
        Counts, of the shape and type of `rate`. No gradient flows to `rate`: see `attach_gradient`.
    """
    exact = torch.poisson(rate.clamp(max=POISSON_LIMIT), generator=generator)
    bright = rate > POISSON_LIMIT
    if not bool(bright.any()):
        return exact
    return torch.where(bright, torch.round(ml_gauss(rate, generator)), exact)


def gaussian(rate: Tensor, sigma: float, generator: torch.Generator | None = None) -> Tensor:
    """Add read noise to each readout; shapes as `poisson`.

    Parameters
    ----------
    rate : tensor, any shape
        Expected counts.
    sigma : float
        Standard deviation, counts per readout.
    generator : torch.Generator, optional
    """
    return rate + sigma * _normal(rate, generator)


def ml_gauss(rate: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Add Gaussian noise whose variance is the rate (the paper's MLGauss); shapes as `poisson`."""
    return rate + root(rate) * _normal(rate, generator)


def attach_gradient(counts: Tensor, mean: Tensor, total: Tensor) -> Tensor:
    """Let exact counts follow what their mean and variance depend on, as those of `ml_gauss` do.

    Parameters
    ----------
    counts : tensor, shape (..., m)
        y, of one rail or the difference of two, drawn at a mean μ and a variance L.
    mean, total : tensor, shape (..., m)
        μ and L: difference and sum of the rails' expected counts; of one rail, both its own.

    Returns
    -------
    tensor, shape (..., m)
        The counts, with the derivatives 1 in μ and (y − μ) / 2L in L; 0 where L is 0.

    Notes
    -----
    These are the derivatives of μ + √L ε at the ε that gives y. The gradient of the mean of any
    f(y) is right where f is at most quadratic. For one rail, where it is f′(k) (1 + k/r) / 2, its
    mean is that of [f′(k) + f′(k + 1)] / 2, because E[k g(k)] = r E[g(k + 1)]: the trapezoid rule
    for what is exact, ∂ E f / ∂r = E[f(k + 1) − f(k)] = E ∫₀¹ f′(k + t) dt.
    """
    fixed = total.detach()
    pull = torch.where(fixed > 0, (counts - mean.detach()) / (2 * fixed), 0.0)
    return counts + (mean - mean.detach()) + pull * (total - fixed)


def root(rate: Tensor) -> Tensor:
    """Square root whose gradient is 0, not infinite, where the rate is 0 (a dark rail)."""
    return _Root.apply(rate)  # type: ignore[no-untyped-call]


class _Root(torch.autograd.Function):
    @staticmethod
    def forward(rate: Tensor) -> Tensor:
        return rate.clamp(min=0).sqrt()

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor], output: Tensor) -> None:
        ctx.save_for_backward(output)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        (value,) = ctx.saved_tensors
        return torch.where(value > 0, gradient / (2 * value), 0.0)


def readout(
    rate: Tensor, noise: Noise, sigma: float = 1.0, generator: torch.Generator | None = None
) -> Tensor:
    """Noisy counts of one rail.

    Parameters
    ----------
    rate : tensor, shape (..., m)
        Expected counts.
    noise : {"none", "gaussian", "poisson", "ml_gauss"}
    sigma : float
        Counts per readout, for gaussian noise only.
    generator : torch.Generator, optional

    Returns
    -------
    tensor, shape (..., m)
        Counts.
    """
    check_noise(noise)
    if noise == "none":
        return rate
    if noise == "gaussian":
        return gaussian(rate, sigma, generator)
    if noise == "poisson":
        return poisson(rate, generator)
    return ml_gauss(rate, generator)


def variance(total: Tensor, lit: Tensor, noise: Noise, sigma: float | Tensor = 1.0) -> Tensor:
    """Variance of the difference of two rails, y⁺ − y⁻.

    Parameters
    ----------
    total : tensor, shape (..., m)
        Sum of the rails' expected counts.
    lit : tensor, shape (m,)
        Number of rails that are read out, 0, 1 or 2.
    noise, sigma
        As for `readout`.

    Returns
    -------
    tensor, broadcastable to (..., m)
        Counts squared.
    """
    if noise == "none":
        return torch.zeros_like(lit, dtype=total.dtype)
    if noise == "gaussian":
        return sigma**2 * lit.to(total.dtype)
    return total


def _normal(like: Tensor, generator: torch.Generator | None) -> Tensor:
    return torch.randn(like.shape, generator=generator, device=like.device, dtype=like.dtype)

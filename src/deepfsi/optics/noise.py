"""Detector noise F, applied to each rail on its own.

    none      F(r) = r
    gaussian  F(r) = r + σ ε          read noise, σ in counts per readout (the paper's AGN)
    poisson   F(r) ~ Poisson(r)       photon noise, exact; used for testing
    ml_gauss  F(r) = r + √r ε         its smooth stand-in; used for training
    camera    F(r) ~ Poisson(r + d) − d + σ ε
                                      photon noise, dark counts d and read noise together
    click     F(r) ~ Binomial(G, 1 − exp(−r / G))
                                      a detector that fires at most once in each of G gates

Dark counts are known from frames with the light off, and what is expected of them is subtracted.
One detector has D of them in a whole exposure, and a frame its share d of these by its time.

Clicks are no photons: their mean is not the rate, and a frame gives G of them at most. They are
drawn by `Click`, a function as a user's own noise is.

A function of the user's own, from expected counts r of a rail and a generator to counts, is a noise
too; masks train through it where its draws have a gradient in r.

ε is standard normal. Exact counts train masks too, with the gradient of `attach_gradient`.
A rail that is dark by construction is not read out and adds no noise.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, get_args

import torch
from torch import Tensor

from deepfsi.base import UNNAMED_PLUGIN, InputError, check_choice, import_path, load_plugin
from deepfsi.camera import Camera, NoiseName, check_noise

OwnNoise = Callable[[Tensor, torch.Generator | None], Tensor]
"""A user's own noise: counts of expected counts (..., m), drawn with a generator."""


@dataclass(frozen=True)
class Click:
    """Noise of a detector that fires at most once in each of `gates` gates of a frame."""

    gates: int = 1
    name: ClassVar[str] = "click"  # by which settings name it

    def __call__(self, rates: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Clicks of rates (..., m), with the gradient of `attach_gradient`."""
        # With the mean G p and the variance G p (1 − p) that is f′(k) [k / p + (G − k) / (1 − p)]
        # / 2, the trapezoid rule for what is exact, ∂ E f / ∂p = G E[f(k + 1) − f(k)] of G − 1
        # gates: no error where f is at most quadratic
        chance = -torch.expm1(-rates / self.gates)
        fixed = chance.detach()
        if self.gates == 1:
            drawn = torch.rand(
                fixed.shape, generator=generator, device=fixed.device, dtype=fixed.dtype
            )
            counts = (drawn < fixed).to(fixed.dtype)
        else:
            counts = torch.binomial(torch.full_like(fixed, self.gates), fixed, generator)
        mean = self.gates * chance
        return attach_gradient(counts, mean, mean * (1 - chance))

    def expected(self, rates: Tensor) -> Tensor:
        """Mean clicks of rates (..., m)."""
        return -self.gates * torch.expm1(-rates / self.gates)

    def variance(self, rates: Tensor) -> Tensor:
        """Variance of the clicks of rates (..., m)."""
        return self.expected(rates) * torch.exp(-rates / self.gates)


POISSON_LIMIT = 1e6
"""Rate in counts above which `poisson` samples the rounded Gaussian limit.

There the skewness, 1/√rate, is below 1e-3, while Poisson samplers on GPUs are poor for small
differences and wrong at 1e10 (PyTorch issues 86782 and 136750).
"""


def check_dark(dark: object, noise: str) -> float:
    """Return dark counts of a detector in an exposure, or raise `InputError`."""
    if not (isinstance(dark, int | float) and math.isfinite(dark) and dark >= 0):
        raise InputError(f"{dark!r} dark counts are not allowed: give 0 or more for an exposure")
    if dark and noise != "camera":
        raise InputError(
            "dark counts are not of {given} noise: give {noise:camera} with them",
            setting="noise",
            given=noise,
        )
    return dark


def resolve(noise: str | OwnNoise, gates: int = 1) -> tuple[str, OwnNoise | None]:
    """Name of a noise, and its function where it is a user's own or counts clicks."""
    if noise == "click":
        return "click", Click(gates)
    if isinstance(noise, Click):
        return "click", noise
    if not isinstance(noise, str):
        return import_path(noise) or UNNAMED_PLUGIN, noise
    return check_noise(noise), load_plugin(noise) if ":" in noise else None


def noise_of(camera: Camera) -> str | OwnNoise:
    """Noise of a camera's counts as `Scanner` takes it: a name, or the function of clicks."""
    return camera.noise if camera.clicks is None else Click(camera.clicks)


def try_own(own: OwnNoise, learning: bool) -> None:
    """Raise `InputError` unless a user's noise draws counts, and masks can learn under it."""
    rates = torch.tensor([0.5, 3.0, 50.0]).repeat(64, 1).requires_grad_(learning)
    try:
        counts = own(rates, torch.Generator().manual_seed(0))
        whole = counts.shape == rates.shape and bool(torch.isfinite(counts).all())
    except Exception as error:
        told = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"the noise cannot be used: {told}; give noise(rates, generator), counts of a tensor"
        ) from error
    if not whole:
        raise InputError(
            "the noise gives no finite counts of the shape of the rates: give one that does"
        )
    if learning and not (
        counts.requires_grad and bool(torch.autograd.grad(counts.sum(), rates)[0].any())
    ):
        raise InputError(
            "masks cannot learn under this noise, whose draws have no gradient in the rates (those "
            "of torch.poisson have none): draw rates + std * torch.randn, or train under ml_gauss "
            "and test under it"
        )


def poisson(rate: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Draw photon counts."""
    exact = torch.poisson(rate.clamp(max=POISSON_LIMIT), generator=generator)
    bright = rate > POISSON_LIMIT
    if not bool(bright.any()):
        return exact
    return torch.where(bright, torch.round(ml_gauss(rate, generator)), exact)


def gaussian(
    rate: Tensor, sigma: float | Tensor, generator: torch.Generator | None = None
) -> Tensor:
    """Add read noise to each readout; shapes as `poisson`."""
    return rate + sigma * _normal(rate, generator)


def ml_gauss(rate: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Add Gaussian noise whose variance is the rate (the paper's MLGauss); shapes as `poisson`."""
    return rate + root(rate) * _normal(rate, generator)


def attach_gradient(counts: Tensor, mean: Tensor, total: Tensor) -> Tensor:
    """Let exact counts follow what their mean and variance depend on, as those of `ml_gauss` do."""
    # These are the derivatives of μ + √L ε at the ε that gives y. The gradient of the mean of any
    # f(y) is right where f is at most quadratic. For one rail, where it is f′(k) (1 + k/r) / 2, its
    # mean is that of [f′(k) + f′(k + 1)] / 2, because E[k g(k)] = r E[g(k + 1)]: the trapezoid rule
    # for what is exact, ∂ E f / ∂r = E[f(k + 1) − f(k)] = E ∫₀¹ f′(k + t) dt. counts (..., m);
    # mean, total (..., m)
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
    rate: Tensor,
    noise: str,
    sigma: float | Tensor = 1.0,
    generator: torch.Generator | None = None,
    dark: float | Tensor = 0.0,
) -> Tensor:
    """Noisy counts of one rail."""
    # rate (..., m); dark (..., m)
    check_choice("noise", noise, get_args(NoiseName))
    if noise == "none":
        return rate
    if noise == "camera":
        return gaussian(poisson(rate + dark, generator) - dark, sigma, generator)
    if noise == "gaussian":
        return gaussian(rate, sigma, generator)
    if noise == "poisson":
        return poisson(rate, generator)
    return ml_gauss(rate, generator)


def variance(
    total: Tensor,
    lit: Tensor,
    noise: str,
    sigma: float | Tensor = 1.0,
    dark: float | Tensor = 0.0,
) -> Tensor:
    """Variance of the difference of two rails, y⁺ − y⁻."""
    # total (..., m); lit (m,); dark (..., m)
    if noise == "none":
        return torch.zeros_like(lit, dtype=total.dtype)
    if noise == "gaussian":
        return sigma**2 * lit.to(total.dtype)
    if noise == "camera":
        return total + dark + sigma**2 * lit.to(total.dtype)
    return total


def _normal(like: Tensor, generator: torch.Generator | None) -> Tensor:
    return torch.randn(like.shape, generator=generator, device=like.device, dtype=like.dtype)

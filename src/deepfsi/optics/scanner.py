"""The optical front end as a layer: photons per pixel in, noisy features out."""

from typing import Any

import torch
from torch import Tensor, nn

from deepfsi.base import InputError
from deepfsi.optics.detection import Detection
from deepfsi.optics.masks import FixedMasks
from deepfsi.optics.noise import (
    Click,
    OwnNoise,
    attach_gradient,
    check_dark,
    readout,
    resolve,
    root,
    variance,
)
from deepfsi.optics.rails import Rails


class Scanner(nn.Module):
    """Masks, detectors and their noise: (..., N) photons → (..., k) feature counts y⁺ − y⁻.

    An ordinary module: put it in front of any network and train both.

    Parameters
    ----------
    masks : FixedMasks or LearnedMasks
        Gives the rails of masks ([replicas,] m, N).
    noise : {"poisson", "gaussian", "ml_gauss", "camera", "click", "none"} or callable
        Under photon noise `poisson` to test, and either it or `ml_gauss` to train; `camera` adds
        dark counts and read noise to it; `click` is of detectors that fire at most once, and
        `Click(gates)` of several gates a frame. Or a noise of your own: a function from expected
        counts of rails and a generator to counts, or its import path.
    sigma : float
        Read noise in counts rms per readout, for gaussian and camera noise.
    dark : float
        Expected dark counts of one detector in the whole exposure, for camera noise.
    detection : Detection, optional
        Several detectors, and what is read of two rails. One detector and the difference unless
        given, for which k = m.

    Examples
    --------
    >>> import deepfsi, torch
    >>> rails = torch.tensor([[[0.5, 0.0]], [[0.0, 0.5]]])  # (2 rails, 1 mask, 2 pixels)
    >>> deepfsi.Scanner.from_rails(rails, noise="none")(torch.tensor([30.0, 10.0]))
    tensor([10.])
    """

    def __init__(
        self,
        masks: nn.Module,
        noise: str | OwnNoise = "poisson",
        sigma: float = 1.0,
        dark: float = 0.0,
        detection: Detection | None = None,
    ) -> None:
        super().__init__()
        if not isinstance(masks, nn.Module):
            raise InputError(
                f"masks were given as {type(masks).__name__}, not as a module: for a tensor "
                "of rails give Scanner.from_rails(rails)"
            )
        self.masks = masks
        self.noise, self._own = resolve(noise)
        self.sigma, self.dark = sigma, check_dark(dark, self.noise)
        self.detection = detection or Detection()

    @classmethod
    def from_rails(
        cls,
        rails: Tensor,
        noise: str | OwnNoise = "poisson",
        sigma: float = 1.0,
        dark: float = 0.0,
        detection: Detection | None = None,
    ) -> "Scanner":
        """Scanner with fixed rails (2 or 1, m, N); other parameters as for the class."""
        return cls(FixedMasks(rails), noise, sigma, dark, detection)

    def forward(self, photons: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Noisy features (..., [replicas,] k) of expected photons (..., N), in counts.

        Differentiable in the masks. Under gaussian noise and `ml_gauss` the two rails' noise is
        drawn at once, which is the same in distribution.
        """
        seen = self.detection
        if self._own is not None:
            return seen.features(self.read(self.rates(photons), generator))
        if self.noise in ("poisson", "camera"):
            rates = self.rates(photons)
            counts = seen.features(self.read(rates.detach(), generator))
            shown = seen.readouts(self._arranged())
            dark = self.dark * shown.time.sum(dim=0)
            power = variance(seen.totals(rates), shown.lit, self.noise, self.sigma, dark)
            return attach_gradient(counts, seen.features(rates), power)
        arranged = self._arranged()
        x = self._light(photons)
        masks = seen.read_of(arranged)
        if self.noise == "ml_gauss":
            mean, counts = project_rails(x, masks, seen.count)
        else:
            mean = counts = project(x, masks.difference, seen.count)
        if self.noise == "none":
            return mean
        power = variance(counts, seen.readouts(arranged).lit, self.noise, self.sigma)
        return mean + root(power) * torch.randn(
            mean.shape, generator=generator, device=mean.device, dtype=mean.dtype
        )

    def counts(self, photons: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Noisy counts (..., [replicas,] rails, m · D) of photons (..., N), as detectors report.

        Those of D detectors follow one another for each mask. A rail that is dark by construction
        reads 0.
        """
        return self.read(self.rates(photons), generator)

    def read(
        self,
        rates: Tensor,
        generator: torch.Generator | None = None,
        share: Tensor | float = 1.0,
    ) -> Tensor:
        """Noisy counts of rails whose expected counts are known; shapes as `counts`.

        The dwells of their frames are `share` of the masks' own, for dark counts.
        """
        shown, time = self._shown(rates.shape[-2])
        if self._own is not None:
            counts = self._own(torch.where(shown, rates, 1.0), generator)
        else:
            dark = self.dark * time * share
            counts = readout(rates, self.noise, self.sigma, generator, dark)
        return torch.where(shown, counts, 0.0)

    def dark_counts(self, rails: int) -> Tensor:
        """Expected dark counts (rails, m · D) of the readouts of an exposure of 1 or 2 rails.

        A rail that is dark by construction is not read out, and has none.
        """
        shown, time = self._shown(rails)
        return torch.where(shown, self.dark * time, 0.0)

    def expected(self, rates: Tensor) -> Tensor:
        """Mean counts of rails that so many photons reach: as many, but of detectors that click."""
        return self._own.expected(rates) if isinstance(self._own, Click) else rates

    @property
    def known(self) -> bool:
        """True of a noise whose mean and variance are known: all but a user's own."""
        return self._own is None or isinstance(self._own, Click)

    def moments(self, rates: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and variance (..., k) of features of rails that so many photons reach.

        Parameters
        ----------
        rates : tensor, shape (..., rails, m · D)
            Expected photons, as from `rates`.
        """
        return self.detection.features(self.expected(rates)), self.detection.totals(
            self._variance(rates)
        )

    def information(self, rates: Tensor) -> Tensor:
        """Fisher information (..., rails, m · D) of counts about the photons that they expect.

        Of counts y ~ Poisson(r) it is 1 / r, of clicks exp(−r / G) / (G p) with the chance of a
        click p = 1 − exp(−r / G), and of other noise 1 / variance. Of a rail that is dark by
        construction it is 0.
        """
        power = self._variance(rates)
        if isinstance(self._own, Click):
            slope = torch.exp(-rates / self._own.gates)
            power = power / slope.square()
        return torch.where(power > 0, 1 / power.where(power > 0, 1.0), 0.0)

    def _variance(self, rates: Tensor) -> Tensor:
        """Variance of the counts of rails that so many photons reach."""
        if isinstance(self._own, Click):
            return self._own.variance(rates)
        shown, time = self._shown(rates.shape[-2])
        every = variance(rates, shown, self.noise, self.sigma, self.dark * time)
        return torch.where(shown, every, 0.0).expand_as(rates)

    def _shown(self, rails: int) -> tuple[Tensor, Tensor]:
        """Which rails are not dark by construction, and their share of the exposure."""
        every = Detection(count=self.detection.count).readouts(self._arranged())
        shown, time = (each.movedim(0, -2)[..., :rails, :] for each in every)
        return shown, time.detach()

    def rates(self, photons: Tensor) -> Tensor:
        """Expected counts of each rail; shapes as `counts`."""
        frames = self.detection.arrange(self.masks().stacked)
        return project(self._light(photons), frames, self.detection.count)

    def _arranged(self) -> Rails:
        """Rails with the pixels of each detector together."""
        rails: Rails = self.masks()
        return rails.each(self.detection.arrange)

    def _light(self, photons: Tensor) -> Tensor:
        """Photons with the pixels of each detector together, checked."""
        _check_light(photons, self.masks().difference.shape[-1])
        return self.detection.arrange(photons)


def _check_light(photons: Any, pixels: int) -> None:
    """Raise `InputError` unless photons (..., N) are those of scenes of so many pixels."""
    if not isinstance(photons, Tensor):
        raise InputError(
            f"photons were given as {type(photons).__name__}: give a tensor, such as "
            "torch.as_tensor(photons)"
        )
    if not photons.is_floating_point():
        raise InputError(f"photons of type {photons.dtype} were given: give photons.float()")
    if photons.ndim == 0 or photons.shape[-1] != pixels:
        raise InputError(
            f"photons of shape {tuple(photons.shape)} do not fit masks of {pixels} pixels: give "
            f"(..., {pixels}), images flattened"
        )


def project(photons: Tensor, masks: Tensor, parts: int = 1) -> Tensor:
    """Product of scenes (..., N) with masks (*lead, m, N), as one: (..., *lead, m)."""
    # Multiplies in the type of the scenes and returns the wider of theirs and the masks'. For
    # several parts, of arranged scenes and masks (`detection`), the product of each: (..., *lead, m
    # · parts). photons (..., N); masks (*lead, m, N)
    low = masks.flatten(0, -2).to(photons.dtype)
    if parts == 1:
        product = photons @ low.T
    else:
        pieces = (each.unflatten(-1, (parts, -1)) for each in (photons, low))
        product = torch.einsum("...dp,kdp->...kd", *pieces).flatten(-2)
    wider = torch.promote_types(photons.dtype, masks.dtype)
    return product.to(wider).unflatten(-1, (*masks.shape[:-2], masks.shape[-2] * parts))


def project_rails(photons: Tensor, rails: Rails, parts: int = 1) -> tuple[Tensor, Tensor]:
    """Products (..., *lead, m · parts) of scenes with difference and total of rails, as `project`.

    Those of one rail are the same tensor.

    Shapes: photons (..., N); rails (*lead, m, N).
    """
    if rails.count == 1:
        mean = project(photons, rails.difference, parts)
        return mean, mean
    low = rails.each(lambda masks: masks.to(photons.dtype)).combined
    wider = torch.promote_types(photons.dtype, rails.difference.dtype)
    mean, counts = project(photons, low, parts).to(wider).unbind(-rails.difference.ndim)
    return mean, counts


def measure(
    scenes: Tensor, rails: Tensor, epsilon: Tensor, disjoint: bool, parts: int = 1
) -> Tensor:
    """Features (B, *lead, k) of centred scenes under MLGauss noise, one step of training."""
    # With x̄ the mean scene and x_c = x - x̄ these are x_c D + √(x S) ε: what `Scanner.forward`
    # gives, less the constant x̄ D. scenes (B + 1, N); rails (*lead, m, N) or (2, *lead, m, N), as
    # `Rails.combined`, or their difference alone if they are disjoint; epsilon (B, *lead, k)
    return _Measure.apply(scenes, rails, epsilon, disjoint, parts)  # type: ignore[no-untyped-call]


class _Measure(torch.autograd.Function):
    """Written out because autograd's own graph of it takes twice the time of its products."""

    @staticmethod
    def forward(
        ctx: Any, scenes: Tensor, masks: Tensor, epsilon: Tensor, signed: bool, parts: int
    ) -> Tensor:
        low = masks.to(scenes.dtype)
        if signed:
            ctx.sign = low.sgn()
            low = torch.stack([low, low.abs()])
        products = project(scenes, low, parts).to(epsilon.dtype)
        single = products.ndim == epsilon.ndim
        mean, counts = (products, products) if single else products.unbind(1)
        deviation = (counts[:-1] + counts[-1]).clamp_(min=0).sqrt_()
        ctx.save_for_backward(scenes, epsilon, deviation)
        ctx.signed, ctx.shape, ctx.parts = signed, low.shape, parts
        return torch.addcmul(mean[:-1], deviation, epsilon)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[None, Tensor, Tensor | None, None, None]:
        scenes, epsilon, deviation = ctx.saved_tensors
        # 0, not infinite, where a mask is dark; passes over booleans take many times longer
        by_counts = (epsilon / deviation).nan_to_num_(0, 0, 0).mul_(gradient).mul_(0.5)
        back = gradient.new_zeros(len(scenes), *ctx.shape[:-2], gradient.shape[-1])
        mean, counts = (back, back) if back.ndim == epsilon.ndim else back.unbind(1)
        mean[:-1] = gradient
        counts[:-1] += by_counts
        counts[-1] = by_counts.sum(dim=0)
        low = back.flatten(1).to(scenes.dtype)
        if ctx.parts == 1:
            product = (low.T @ scenes).view(ctx.shape)
        else:
            pieces = low.unflatten(-1, (-1, ctx.parts)), scenes.unflatten(-1, (ctx.parts, -1))
            product = torch.einsum("bkd,bdp->kdp", *pieces).reshape(ctx.shape)
        if ctx.signed:
            product = torch.addcmul(product[0], product[1], ctx.sign)
        by_draw = gradient * deviation if ctx.needs_input_grad[2] else None
        return None, product.to(gradient.dtype), by_draw, None, None

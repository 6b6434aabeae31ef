"""Detector noise: each is a class, from the expected counts r of a rail to the counts y.

    none      y = r                          gaussian  y = r + σ ε
    poisson   y ~ Poisson(r)                 ml_gauss  y = r + √r ε
    camera    y ~ Poisson(r + d) − d + σ ε   click     y ~ Binomial(G, 1 − exp(−r / G))

ε is standard normal. Light that fluctuates is brighter in one frame and dimmer in the next. A
feature is y⁺ − y⁻ of two rails, or y of a single rail. Masks train under counts drawn rail by rail,
too, with the gradient of `attach_gradient`. A rail that is dark by construction is not read out and
adds no noise.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, NamedTuple, Self

import torch
from torch import Tensor

from deepfsi.base.errors import InputError
from deepfsi.base.registry import load_plugin
from deepfsi.camera.camera import Camera
from deepfsi.camera.names import check_noise, find_noise, noise_name
from deepfsi.physics.detection import Readouts

Random = torch.Generator | None
"""Generator of the draws; None for torch's global one."""

NoiseFunction = Callable[[Tensor, Random], Tensor]
"""A user's own noise: counts of expected counts (..., m), drawn with a generator."""


class Expectation(NamedTuple):
    """Expected light of the readouts of features."""

    mean: Tensor  # (..., k)
    total: Tensor  # (..., k)
    read: Readouts  # rails that are read out, and for how long
    gain: Tensor | float = 1.0  # counts of a unit


@dataclass(frozen=True)
class Noise(ABC):
    """Noise of the readouts of a camera, and of its light.

    Its numbers are floats, or tensors (R, 1) for R trainings side by side.

    The light of a frame is r (1 + ε), where ε has the mean 0 and the standard deviation σ of
    `fluctuation`. All detectors share it, and so do two arms that see one frame: this adds
    σ² (r⁺ − r⁻)² to the variance of steady light. Two frames, one after the other, add
    σ² (r⁺² + r⁻²). 1 + ε is log-normal, so that no light is negative. Source:
    docs/notebook/flicker.md.
    """

    fluctuation: float = field(default=0.0, kw_only=True)  # σ, relative to the mean light
    name: ClassVar[str]  # the `noise` of a camera; a user's noise has its import path
    one_draw: ClassVar[bool] = False  # one normal number for each feature of steady light
    light_free: ClassVar[bool] = False  # its draws of steady light do not depend on the light
    # Whether the mean count is the rate. Then `gradient` gives counts the gradient of their mean
    # and variance; draws of a biased noise bring their own
    unbiased: ClassVar[bool] = True
    numbers: ClassVar[tuple[str, ...]] = ()  # fields that may differ in trainings side by side

    @property
    def settings(self) -> dict[str, Any]:
        """Its fields, which have the names of a camera's, such as `sigma`."""
        return dict(vars(self))

    def __call__(self, rates: Tensor, random: Random = None) -> Tensor:
        """Counts of rates (..., m) in a whole exposure."""
        light = rates * self.brightness(rates, random) if self.fluctuation else rates
        return self.draw(light, random, self.dark_counts(1.0))

    @property
    def draws_rails(self) -> bool:
        """Whether each rail is drawn, and not one normal number for each feature."""
        return bool(self.fluctuation) or not self.one_draw

    @property
    def depends_on_light(self) -> bool:
        """Whether draws depend on the light."""
        return bool(self.fluctuation) or not self.light_free

    def brightness(self, like: Tensor, random: Random = None) -> Tensor:
        """1 + ε of frames, log-normal, in the shape of a tensor."""
        # this width gives the standard deviation `fluctuation`; the last term sets the mean to 1
        sigma = math.sqrt(math.log1p(self.fluctuation**2))
        return torch.exp(sigma * normal(like, random) - sigma**2 / 2)

    @abstractmethod
    def draw(self, rates: Tensor, random: Random = None, dark: Tensor | float = 0.0) -> Tensor:
        """Counts of rails (...) of steady light, with dark counts from `dark_counts`."""

    def sample(
        self,
        rates: Tensor,
        read: Readouts,
        dark: Tensor | float = 0.0,
        random: Random = None,
        rails: int = -2,
    ) -> Tensor:
        """Counts of rails; one frame has one brightness, rails that are not read out count 0."""
        if self.fluctuation:
            shape = rates.movedim(rails, -2).shape
            frames = rates.new_empty(*shape[:-2], 2 * shape[-1])  # room for each frame
            frame = read.frame.movedim(rails, -2).expand(shape).flatten(-2)
            light = self.brightness(frames, random).gather(-1, frame)
            rates = rates * light.unflatten(-1, shape[-2:]).movedim(-2, rails)
        if not self.unbiased:
            rates = torch.where(read.active, rates, 1.0)  # the slope of a root at 0 is infinite
        return torch.where(read.active, self.draw(rates, random, dark), 0.0)

    def dark_counts(self, time: Tensor | float) -> Tensor | float:
        """Expected dark counts (...) of rails that are shown for a share (...) of the exposure."""
        return 0.0

    def mean(self, rates: Tensor) -> Tensor:
        """Mean counts of rails (...) that receive these photons."""
        return rates

    def variance(self, light: Expectation) -> Tensor:
        """Variance (..., k) of y⁺ − y⁻, in units of `gain` counts."""
        steady = self.steady_variance(light)
        if not self.fluctuation:
            return steady
        two_frames = (light.total.square() + light.mean.square()) / 2  # r⁺² + r⁻²
        one_frame = light.read.frame[0] == light.read.frame[-1]
        squares = torch.where(one_frame, light.mean.square(), two_frames)
        return steady + self.fluctuation**2 * light.gain * squares

    def steady_variance(self, light: Expectation) -> Tensor:
        """Variance (..., k) under steady light; for photons it is the total."""
        return light.total

    def gradient(self, counts: Tensor, light: Expectation) -> Tensor:
        """Drawn features (..., k), unchanged, with the gradient of their mean and variance.

        A biased noise keeps the gradient of its draws.
        """
        if not self.unbiased:
            return counts
        return attach_gradient(counts, light.mean, self.variance(light))

    def deviation(self, light: Expectation) -> Tensor:
        """Standard deviation (..., k) of features in units of the mean; not of drawn rails."""
        return root(self.variance(light) / light.gain)

    def check(self, learning: bool) -> None:
        """Raise `InputError` unless it draws counts, and masks can learn under it."""
        return  # all of the package pass

    def of_jobs(self, jobs: int | slice) -> Self:
        """Noise of one or several of the trainings side by side."""
        return replace(self, **{name: getattr(self, name)[jobs] for name in self.numbers})

    @classmethod
    def side_by_side(cls, noises: Sequence[Self], device: torch.device) -> Self:
        """One noise with the numbers (R, 1) of R trainings that differ in these alone."""
        numbers: dict[str, Any] = {
            name: torch.tensor([getattr(noise, name) for noise in noises], device=device)[:, None]
            for name in cls.numbers
        }
        return replace(noises[0], **numbers)


@dataclass(frozen=True)
class _NoNoise(Noise):
    """No noise: counts are the rates, y = r."""

    name = "none"
    one_draw = light_free = True

    def draw(self, rates: Tensor, random: Random = None, dark: Tensor | float = 0.0) -> Tensor:
        """The rates."""
        return rates

    def steady_variance(self, light: Expectation) -> Tensor:
        """Zero."""
        return torch.zeros_like(light.read.lit, dtype=light.total.dtype)


@dataclass(frozen=True)
class Gaussian(Noise):
    """Read noise alone, y = r + σ ε.

    Source: AGN of the paper, arXiv 2508.01981.
    """

    sigma: float | Tensor = 1.0
    name = "gaussian"
    numbers = ("sigma",)
    one_draw = light_free = True

    def draw(self, rates: Tensor, random: Random = None, dark: Tensor | float = 0.0) -> Tensor:
        """Rates with read noise."""
        return rates + self.sigma * normal(rates, random)

    def steady_variance(self, light: Expectation) -> Tensor:
        """σ² for each rail that is read out."""
        return self.sigma**2 * light.read.lit.to(light.total.dtype) / light.gain

    def deviation(self, light: Expectation) -> Tensor:
        """σ √(rails that are read out)."""
        # The base's formula would round differently
        return root(self.sigma**2 * light.read.lit.to(light.total.dtype) / light.gain**2)


@dataclass(frozen=True)
class _MlGauss(Noise):
    """The smooth stand-in for photon noise that masks train under, y = r + √r ε.

    It has the mean and the variance of photon counts, and a gradient in the rate. The difference
    of two rails takes one ε, with the variance r⁺ + r⁻. Source: MLGauss of the paper, arXiv
    2508.01981.
    """

    name = "ml_gauss"
    one_draw = True

    def draw(self, rates: Tensor, random: Random = None, dark: Tensor | float = 0.0) -> Tensor:
        """Rates with normal noise whose variance is the rate."""
        return rates + root(rates) * normal(rates, random)

    def deviation(self, light: Expectation) -> Tensor:
        """√(r⁺ + r⁻)."""
        # The base's formula would round differently
        return root(light.total) * torch.as_tensor(light.gain).rsqrt()


POISSON_LIMIT = 1e6
"""Rate in counts above which Poisson noise is the rounded Gaussian limit.

There the skewness, 1/√rate, is below 1e-3, while Poisson samplers on GPUs are poor for small
differences and wrong at 1e10 (PyTorch issues 86782 and 136750).
"""


@dataclass(frozen=True)
class Poisson(Noise):
    """Photon noise, exact: y ~ Poisson(r).

    Mean and variance are the rate. Above `POISSON_LIMIT` it is the rounded Gaussian limit. Counts
    have no gradient; `gradient` attaches one. Source: PN of the paper, arXiv 2508.01981, and
    docs/notebook/gradients.md.
    """

    name = "poisson"

    def draw(self, rates: Tensor, random: Random = None, dark: Tensor | float = 0.0) -> Tensor:
        """Photon counts, without a gradient."""
        rates = rates.detach()
        exact = torch.poisson(rates.clamp(max=POISSON_LIMIT), generator=random)
        bright = rates > POISSON_LIMIT
        if not bool(bright.any()):
            return exact
        return torch.where(bright, _MlGauss().draw(rates, random).round(), exact)


@dataclass(frozen=True)
class _CameraNoise(Noise):
    """Photons, dark counts and read noise, y ~ Poisson(r + d) − d + σ ε.

    Frames with the light off give the expected dark counts, which are subtracted. A detector has D
    of them in a whole exposure, and d = D t in a frame that takes the share t of it. The variance
    of a readout is r + d + σ². Source: the linear camera of the standard EMVA 1288, in counts.
    """

    sigma: float | Tensor = 1.0  # σ, counts rms per readout
    dark: float | Tensor = 0.0  # D, expected dark counts of a detector in a whole exposure
    name = "camera"
    numbers = ("sigma", "dark")

    def draw(self, rates: Tensor, random: Random = None, dark: Tensor | float = 0.0) -> Tensor:
        """Counts less the expected dark ones."""
        photons = Poisson().draw(rates + dark, random) - dark
        return Gaussian(self.sigma).draw(photons, random)

    def dark_counts(self, time: Tensor | float) -> Tensor | float:
        """D t."""
        return self.dark * time

    def steady_variance(self, light: Expectation) -> Tensor:
        """Sum of r + d + σ² over the rails that are read out."""
        dark = self.dark_counts(light.read.time.sum(dim=0))
        read_noise = self.sigma**2 * light.read.lit.to(light.total.dtype)
        return (light.total * light.gain + dark + read_noise) / light.gain


@dataclass(frozen=True)
class Click(Noise):
    """A detector that fires at most once in each gate, y ~ Binomial(G, 1 − exp(−r / G)).

    A gate has a Poisson number of photons with the mean r / G, and clicks unless it has none. So a
    frame gives at most G clicks, with the mean G p, below the rate, and the variance G p (1 − p),
    where p = 1 − exp(−r / G). Source: A. Kirmani et al., First-photon imaging, Science 343, 58
    (2014).
    """

    gates: int = 1  # G, gates of a frame
    name = "click"
    unbiased = False

    def draw(self, rates: Tensor, random: Random = None, dark: Tensor | float = 0.0) -> Tensor:
        """Clicks, with the gradient of `attach_gradient`."""
        # With the mean G p and the variance G p (1 − p) this gradient is
        # f′(k) [k / p + (G − k) / (1 − p)] / 2, the trapezoid rule for the exact one,
        # ∂ E f / ∂p = G E[f(k + 1) − f(k)] over G − 1 gates: no error if f is at most quadratic
        p = -torch.expm1(-rates / self.gates)
        fixed = p.detach()
        if self.gates == 1:
            draw = torch.rand(fixed.shape, generator=random, device=fixed.device, dtype=fixed.dtype)
            counts = (draw < fixed).to(fixed.dtype)
        else:
            counts = torch.binomial(torch.full_like(fixed, self.gates), fixed, random)
        mean = self.gates * p
        return attach_gradient(counts, mean, mean * (1 - p))

    def mean(self, rates: Tensor) -> Tensor:
        """G p."""
        return -self.gates * torch.expm1(-rates / self.gates)

    def steady_variance(self, light: Expectation) -> Tensor:
        """Sum of G p (1 − p) over the rails."""
        rails = [light.total + light.mean, light.total - light.mean]  # 2 r⁺ and 2 r⁻
        rates = (light.gain / 2 * rail for rail in rails)
        plus, minus = (self.mean(rate) * torch.exp(-rate / self.gates) for rate in rates)
        return (plus + minus) / light.gain


@dataclass(frozen=True)
class _CustomNoise(Noise):
    """A user's own noise: a function from expected counts and a generator to counts.

    Masks train through it if its draws have a gradient in the rates.
    """

    function: NoiseFunction  # counts of expected counts (..., m), drawn with a generator
    path: str = ""  # its import path, if the user gave one
    unbiased = False

    @property
    def name(self) -> str:  # type: ignore[override]
        """Import path of the function."""
        return self.path or noise_name(self.function)

    @property
    def settings(self) -> dict[str, Any]:
        """The fluctuation, the one setting that a camera keeps."""
        return {"fluctuation": self.fluctuation}

    def draw(self, rates: Tensor, random: Random = None, dark: Tensor | float = 0.0) -> Tensor:
        """Counts that the function gives."""
        return self.function(rates, random)

    def check(self, learning: bool) -> None:
        """Raise `InputError` unless it draws counts, and masks can learn under it."""
        rates = torch.arange(1.0, 64.0)[None].requires_grad_(learning)
        try:
            counts = self.draw(rates, torch.Generator())
            if counts.shape != rates.shape or not bool(torch.isfinite(counts).all()):
                raise ValueError("it gives no finite counts of the shape of the rates")
        except Exception as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise InputError(
                f"the noise cannot be used: {reason}; give noise(rates, generator), counts of a "
                "tensor"
            ) from error
        if learning and not (
            counts.requires_grad and bool(torch.autograd.grad(counts.sum(), rates)[0].any())
        ):
            raise InputError(
                "masks cannot learn under this noise, whose draws have no gradient in the rates "
                "(those of torch.poisson have none): draw rates + std * torch.randn, or train "
                "under ml_gauss and test under it"
            )


def make_noise(setting: str | NoiseFunction, /, **numbers: Any) -> Noise:
    """Noise of a name, an import path or a function."""
    if isinstance(setting, Noise):
        noise = setting
    elif not isinstance(setting, str):
        noise = _CustomNoise(setting)
    elif ":" in check_noise(setting):
        noise = _CustomNoise(load_plugin(setting), setting)
    else:
        classes = _NoNoise, Gaussian, Poisson, _MlGauss, _CameraNoise, Click
        kind = {kind.name: kind for kind in classes}[setting]
        names = {field.name for field in fields(kind)}
        noise = kind(**{name: number for name, number in numbers.items() if name in names})
    sigma = numbers.get("sigma", 0.0)
    if not 0 <= sigma < math.inf:
        raise InputError(f"sigma = {sigma!r} of read noise is not allowed: give 0 or more")
    dark = numbers.get("dark", 0.0)
    if dark and ("dark" not in noise.settings or not 0 < dark < math.inf):
        raise InputError(
            f"{dark!r} dark counts of {noise.name} noise are not allowed: give 0 or more, and "
            '`noise="camera"` with them'
        )
    fluctuation = numbers.get("fluctuation", 0.0)
    return replace(noise, fluctuation=fluctuation) if fluctuation else noise


def noise_of(camera: Camera, noise: str | NoiseFunction | None = None) -> Noise:
    """Noise of a camera's counts, or another one with the camera's numbers."""
    setting = camera.noise if noise is None else noise
    dark = camera.dark_counts if find_noise(setting).dark else 0.0
    return make_noise(setting, **{**dict(camera), "dark": dark})


def attach_gradient(counts: Tensor, mean: Tensor, total: Tensor) -> Tensor:
    """Counts (..., m), unchanged, with the gradient of μ + √L ε at the ε that gives them.

    μ is their mean and L their variance. The gradient of E f(y) is exact if f is at most
    quadratic.
    """
    # For a single rail the gradient is f′(k) (1 + k/r) / 2. Since E[k g(k)] = r E[g(k + 1)], its
    # mean is E[f′(k) + f′(k + 1)] / 2: the trapezoid rule for the exact
    # ∂ E f / ∂r = E[f(k + 1) − f(k)] = E ∫₀¹ f′(k + t) dt
    fixed = total.detach()
    slope = torch.where(fixed > 0, (counts - mean.detach()) / (2 * fixed), 0.0)  # ∂(√L ε) / ∂L
    return counts + (mean - mean.detach()) + slope * (total - fixed)


def root(rate: Tensor) -> Tensor:
    """Square root of rates (...); its gradient at 0, a dark rail, is 0 and not infinite."""
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


def normal(like: Tensor, random: Random) -> Tensor:
    """Standard normal numbers in the shape and type of a tensor."""
    return torch.randn(like.shape, generator=random, device=like.device, dtype=like.dtype)


def click_rescaling(
    ratio: Tensor | float, mean: Tensor, photons: Tensor, gates: int
) -> tuple[Tensor, Tensor]:
    """Gain and offset (..., k) that turn clicks into clicks at the light of the training.

    Clicks are not proportional to the light. A readout with G gates and r± expected photons a gate
    on its two rails has, at q times the light of the training, the mean and the variance

        μ(q) = G (e^(−q r⁻) − e^(−q r⁺)),    ν(q) = G Σ± e^(−q r±) (1 − e^(−q r±)) .

    The network reads clicks y as μ(1) + (y − μ(q)) √(ν(1) / ν(q)). The photons r± are the mean
    scene's: over training scenes, y / G has the mean M and all photons a gate have the mean S, so
    r⁺ − r⁻ = 2 arsinh(M e^(S/2) / 2).

    `ratio` (..., 1) is q; `mean` (k,) and `photons` (k,) are clicks and photons, averaged over
    training scenes.
    """
    total = photons / gates  # S
    difference = 2 * torch.asinh(mean / gates * (total / 2).exp() / 2)
    rates = [((total + sign * difference) / 2).clamp(min=0) for sign in (1, -1)]

    def moments(q: Tensor | float) -> tuple[Tensor, Tensor]:
        plus_rate, minus_rate = light = [q * rate for rate in rates]
        # 1 - e^(-x) to all digits, in functions that ONNX has
        halves = [(rate / 2).tanh() for rate in light]
        plus, minus = (2 * half / (1 + half) for half in halves)
        noise = plus * (-plus_rate).exp() + minus * (-minus_rate).exp()
        return gates * (plus - minus), noise.clamp(min=1e-30)  # dark readouts have none

    trained_mean, trained_noise = moments(1.0)
    mean_now, noise_now = moments(ratio)
    # where nearly all gates click, or none, clicks tell nothing, and a gain would blow up rounding
    gain = (trained_noise / noise_now).sqrt().clamp(max=100.0)
    return gain, trained_mean - mean_now * gain

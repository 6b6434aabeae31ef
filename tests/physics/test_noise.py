"""Each noise has the mean and variance it claims, and a gradient where masks train through it."""

import math

import pytest
import torch
from torch.nn.functional import softplus

from conftest import assert_moments, generator
from deepfsi.physics import Poisson, detection
from deepfsi.physics import noise as noise_module

DRAWS = 100_000
ONE_RAIL = detection.Readouts(
    torch.tensor([[True], [False]]), torch.tensor([[1.0], [0.0]]), torch.zeros(2, 1).long()
)
LIMIT = noise_module.POISSON_LIMIT
DEVICES = ["cpu", *["cuda"] * torch.cuda.is_available()]
RATES = [0, 1e-3, 1, 1e3, math.nextafter(LIMIT, 0), LIMIT, math.nextafter(LIMIT, 1e9), 1e8, 1e10]


def drawn(name: str, rate: float, sigma: float = 1.0, dtype=torch.float64) -> torch.Tensor:
    rates = torch.full((DRAWS,), rate, dtype=dtype)
    return noise_module.make_noise(name, sigma=sigma).draw(rates, generator(4))


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("name", ["poisson", "ml_gauss"])
@pytest.mark.parametrize("device", DEVICES)
def test_photon_noise_has_the_rate_as_mean_and_variance(name, rate, device):
    rates = torch.full((DRAWS,), rate, dtype=torch.float64, device=device)
    seeded = torch.Generator(device).manual_seed(4)
    counts = noise_module.make_noise(name).draw(rates, seeded).cpu()
    assert_moments(counts, rate, rate, poisson=name == "poisson", rounding=0.5)


@pytest.mark.parametrize("rate", [0, 1e-3, 1, 1e3, 1e8])
@pytest.mark.parametrize("sigma", [1.0, 7.0])
def test_read_noise_has_a_constant_variance(rate, sigma):
    assert_moments(drawn("gaussian", rate, sigma), rate, sigma**2, poisson=False, rounding=1e-6)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_photon_counts_are_whole_and_never_negative(rate, dtype):
    counts = drawn("poisson", rate, dtype=dtype)
    assert counts.dtype == dtype
    assert (counts == counts.round()).all()
    assert (counts >= 0).all()


@pytest.mark.parametrize("rate", [0.05, 1.0, 4.0])
def test_faint_counts_follow_poissons_law(rate):
    counts = drawn("poisson", rate)
    for k in range(4):
        share = math.exp(-rate) * rate**k / math.factorial(k)
        found = float((counts == k).double().mean())
        assert abs(found - share) <= 5 * math.sqrt(share * (1 - share) / DRAWS)


@pytest.mark.parametrize("rate", [1e3, LIMIT, 1e8, 1e10])
@pytest.mark.parametrize("name", ["poisson", "ml_gauss"])
def test_float32_keeps_mean_and_variance_up_to_1e10(name, rate):
    spacing = 2.0 ** max(math.floor(math.log2(rate)) - 23, -23)
    counts = drawn(name, rate, dtype=torch.float32)
    assert_moments(counts, rate, rate, poisson=name == "poisson", rounding=max(spacing, 1.0) / 2)


def slopes(name: str, rate: float, function) -> torch.Tensor:
    """Gradient of function(y) in the rate of one rail, one for each draw."""
    rates = torch.full((DRAWS,), rate, dtype=torch.float64, requires_grad=True)
    kind = noise_module.make_noise(name)
    y = kind.draw(rates, generator())
    if kind.draws_rails:
        y = kind.gradient(y, noise_module.Expectation(rates, rates, ONE_RAIL))
    function(y).sum().backward()
    return rates.grad


def assert_mean(samples: torch.Tensor, mean: float) -> None:
    assert abs(samples.mean() - mean) <= 5 * float(samples.std()) / math.sqrt(len(samples))


@pytest.mark.parametrize("rate", [0.05, 0.5, 2.0])
def test_counts_of_one_rail_follow_their_rate_by_the_trapezoid_rule(rate):
    """∂ E f / ∂r is E ∫₀¹ f′(k + t) dt; counts summed over, as far as they are at all likely."""
    counts = torch.arange(60, dtype=torch.float64, requires_grad=True)
    law = torch.exp(counts * math.log(rate) - rate - torch.lgamma(counts + 1)).detach()
    losses = softplus(counts)
    (slope,) = torch.autograd.grad(losses.sum(), counts)
    found = slopes("poisson", rate, softplus)
    assert_mean(found, float(law[:-1] @ (slope[:-1] + slope[1:]) / 2))

    exact, straight = float(law[:-1] @ losses.detach().diff()), float(law @ slope)
    assert abs(found.mean() - exact) < abs(straight - exact) / 4


@pytest.mark.parametrize(("plus", "minus"), [(0.3, 0.9), (2.0, 0.5), (40.0, 40.0), (3.0, 0.0)])
def test_counts_of_two_rails_follow_mean_and_variance(plus, minus):
    """E[y²] = (r⁺ − r⁻)² + r⁺ + r⁻, whose slopes are ±2 (r⁺ − r⁻) + 1."""
    rates = torch.tensor([plus, minus], dtype=torch.float64).repeat(DRAWS, 1).requires_grad_()
    mean, light = rates[:, 0] - rates[:, 1], rates.sum(dim=1)
    counts = Poisson().draw(rates, generator())
    y = noise_module.attach_gradient(counts[:, 0] - counts[:, 1], mean, light)
    assert torch.equal(y, counts[:, 0] - counts[:, 1])
    y.square().sum().backward()
    for slope, sign in zip(rates.grad.T, (1, -1), strict=True):
        assert_mean(slope, 2 * sign * (plus - minus) + 1)


@pytest.mark.parametrize("name", ["ml_gauss", "poisson"])
def test_a_dark_rail_has_a_finite_gradient(name):
    assert (slopes(name, 0.0, torch.clone) == 1).all()


def test_gradients_equal_finite_differences():
    rate = torch.tensor([1e-2, 0.3, 1.0, 40.0, 1e3], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda r: noise_module.MlGauss().draw(r, generator()).square(), rate
    )
    assert torch.autograd.gradcheck(
        lambda r: noise_module.Gaussian(2.0).draw(r, generator()).square(), rate
    )


ALL = [
    *(noise_module.make_noise(name) for name in ("none", "poisson", "ml_gauss", "click")),
    noise_module.make_noise("gaussian", sigma=3.0),
    noise_module.make_noise("camera", sigma=2.0, dark=40.0),
    noise_module.make_noise("click", gates=5),
]
FLUCTUATING = [
    *(noise_module.make_noise(name, fluctuation=0.3) for name in ("none", "poisson", "ml_gauss")),
    noise_module.make_noise("gaussian", sigma=3.0, fluctuation=0.3),
    noise_module.make_noise("camera", sigma=2.0, dark=40.0, fluctuation=0.3),
]
READ = detection.Readouts(
    torch.tensor([[True, True, False], [True, False, True]]),
    torch.tensor([[0.5, 0.3, 0.0], [0.1, 0.0, 0.1]], dtype=torch.float64),
    torch.tensor([[0, 2, 4], [1, 3, 5]]),
)
"""Both rails of a feature are read out, the positive one alone, and the negative one alone."""


@pytest.mark.parametrize("noise", [*ALL, *FLUCTUATING], ids=repr)
@pytest.mark.parametrize("gain", [1.0, 8.0])
def test_features_have_the_mean_and_the_variance_that_a_noise_claims(noise, gain):
    """Of two rails, to five standard errors; in units of the gain the variance is over it twice."""
    rates = torch.tensor([[0.7, 4.0, 0.0], [2.0, 0.0, 0.3]], dtype=torch.float64)
    every = rates.expand(DRAWS, 2, 3)
    dark = noise.dark_counts(READ.time)
    plus, minus = noise.sample(every, READ, dark, generator(2)).unbind(dim=1)
    mean = torch.where(READ.active, noise.mean(rates), 0.0)
    total, difference = (rates[0] + rates[1]) / gain, (rates[0] - rates[1]) / gain
    light = noise_module.Expectation(difference, total, READ, gain)
    variance = noise.variance(light) / gain
    drawn = (plus - minus) / gain
    fourth = (drawn - drawn.mean(dim=0)).pow(4).mean(dim=0) - drawn.var(dim=0).square()
    error = 5 * (fourth.clamp(min=0) / DRAWS).sqrt() + 1e-12
    assert ((drawn.var(dim=0) - variance).abs() <= error).all()
    centre = (mean[0] - mean[1]) / gain
    assert ((drawn.mean(dim=0) - centre).abs() <= 5 * (variance / DRAWS).sqrt() + 1e-12).all()
    if not noise.draws_rails:
        assert torch.allclose(noise.deviation(light).square(), variance)


@pytest.mark.parametrize("noise", [*ALL, *FLUCTUATING], ids=repr)
def test_the_slope_of_a_noise_is_that_of_its_mean(noise):
    rates = torch.logspace(-3, 2, 20, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(noise.mean(rates).sum(), rates)
    assert torch.allclose(noise.slope(rates), slope)


@pytest.mark.parametrize("noise", ALL, ids=repr)
def test_trainings_side_by_side_have_the_numbers_of_each(noise):
    both = type(noise).side_by_side([noise, noise], torch.device("cpu"))
    for name, number in noise.settings.items():
        kept = both.of_jobs(0).settings[name]
        assert kept == number if isinstance(number, int) else kept.tolist() == [number]

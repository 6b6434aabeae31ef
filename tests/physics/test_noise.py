"""Each noise has the mean and variance it claims, and a gradient where masks train through it."""

import math

import pytest
import torch
from torch.nn.functional import softplus

from conftest import assert_moments, generator
from deepfsi.base import InputError
from deepfsi.physics import Poisson, root
from deepfsi.physics.detection import Readouts
from deepfsi.physics.noise import (
    POISSON_LIMIT,
    Expectation,
    Gaussian,
    MlGauss,
    attach_gradient,
    make_noise,
)

DRAWS = 100_000
ONE_RAIL = Readouts(
    torch.tensor([[True], [False]]), torch.tensor([[1.0], [0.0]]), torch.zeros(2, 1).long()
)
LIMIT = POISSON_LIMIT
DEVICES = ["cpu", *["cuda"] * torch.cuda.is_available()]
RATES = [0, 1e-3, 1, 1e3, math.nextafter(LIMIT, 0), LIMIT, math.nextafter(LIMIT, 1e9), 1e8, 1e10]


def drawn(name: str, rate: float, sigma: float = 1.0, dtype=torch.float64) -> torch.Tensor:
    rates = torch.full((DRAWS,), rate, dtype=dtype)
    return make_noise(name, sigma=sigma).draw(rates, generator(4))


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("name", ["poisson", "ml_gauss"])
@pytest.mark.parametrize("device", DEVICES)
def test_photon_noise_has_the_rate_as_mean_and_variance(name, rate, device):
    rates = torch.full((DRAWS,), rate, dtype=torch.float64, device=device)
    seeded = torch.Generator(device).manual_seed(4)
    counts = make_noise(name).draw(rates, seeded).cpu()
    assert_moments(counts, rate, rate, poisson=name == "poisson", rounding=0.5)


@pytest.mark.parametrize("rate", [0, 1e-3, 1, 1e3, 1e8])
@pytest.mark.parametrize("sigma", [1.0, 7.0])
def test_read_noise_has_a_constant_variance(rate, sigma):
    assert_moments(drawn("gaussian", rate, sigma), rate, sigma**2, poisson=False, rounding=1e-6)


@pytest.mark.parametrize("rate", RATES)
def test_no_noise_changes_nothing(rate):
    assert (drawn("none", rate) == rate).all()


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_photon_counts_are_whole_and_never_negative(rate, dtype):
    counts = drawn("poisson", rate, dtype=dtype)
    assert counts.dtype == dtype
    assert (counts == counts.round()).all()
    assert (counts >= 0).all()


@pytest.mark.parametrize("name", ["poisson", "ml_gauss"])
def test_a_dark_rail_has_no_photon_noise(name):
    assert (drawn(name, 0.0) == 0).all()


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


def test_float32_loses_single_photons_above_2_to_the_24():
    assert torch.tensor(2.0**24) + 1 == 2.0**24
    rate = torch.tensor(1e10)
    spacing = torch.nextafter(rate, torch.tensor(math.inf)) - rate
    assert spacing == 1024  # at most 512 counts of error, 296 rms, against a photon noise of 1e5
    assert spacing / math.sqrt(12) < rate.sqrt() / 300


def test_bright_and_faint_rates_mix():
    rates = torch.tensor([0.0, 5.0, 1e3, 1e7, 1e10], dtype=torch.float64).repeat(20_000, 1)
    for column, rate in zip(Poisson().draw(rates, generator()).T, rates[0], strict=True):
        assert_moments(column, float(rate), float(rate), poisson=True, rounding=0.5)


@pytest.mark.parametrize("name", ["poisson", "ml_gauss", "gaussian"])
def test_the_same_generator_repeats_and_another_differs(name):
    rate = torch.full((1000,), 50.0)
    first, again, other = (make_noise(name).draw(rate, generator(s)) for s in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_readouts_are_independent():
    pair = drawn("poisson", 100.0).view(-1, 2)
    correlation = torch.corrcoef(pair.T)[0, 1]
    assert abs(correlation) < 5 / math.sqrt(len(pair))


def test_trap_exact_poisson_gives_the_rate_no_gradient():
    """Why masks must be trained with ml_gauss, or through `attach_gradient`."""
    rate = torch.full((100,), 50.0, requires_grad=True)
    torch.poisson(rate).square().sum().backward()
    assert (rate.grad == 0).all()
    assert not Poisson().draw(rate).requires_grad


def test_trap_torch_normal_gives_no_gradient():
    rate = torch.full((100,), 50.0, requires_grad=True)
    assert not torch.normal(rate.detach(), rate.detach().sqrt()).requires_grad
    MlGauss().draw(rate, generator()).square().sum().backward()
    assert (rate.grad != 0).all()


def slopes(name: str, rate: float, function) -> torch.Tensor:
    """Gradient of function(y) in the rate of one rail, one for each draw."""
    rates = torch.full((DRAWS,), rate, dtype=torch.float64, requires_grad=True)
    kind = make_noise(name)
    y = kind.draw(rates, generator())
    if kind.counting:
        y = kind.gradient(y, Expectation(rates, rates, ONE_RAIL))
    function(y).sum().backward()
    return rates.grad


def assert_mean(samples: torch.Tensor, mean: float) -> None:
    assert abs(samples.mean() - mean) <= 5 * float(samples.std()) / math.sqrt(len(samples))


@pytest.mark.parametrize("rate", [0.01, 1.0, 1e4, 1e7])
@pytest.mark.parametrize("name", ["ml_gauss", "poisson"])
def test_photon_noise_has_the_gradient_of_mean_and_variance(name, rate):
    """E[y²] = rate² + rate, whose slope is 2 rate + 1."""
    assert_mean(slopes(name, rate, torch.square), 2 * rate + 1)
    assert_mean(slopes(name, rate, torch.clone), 1)


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
    y = attach_gradient(counts[:, 0] - counts[:, 1], mean, light)
    assert torch.equal(y, counts[:, 0] - counts[:, 1])
    y.square().sum().backward()
    for slope, sign in zip(rates.grad.T, (1, -1), strict=True):
        assert_mean(slope, 2 * sign * (plus - minus) + 1)


def test_counts_follow_as_ml_gauss_does_at_the_same_noise():
    rate = torch.tensor([0.3, 4.0, 1e3, 1e8], dtype=torch.float64, requires_grad=True)
    counts = Poisson().draw(rate, generator())
    epsilon = ((counts - rate) / rate.sqrt()).detach()
    (ours,) = torch.autograd.grad(attach_gradient(counts, rate, rate).sum(), rate)
    (theirs,) = torch.autograd.grad((rate + root(rate) * epsilon).sum(), rate)
    assert torch.allclose(ours, theirs, rtol=1e-12)


@pytest.mark.parametrize("name", ["ml_gauss", "poisson"])
def test_a_dark_rail_has_a_finite_gradient(name):
    assert (slopes(name, 0.0, torch.clone) == 1).all()


def test_gradients_equal_finite_differences():
    rate = torch.tensor([1e-2, 0.3, 1.0, 40.0, 1e3], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda r: MlGauss().draw(r, generator()).square(), rate)
    assert torch.autograd.gradcheck(lambda r: Gaussian(2.0).draw(r, generator()).square(), rate)


def test_the_root_of_a_dark_rail_has_no_slope():
    rate = torch.tensor([0.0, 4.0], requires_grad=True)
    root(rate).sum().backward()
    assert rate.grad.tolist() == [0.0, 0.25]


def test_an_unknown_noise_names_the_closest():
    with pytest.raises(InputError, match="did you mean 'poisson'"):
        make_noise("poison")


ALL = [
    *(make_noise(name) for name in ("none", "poisson", "ml_gauss", "click")),
    make_noise("gaussian", sigma=3.0),
    make_noise("camera", sigma=2.0, dark=40.0),
    make_noise("click", gates=5),
]
FLUCTUATING = [
    *(make_noise(name, fluctuation=0.3) for name in ("none", "poisson", "ml_gauss")),
    make_noise("gaussian", sigma=3.0, fluctuation=0.3),
    make_noise("camera", sigma=2.0, dark=40.0, fluctuation=0.3),
]
READ = Readouts(
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
    light = Expectation(difference, total, READ, gain)
    variance = noise.variance(light) / gain
    drawn = (plus - minus) / gain
    fourth = (drawn - drawn.mean(dim=0)).pow(4).mean(dim=0) - drawn.var(dim=0).square()
    error = 5 * (fourth.clamp(min=0) / DRAWS).sqrt() + 1e-12
    assert ((drawn.var(dim=0) - variance).abs() <= error).all()
    centre = (mean[0] - mean[1]) / gain
    assert ((drawn.mean(dim=0) - centre).abs() <= 5 * (variance / DRAWS).sqrt() + 1e-12).all()
    if not noise.counting:
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

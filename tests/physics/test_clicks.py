"""Clicks of gated detectors: their law, their gradient, and where they are no photons."""

import itertools
import math

import pytest
import torch
from torch import Tensor
from torch.distributions import Binomial

from conftest import assert_moments, generator
from deepfsi.physics import noise
from deepfsi.physics.noise import click_rescaling

DRAWS = 200_000


@pytest.mark.parametrize("gates", [1, 3, 50, 100_000])
@pytest.mark.parametrize("rate", [0.0, 1e-3, 0.3, 2.0, 40.0, 1e4])
def test_clicks_are_binomial_of_the_chance_that_a_gate_has_photons(rate, gates):
    """Number by number, in the mean, and in the variance; of many gates it is Poisson's law."""
    rates = torch.full((DRAWS,), rate, dtype=torch.float64)
    clicks = noise.Click(gates)(rates, generator())
    assert (clicks == clicks.round()).all()
    assert (clicks.min() >= 0) & (clicks.max() <= gates)
    chance = -math.expm1(-rate / gates)
    mean, variance = gates * chance, gates * chance * (1 - chance)
    assert_moments(clicks, mean, variance, poisson=True, rounding=5 * variance / DRAWS + 1e-12)
    assert float(noise.Click(gates).mean(rates[:1])) == pytest.approx(mean, rel=1e-12)
    numbers = torch.arange(min(gates, 60) + 1, dtype=torch.float64)
    shares = Binomial(gates, torch.tensor(chance).double()).log_prob(numbers).exp()
    if rate < gates / 10 and gates > 1000:
        poisson = torch.exp(numbers * math.log(rate or 1e-30) - rate - torch.lgamma(numbers + 1))
        assert (shares - poisson).abs().max() <= rate**2 / gates + 1e-9
    found = torch.stack([(clicks == k).double().mean() for k in numbers])
    error = 5 * (shares * (1 - shares) / DRAWS).sqrt() + 25 / DRAWS
    assert ((found - shares).abs() <= error).all()


def square(k: Tensor) -> Tensor:
    """At most quadratic in each of three clicks, and of their products."""
    return 3 * k[..., 0] * k[..., 1] - 2 * k[..., 2].square() + k[..., 1] * k[..., 2] + k[..., 0]


def of_all_outcomes(function, rates: Tensor, gates: int) -> Tensor:
    """Slopes (3,) in the rates of the mean of a function over all outcomes of three clicks."""
    outcomes = torch.tensor(list(itertools.product(range(gates + 1), repeat=3))).double()
    rates = rates.clone().requires_grad_()
    law = Binomial(gates, -torch.expm1(-rates / gates)).log_prob(outcomes).sum(dim=1).exp()
    return torch.autograd.grad(law @ function(outcomes), rates)[0]


def drawn(function, rates: Tensor, gates: int) -> Tensor:
    """Gradients (draws, 3) of a function of clicks that are drawn."""
    every = rates.expand(DRAWS, -1).clone().requires_grad_()
    function(noise.Click(gates)(every, generator())).sum().backward()
    return every.grad


every_rate = pytest.mark.parametrize("rates", [(0.05, 0.5, 2.0), (0.3, 0.3, 4.0)])


@every_rate
@pytest.mark.parametrize("gates", [1, 2])
def test_the_gradient_of_a_quadratic_is_that_of_its_exact_mean(rates, gates):
    rates = torch.tensor(rates, dtype=torch.float64)
    found, wanted = drawn(square, rates, gates), of_all_outcomes(square, rates, gates)
    error = 5 * found.std(dim=0) / math.sqrt(DRAWS) + 1e-6
    assert ((found.mean(dim=0) - wanted).abs() <= error).all()


@pytest.mark.parametrize("rate", [0.0, 1e-6, 30.0, 1e6])
@pytest.mark.parametrize("gates", [1, 4])
def test_dark_and_saturated_detectors_have_a_finite_gradient(rate, gates):
    rates = torch.full((1000,), rate, requires_grad=True)
    noise.Click(gates)(rates, generator()).sum().backward()
    assert torch.isfinite(rates.grad).all()


@pytest.mark.parametrize("gates", [1, 3])
@pytest.mark.parametrize("ratio", [0.1, 0.5, 3.0])
def test_clicks_of_any_light_have_mean_and_noise_of_the_training(gates, ratio):
    """Of known photons on two rails: five standard errors of 2e5 exposures, of clicks drawn."""
    generator, plus = torch.Generator().manual_seed(3), torch.tensor([0.3, 1.2, 2.0])
    minus, n = torch.tensor([0.0, 0.9, 0.1]), 200_000

    def clicks(q):
        rails = [1 - torch.exp(-q * rate / gates) for rate in (plus, minus)]
        one, other = (
            torch.binomial(torch.full((n, 3), float(gates)), p.expand(n, 3), generator=generator)
            for p in rails
        )
        return one - other

    mean = gates * (torch.exp(-minus / gates) - torch.exp(-plus / gates))
    gain, offset = click_rescaling(ratio, mean, plus + minus, gates)
    seen, wanted = clicks(ratio) * gain + offset, clicks(1.0)
    error = (seen.var(dim=0) / n).sqrt() + (wanted.var(dim=0) / n).sqrt()
    assert bool(((seen.mean(dim=0) - wanted.mean(dim=0)).abs() < 5 * error).all())
    torch.testing.assert_close(seen.std(dim=0), wanted.std(dim=0), rtol=0.02, atol=0)


def test_detectors_that_nearly_always_click_gain_a_hundred_at_most():
    gain, offset = click_rescaling(50.0, torch.tensor([0.0, 0.5]), torch.tensor([40.0, 2.0]), 1)
    assert gain.tolist() == [100, 100]
    assert torch.isfinite(offset).all()
    dark, none = click_rescaling(3.0, torch.zeros(1), torch.zeros(1), 2)
    assert (dark.item(), none.item()) == (1, 0)

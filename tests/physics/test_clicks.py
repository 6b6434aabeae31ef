"""Clicks of gated detectors: their law, their gradient, and where they are no photons."""

import itertools
import math

import pytest
import torch

from conftest import generator
from deepfsi.physics import TrainingNoise, detection, noise
from deepfsi.physics.noise import Click

DRAWS = 200_000
BOTH = detection.Readouts(
    torch.ones(2, 1, 2, dtype=torch.bool), torch.ones(2, 1, 2), torch.arange(4).view(2, 1, 2)
)


def drawn(rate: float, gates: int) -> torch.Tensor:
    return Click(gates)(torch.full((DRAWS,), rate, dtype=torch.float64), generator())


@pytest.mark.parametrize("gates", [1, 3, 50])
@pytest.mark.parametrize("rate", [0.0, 1e-3, 0.3, 2.0, 40.0, 1e4])
def test_clicks_have_mean_and_variance_of_the_closed_form(rate, gates):
    chance = -math.expm1(-rate / gates)
    mean, variance = gates * chance, gates * chance * (1 - chance)
    clicks = drawn(rate, gates)
    assert (clicks == clicks.round()).all()
    assert (clicks.min() >= 0) & (clicks.max() <= gates)
    assert abs(clicks.mean() - mean) <= 5 * math.sqrt(variance / DRAWS) + 1e-12
    fourth = variance * (1 + (3 * gates - 6) * chance * (1 - chance))
    error = 5 * math.sqrt(max(fourth - variance**2, 0) / DRAWS) + 25 * variance / DRAWS
    assert abs(clicks.var() - variance) <= error + 1e-12
    rates = torch.tensor([rate], dtype=torch.float64)
    assert float(Click(gates).mean(rates)) == pytest.approx(mean, rel=1e-12)
    alone = noise.Expectation(
        rates, rates, detection.Readouts(torch.ones(1, 1), torch.ones(1, 1), torch.zeros(1, 1))
    )
    assert float(Click(gates).variance(alone)) == pytest.approx(variance, rel=1e-6, abs=1e-12)


def test_clicks_of_many_gates_are_poisson_counts():
    """Of 1e5 gates and a rate of 3 the laws differ by less than r² / G in all."""
    clicks = drawn(3.0, 100_000)
    for k in range(7):
        share = math.exp(-3.0) * 3.0**k / math.factorial(k)
        error = 5 * math.sqrt(share / DRAWS) + 9e-5
        assert abs(float((clicks == k).double().mean()) - share) <= error


def losses(outcomes: torch.Tensor) -> torch.Tensor:
    """A loss of clicks (..., 3) that is not quadratic: cross entropy of a small network."""
    weights = torch.tensor([[1.5, -2.0, 0.7], [0.3, 1.0, -1.2]], dtype=torch.float64)
    hidden = torch.tanh(outcomes @ weights.T / 2 + torch.tensor([0.2, -0.5], dtype=torch.float64))
    return torch.nn.functional.softplus(hidden[..., 0] - 2 * hidden[..., 1])


def expectation(function, rates: torch.Tensor, gates: int) -> torch.Tensor:
    """Mean of a function over all outcomes of clicks of three rates."""
    chance = 1 - torch.exp(-rates / gates)
    total = torch.zeros((), dtype=torch.float64)
    for clicks in itertools.product(range(gates + 1), repeat=len(rates)):
        k = torch.tensor(clicks, dtype=torch.float64)
        ways = math.prod(math.comb(gates, c) for c in clicks)
        total = total + ways * (chance**k * (1 - chance) ** (gates - k)).prod() * function(k)
    return total


def finite_differences(function, rates: torch.Tensor, gates: int, step=1e-5) -> torch.Tensor:
    moves = step * torch.eye(len(rates), dtype=torch.float64)
    ends = [expectation(function, rates + sign * move, gates) for move in moves for sign in (1, -1)]
    return torch.stack(ends).view(-1, 2).diff(dim=1).squeeze(1) / (-2 * step)


def slopes(function, rates: torch.Tensor, gates: int) -> torch.Tensor:
    """Gradients (draws, 3) of a function of clicks that are drawn."""
    every = rates.expand(DRAWS, -1).clone().requires_grad_()
    function(Click(gates)(every, generator())).sum().backward()
    return every.grad


def square(k: torch.Tensor) -> torch.Tensor:
    """At most quadratic in each of three clicks, and of their products."""
    return 3 * k[..., 0] * k[..., 1] - 2 * k[..., 2].square() + k[..., 1] * k[..., 2] + k[..., 0]


@pytest.mark.parametrize("gates", [1, 2])
@pytest.mark.parametrize("rates", [(0.05, 0.5, 2.0), (0.3, 0.3, 4.0)])
def test_the_gradient_of_a_quadratic_is_that_of_its_exact_mean(rates, gates):
    """Against finite differences of the mean over all outcomes, to five standard errors."""
    rates = torch.tensor(rates, dtype=torch.float64)
    found, wanted = slopes(square, rates, gates), finite_differences(square, rates, gates)
    error = 5 * found.std(dim=0) / math.sqrt(DRAWS) + 1e-6
    assert ((found.mean(dim=0) - wanted).abs() <= error).all()


@pytest.mark.parametrize("rates", [(0.05, 0.5, 2.0), (0.3, 0.3, 4.0)])
def test_of_another_loss_it_is_nearer_than_straight_through(rates):
    """The trapezoid rule is not exact, but nearer than a plain slope, by far more than chance."""
    rates = torch.tensor(rates, dtype=torch.float64)
    wanted = finite_differences(losses, rates, 1)
    found = slopes(losses, rates, 1).mean(dim=0)
    every = torch.tensor(list(itertools.product((0.0, 1.0), repeat=3)), dtype=torch.float64)
    every.requires_grad_()
    (slope,) = torch.autograd.grad(losses(every).sum(), every)
    chance = 1 - torch.exp(-rates)
    law = torch.where(every.detach() == 1, chance, 1 - chance).prod(dim=1)
    straight = (law @ slope) * (1 - chance)
    assert (found - wanted).norm() < 0.9 * (straight - wanted).norm()


@pytest.mark.parametrize("rate", [0.0, 1e-6, 30.0, 1e6])
@pytest.mark.parametrize("gates", [1, 4])
def test_dark_and_saturated_detectors_have_a_finite_gradient(rate, gates):
    rates = torch.full((1000,), rate, requires_grad=True)
    Click(gates)(rates, generator()).sum().backward()
    assert torch.isfinite(rates.grad).all()


def test_features_of_clicks_have_their_moments():
    """Of two rails: the mean of the difference, and the sum of the variances."""
    every = TrainingNoise.of([Click(2)], [4.0], [0], torch.device("cpu"))
    mean, total = torch.tensor([[0.4, -0.2]]), torch.tensor([[0.9, 0.5]])
    drawn = every.counted(mean.expand(DRAWS, 1, 2), total.expand(DRAWS, 1, 2), BOTH).double()
    rates = torch.stack([total + mean, total - mean]) * 2.0
    chance = 1 - torch.exp(-rates / 2)
    wanted, spread = 2 * chance, 2 * chance * (1 - chance)
    variance = spread.sum(dim=0) / 16
    error = 5 * (variance / DRAWS).sqrt()
    assert ((drawn.mean(dim=0) - (wanted[0] - wanted[1]) / 4).abs() <= error).all()
    assert ((drawn.var(dim=0) / variance - 1).abs() < 5 * math.sqrt(2 / DRAWS)).all()

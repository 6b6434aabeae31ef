"""Designs for detectors that click: counts that are clicks, and what takes photons alone."""

import pytest
import torch

from conftest import quick
from deepfsi import evaluate
from deepfsi.physics.noise import click_rescaling

FEW = 60.0


@pytest.fixture(scope="module")
def clicking(digits):
    return quick(digits, noise="click", gates=2, rails="single", photons=FEW)


def test_counts_of_a_result_are_clicks_and_it_says_what_arrives(clicking, digits):
    """Against the closed form of the test scenes' rates."""
    [result] = evaluate(clicking, digits, FEW, draws=1)
    rates = clicking.exposure.rates(clicking.scanner(), torch.from_numpy(digits.x_test)) * FEW
    clicks = 2 * (1 - torch.exp(-rates.double() / 2))
    assert result.noise == "click"
    assert result.counts == pytest.approx(float(clicks.flatten(1).sum(dim=1).mean()), rel=1e-4)
    assert result.arriving == pytest.approx(float(rates.flatten(1).sum(dim=1).mean()), rel=1e-4)
    assert result.counts < result.arriving
    [photons] = evaluate(clicking, digits, FEW, noise="poisson", draws=1)
    assert photons.counts == photons.arriving == pytest.approx(result.arriving, rel=1e-6)


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

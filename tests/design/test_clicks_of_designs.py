"""Designs for detectors that click: counts that are clicks, and what takes photons alone."""

import pytest
import torch

from conftest import quick
from deepfsi import evaluate

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

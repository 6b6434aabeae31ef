"""Designs for detectors that click: counts that are clicks, and what takes photons alone."""

import numpy as np
import pytest
import torch

from conftest import PHOTONS, quick, same
from deepfsi.design.artifact import Design
from deepfsi.design.evaluation import evaluate
from deepfsi.errors import InputError

FEW = 60.0


@pytest.fixture(scope="module")
def clicking(digits):
    return quick(digits, noise="click", gates=2, rails="single", photons=FEW)


def test_counts_of_a_result_are_clicks_and_it_says_what_arrives(clicking, digits):
    """Against the closed form of the test scenes' rates."""
    [result] = evaluate(clicking, digits, FEW, draws=1)
    rates = clicking.rates(clicking.scanner(), torch.from_numpy(digits.x_test)) * FEW
    clicks = 2 * (1 - torch.exp(-rates.double() / 2))
    assert result.noise == "click"
    assert result.counts == pytest.approx(float(clicks.flatten(1).sum(dim=1).mean()), rel=1e-4)
    assert result.arriving == pytest.approx(float(rates.flatten(1).sum(dim=1).mean()), rel=1e-4)
    assert result.counts < result.arriving
    [photons] = evaluate(clicking, digits, FEW, noise="poisson", draws=1)
    assert photons.counts == photons.arriving == pytest.approx(result.arriving, rel=1e-6)


def test_features_are_clicks_at_any_budget(clicking, digits):
    """Clicks are not in proportion to the light: the same clicks are the same inputs."""
    clicks = np.random.default_rng(0).integers(0, 3, (5, clicking.masks))
    with torch.no_grad():
        every = [
            clicking.logits(torch.from_numpy(clicks).float(), torch.full((5, 1), photons))
            for photons in (FEW, 10 * FEW)
        ]
    assert torch.allclose(*every)
    results = evaluate(clicking, digits, [FEW / 10, FEW, 10 * FEW], draws=1)
    assert results[0].accuracy < results[1].accuracy
    assert results[2].counts < 10 * results[1].counts


def test_clicks_train_features_of_mean_0_and_variance_1(clicking, digits):
    scanner = clicking.scanner(clicking.camera.detector_noise)
    rates = clicking.rates(scanner, torch.from_numpy(digits.x_train)).float()
    generator = torch.Generator().manual_seed(1)
    seen = scanner.read((rates * FEW).repeat(10, 1, 1), generator)[:, 0] / FEW
    scaled = ((seen - clicking.mean) / clicking.std).double()
    share = 1 / len(scaled) + 1 / len(digits.x_train)
    assert scaled.mean(dim=0).abs().max() <= 5 * share**0.5


def test_a_file_keeps_the_gates(clicking, tmp_path):
    restored = Design.load(clicking.save(tmp_path / "clicks.safetensors"))
    assert restored.gates == restored.camera.gates == 2
    assert same(restored, clicking)


def test_more_counts_than_gates_are_no_clicks(clicking):
    photons = np.full((3, clicking.masks), 7)
    with pytest.raises(InputError, match="at most 2 times in a frame, and a readout has 7 counts"):
        clicking.classify(photons, FEW)
    assert clicking.classify(np.full(clicking.masks, 2), FEW).shape == (10,)


def test_no_distribution_is_known_of_clicks(clicking):
    with pytest.raises(InputError, match="it takes photons, 100 scenes"):
        clicking.consistency(np.ones((3, clicking.masks)), FEW)


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"looks": 2, "camera": "dmd"}, "several looks are for photon noise: leave click"),
        ({"span": 10.0}, "trained under ml_gauss: leave out click noise"),
        ({"design": "adaptive", "camera": "dmd"}, "adaptive masks are for photon counts"),
    ],
)
def test_what_is_of_photons_refuses_clicks(digits, settings, match):
    with pytest.raises(InputError, match=match):
        quick(digits, noise="click", photons=PHOTONS, **settings)

"""Designs of scenes that pass a pattern: what is learned, and where scenes are in a test."""

import pytest
import torch

import deepfsi
from conftest import RECIPE, generator, synthetic

pytestmark = pytest.mark.usefixtures("all_trained_once")

PASSING = {"bins": 6, "speed": 1.5, "jitter": 1.0, "speed_jitter": 0.05}


@pytest.fixture(scope="module")
def data():
    return synthetic((4, 6))


@pytest.fixture(scope="module")
def learned(data):
    training = {**RECIPE, "epochs": 30, "mask_lr": 0.2, "hidden": (32,), "lr": 1e-2}
    return deepfsi.learn(data, photons=1e4, exposure=PASSING, training=training)


def test_a_learned_pattern_reads_what_a_blind_guess_does_not(data, learned):
    [result] = deepfsi.evaluate(learned, data, 1e4)
    assert result.accuracy > 0.6  # of three classes
    assert result.counts <= 1e4 * data.x_test.sum() / len(data.x_test) / learned.summed_reflectance
    assert result.counts / 1e4 == pytest.approx(result.throughput, rel=0.1)
    assert learned.exposure.light == "equal-dwell"
    assert learned.masks == 6
    # P is W + T v unless given
    assert learned.exposure.pattern.shape == (4, 6 + 9)


def test_each_exposure_of_a_test_has_a_place_of_its_own(data, learned):
    """The counts of one scene, its place unknown, vary by more than photon noise."""
    scanner = learned.scanner()
    one = torch.from_numpy(data.x_test[:1]).expand(20_000, -1)
    with torch.no_grad():
        rates = learned.exposure.rates(scanner, one)
        counts = scanner.read(learned.exposure.placed(rates, generator()) * 1e4, generator(2))[:, 0]
    placed = learned.exposure.placed(rates, generator(1))[:, 0] * 1e4
    assert ((placed.var(dim=0) / placed.mean(dim=0)).max()) > 1  # jitter is seen at this budget
    for t in range(6):
        spread = float(placed[:, t].var() + placed[:, t].mean())
        mean_error = 5 * (2 * spread / 20_000) ** 0.5
        assert abs(counts[:, t].mean() - placed[:, t].mean()) < mean_error
        assert float(counts[:, t].var()) == pytest.approx(spread, rel=0.15)
    shown = learned.exposure.placed(rates[:1], None)[0, 0] * 1e4
    error = 5 * (placed.var(dim=0) * (1 / 1024 + 1 / 20_000)).sqrt()
    assert ((shown - placed.mean(dim=0)).abs() <= error).all()

"""Published networks, beside which designs are compared."""

import os
from pathlib import Path

import numpy as np
import pytest
import torch

from deepfsi import evaluate, learn
from deepfsi.camera.light import summed_reflectance
from deepfsi.datasets.load import load_dataset
from deepfsi.physics.laws import light_law
from shared.benchmarks import benchmark


def published_network(folder: Path, pixels: int, light: float = 3.0) -> Path:
    """Write a network of five neurons, as `published` reads it."""
    rng = np.random.default_rng(2)
    parts = {"masks": light * rng.random((5, pixels)) ** 3, "readout": rng.normal(size=(10, 5))}
    path = folder / "incoherent_n5.npz"
    np.savez(path, bias=np.zeros(10), **parts)
    return path


def test_published_masks_fit_their_constraint_at_their_smallest_budget(tmp_path):
    published = benchmark("published")
    network = published.Network.read(published_network(tmp_path, 36), 64)
    x, s = np.random.default_rng(3).random((20_000, 64)), 30.0
    inner = x.reshape(-1, 8, 8)[:, 1:-1, 1:-1].reshape(-1, 36)
    with np.load(tmp_path / "incoherent_n5.npz") as file:
        rates = inner @ file["masks"].T
    np.testing.assert_allclose(x @ network.masks.T, rates, rtol=1e-9)
    clicks = network.clicks(x)
    spread = 0.5 / np.sqrt(len(x))
    assert np.abs((clicks + np.expm1(-rates)).mean(axis=0)).max() < 5 * spread
    for light in published.LAWS:
        photons = network.least_photons(light, s)
        matrix = torch.from_numpy(network.masks * s / photons)[None]
        assert light_law(light).excess(matrix) == pytest.approx(0, abs=1e-9)


def test_shots_are_averaged(digits):
    """One shot is the usual test; of many the mean of linear logits is that of expected clicks."""
    published = benchmark("published")
    camera = {"light": "column", "rails": "single", "noise": "click"}
    how = {"epochs": 2, "classifier": "torch.nn:Linear"}
    made = learn(digits, photons=20, masks=12, camera=camera, training=how)
    [usual] = evaluate(made, digits, 20, draws=1)
    once = published.right_in(made, digits, 20, 1)
    spread = np.sqrt(usual.accuracy * (1 - usual.accuracy) / len(once))
    assert abs(once.mean() - usual.accuracy) < 5 * np.sqrt(2) * spread
    scanner = made.scanner("click")
    rates = made.exposure.rates(scanner, torch.from_numpy(digits.x_test))
    expected = made.exposure.detection.features(scanner.noise.mean(20 * rates))
    wanted = made.answer(expected / 20.0, 20).classes.numpy() == digits.y_test
    many = published.right_in(made, digits, 20, 300)
    assert (many == wanted).mean() > 0.85
    assert (once == wanted).mean() < 0.75


SPDNN = Path(os.environ.get("DEEPFSI_DATA") or ".") / "spdnn"


@pytest.mark.slow
@pytest.mark.skipif(not SPDNN.is_dir(), reason="needs $DEEPFSI_DATA/spdnn")
def test_published_networks_reach_what_was_published():
    """Accuracy in one shot and ten, clicks, and smallest budgets, of Ma et al.'s weights."""
    published, data = benchmark("published"), load_dataset("mnist", rescale=(0.0, 1.0))
    s = summed_reflectance(data.x_train)
    known = {
        10: (0.782, 0.871, 6.3, 1402, 5112),
        50: (0.930, 0.955, 34.4, 2240, 17655),
        100: (0.952, 0.969, 71.6, 3121, 31324),
        400: (0.973, 0.983, 303, 9681, 133815),
    }
    for size, (once, ten, clicked, *budgets) in known.items():
        network = published.Network.read(SPDNN / f"incoherent_n{size}.npz", data.pixels)
        shots = [network.clicks(data.x_test, seed) for seed in range(10)]
        for accuracy, classes in (
            (once, network.classes(shots[0])),
            (ten, network.classes(np.sum(shots, axis=0), 10)),
        ):
            error = np.sqrt(accuracy * (1 - accuracy) / len(classes))
            assert abs((classes == data.y_test).mean() - accuracy) < 5 * error
        assert shots[0].sum(axis=1).mean() == pytest.approx(clicked, rel=0.01)
        least = [network.least_photons(light, s) for light in published.LAWS]
        assert least == pytest.approx(budgets, abs=0.6)

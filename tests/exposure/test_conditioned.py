"""Designs for a range of budgets."""

import math

import numpy as np
import pytest
import torch

from conftest import RECIPE, every_optics, generator, once
from deepfsi.camera.light import photons_per_pixel
from deepfsi.exposure.kind import temperatures_at
from deepfsi.exposure.training import standardise_batch, standardise_by_power
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.physics.laws import ROUNDING_SLACK, light_law
from deepfsi.training.learning import train
from shared.jobs import job, learn

TRAINED = {"masks": 8, "photons": 1e3, "span": 100.0}


@every_optics
def test_the_network_is_told_the_budget(digits, light, rails):
    design = once(digits, light=light, rails=rails, **TRAINED)
    scenes = photons_per_pixel(torch.from_numpy(digits.x_test[:20]), 5e3, design.summed_reflectance)
    counts = design.scanner().counts(scenes, generator(1)).squeeze(-2)
    seen = design.exposure.features(counts, 5e3)
    scaled = (seen - design.exposure.mean) / design.exposure.std
    level = (math.log(5e3 / 1e3) - math.log(100) / 2) / (math.log(100) / 2)
    last = torch.tensor([level, 1.0]).expand(20, 2)
    with torch.no_grad():
        logits = design.classifier(torch.cat([scaled, last], dim=-1))
    temperature = float(temperatures_at(design.temperatures, 0, 5e3))
    by_hand = (logits / temperature).softmax(dim=-1)
    np.testing.assert_allclose(design.classify(counts, 5e3), by_hand.numpy(), atol=2e-5)


@pytest.mark.parametrize("scale", ["each", "common"])
def test_features_have_unit_spread_in_the_mean_of_the_training(digits, scale):
    """Simulated with noise of its own, to five standard errors of the mean square."""
    one = job(masks=6, photons=300.0, epochs=1, scale=scale, span=50.0)
    [design] = train(TrainingSet(digits, "cpu"), [one])
    rng = np.random.default_rng(2)
    mean = digits.x_train @ design.matrix.T / design.summed_reflectance
    light = digits.x_train @ np.abs(design.matrix).T / design.summed_reflectance
    shown = design.exposure
    squares = []
    for _ in range(20):
        budget = 300.0 * 50.0 ** rng.random((len(mean), 1))
        features = mean + np.sqrt(light / budget) * rng.standard_normal(mean.shape)
        squares.append(((features - shown.mean.numpy()) / shown.std.numpy()) ** 2)
    every = np.concatenate(squares)
    axis = 0 if scale == "each" else None
    error = every.std(axis=axis) / (every.size / (6 if axis is None else 36)) ** 0.5
    assert (np.abs(every.mean(axis=axis) - 1) < 5 * error + 1e-3).all()


@pytest.mark.parametrize("divided", [standardise_batch, standardise_by_power])
@pytest.mark.parametrize("scale", ["each", "common"])
def test_features_that_do_not_vary_in_a_batch_are_0_and_have_finite_gradients(scale, divided):
    """As of detectors whose gates all click."""
    features = torch.zeros(50, 1, 3, requires_grad=True)
    scaled = divided(features, scale)
    scaled.sum().backward()
    assert (scaled == 0).all()
    assert features.grad.isfinite().all()


SHORTEST = 0.06
"""Share of the exposure: sixteen frames."""

ONE_DMD = {"light": "free-dwell", "rails": "single"}


@pytest.mark.parametrize("levels", [0, 2])
@pytest.mark.parametrize(
    "optics", [ONE_DMD, {"light": "free-dwell"}, {"light": "two-arm"}], ids=str
)
def test_no_frame_of_a_sequence_is_below_the_shortest(digits, optics, levels):
    words = {**RECIPE, **optics, "levels": levels, "device": "cpu"}
    design = learn(digits, photons=1e3, masks=20, shortest_dwell=SHORTEST, **words)
    rails = design.rails.total[None] if "two-arm" in optics.values() else design.rails.stacked
    dwells = rails.amax(dim=-1).numpy()
    lit = dwells[dwells > 0]
    assert lit.min() >= SHORTEST * (1 - 1e-5)
    assert lit.size <= lit.sum() / SHORTEST
    assert light_law(optics["light"]).excess(design.rails.stacked) <= ROUNDING_SLACK

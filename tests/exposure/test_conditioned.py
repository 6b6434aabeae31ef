"""Designs for a range of budgets, and nested masks."""

import math

import numpy as np
import pytest
import torch

from conftest import every_optics, generator, once
from deepfsi.camera.light import photons_per_pixel
from deepfsi.exposure import conditioned
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.networks.temperatures import stop_temperatures
from deepfsi.physics.laws import light_law
from deepfsi.training.learning import train
from shared.jobs import job

TRAINED = {"masks": 8, "photons": 1e3, "span": 100.0, "nested": 3}


@every_optics
def test_the_first_masks_at_the_whole_constraint_obey_it(digits, light, rails):
    """Nested masks take the whole of it, and so do the first of them."""
    design, law = once(digits, light=light, rails=rails, **TRAINED), light_law(light)
    for masks in range(3, 9):
        part = design.first(masks)
        law.check(part.rails.stacked)
        assert part.masks == masks
        assert float(law.used(part.rails.stacked)[-1]) == pytest.approx(1, rel=1e-5)
    assert torch.equal(design.first(8).rails.stacked, design.rails.stacked)


@every_optics
def test_an_exposure_that_stops_is_one_of_the_first_masks_at_its_budget(digits, light, rails):
    design = once(digits, light=light, rails=rails, **TRAINED)
    scenes = photons_per_pixel(torch.from_numpy(digits.x_test[:20]), 5e3, design.summed_reflectance)
    counts = design.scanner().counts(scenes, generator(1))
    for masks in (3, 5, 8):
        part = design.first(masks)
        seen = counts[..., :masks].squeeze(-2)
        chance = part.classify(seen, 5e3 * part.exposure.used)
        width = 2 if light == "two-arm" else 1
        features = torch.zeros(20, 8 * width)
        features[:, : masks * width] = part.features_of(seen)
        scaled = (features / 5e3 - design.mean) / design.std
        scaled[:, masks * width :] = 0
        level = (math.log(5e3 / 1e3) - math.log(100) / 2) / (math.log(100) / 2)
        last = torch.tensor([level, masks / 8]).expand(20, 2)
        with torch.no_grad():
            logits = design.classifier(torch.cat([scaled, last], dim=-1))
        by_hand = (logits / stop_temperatures(design.temperatures, 5e3)[masks - 3]).softmax(dim=-1)
        np.testing.assert_allclose(chance, by_hand.numpy(), atol=2e-5)


@pytest.mark.parametrize("scale", ["each", "common"])
@pytest.mark.parametrize(("span", "nested"), [(50.0, 0), (1.0, 2), (50.0, 2)])
def test_features_have_unit_spread_in_the_mean_of_the_training(digits, scale, span, nested):
    """Simulated with noise of its own, to five standard errors of the mean square."""
    one = job(masks=6, photons=300.0, epochs=1, scale=scale, span=span, nested=nested)
    [design] = train(TrainingSet(digits, "cpu"), [one])
    rng = np.random.default_rng(2)
    n, repeats = len(digits.x_train), 20
    squares = []
    used = light_law(design.light).used(design.rails.stacked).numpy()
    for _ in range(repeats):
        budget = 300.0 * span ** rng.random((n, 1))
        likely = design.exposure.chances.double().numpy()
        shown = rng.choice(6, n, p=likely / likely.sum())[:, None] + 1
        mean = digits.x_train @ design.matrix.T / design.summed_reflectance
        light = digits.x_train @ np.abs(design.matrix).T / design.summed_reflectance
        noise = np.sqrt(light / budget * used[shown - 1] / used[-1])
        features = mean + noise * rng.standard_normal(mean.shape)
        scaled = (features - design.mean.numpy()) / design.std.numpy()
        squares.append(np.where(np.arange(6) < shown, scaled**2, np.nan))
    every = np.concatenate(squares)
    axis = 0 if scale == "each" else None
    power = np.nanmean(every, axis=axis)
    error = np.nanstd(every, axis=axis) / np.sqrt((~np.isnan(every)).sum(axis=axis) / 6)
    assert (np.abs(power - 1) < 5 * error + 1e-3).all()


def test_noise_over_exposures_is_the_mean_over_those_that_show_a_mask():
    """Against the sum over numbers of masks shown and budgets, of two jobs that differ.

    With n masks shown, and used(n) of their light law, the noise of a budget Φ is that of
    Φ used(m) / used(n); budgets are drawn log-uniformly from a hundredth to all of the largest.
    """
    used = torch.tensor([[0.2, 0.5, 0.6, 1.0], [0.1, 0.3, 0.9, 1.5]], dtype=torch.float64)
    chances = torch.tensor([0.4, 0.0, 0.1, 0.5], dtype=torch.float64)
    places = (torch.arange(100_000, dtype=torch.float64) + 0.5) / 100_000
    dim = float((100.0**-places).mean())
    factor, often = conditioned.mean_over_exposures(used, 100.0, chances)
    for mask in range(4):
        seen = chances[mask:]
        assert float(often[mask]) == pytest.approx(float(seen.sum()))
        for replica in range(2):
            mean = float((seen * used[replica, mask:] / used[replica, -1]).sum() / seen.sum())
            assert float(factor[replica, mask]) == pytest.approx(dim * mean, rel=1e-6)
    one, _ = conditioned.mean_over_exposures(used, 1.0, chances)
    assert torch.allclose(one * dim, factor, rtol=1e-6)

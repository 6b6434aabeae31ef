"""Designs learned and tested under camera noise, and under a noise of one's own."""

import math

import pytest

from conftest import PHOTONS, generator, light_on, quick
from deepfsi import evaluate

CAMERA = {"noise": "camera", "sigma": 50.0, "dark": 2e4}


def assert_standardised(design, digits, *noise, draws=20, trained=math.inf):
    """Scaled features have mean 0 and variance 1; `trained` scenes gave the design's statistics."""
    features = design.scanner(*noise)(
        light_on(design, digits.x_train).repeat(draws, 1).float(), generator()
    )
    scaled = ((features / PHOTONS - design.mean) / design.std).double()
    share = 1 / len(scaled) + 1 / trained
    assert scaled.mean(dim=0).abs().max() <= 5 * math.sqrt(share)
    fourth = scaled.pow(4).mean(dim=0)
    assert ((scaled.var(dim=0) - 1).abs() <= 5 * ((fourth - 1) * share).sqrt()).all()


@pytest.mark.parametrize("rails", ["dual", "single"])
@pytest.mark.parametrize("light", ["column", "free-dwell"])
@pytest.mark.parametrize("design", ["pca", "deepfsi"])
def test_features_are_standardised_with_dark_counts_and_read_noise(digits, design, light, rails):
    one = quick(digits, design, light=light, rails=rails, **CAMERA)
    assert_standardised(one, digits, *CAMERA.values())
    # each part is seen: without it the features are narrower, by far more than chance
    for less in (("camera", 50.0, 0.0), ("camera", 0.01, 2e4)):
        with pytest.raises(AssertionError):
            assert_standardised(one, digits, *less)


def test_masks_that_know_of_read_noise_do_better_under_it(digits):
    """Five sigma of the noise draws, in which alone the two tests differ."""
    how = {"masks": 10, "epochs": 20, "mask_lr": 1e-1, "lr": 1e-2, "scale": "common"}
    draws = 20
    first, second = (
        evaluate(
            quick(digits, hidden=(40, 128), **how, **noise), digits, PHOTONS, draws=draws, **CAMERA
        )[0].accuracy
        for noise in (CAMERA, {"noise": "ml_gauss"})
    )
    trials = draws * len(digits.x_test)
    error = math.sqrt((first * (1 - first) + second * (1 - second)) / trials)
    assert first - second > 5 * error

"""Designs that training makes: statistics, noises, shapes of scenes."""

from __future__ import annotations

import math

import pytest
import torch

from conftest import (
    FIXED,
    PHOTONS,
    every_optics,
    generator,
    light_on,
    quick,
    synthetic,
)
from deepfsi.design.evaluation import evaluate
from deepfsi.errors import InputError
from deepfsi.training.training_set import TrainingSet


def test_scenes_that_are_all_alike_can_still_be_trained_on():
    data = synthetic((3, 3))
    data.x_train[:] = 0.5
    assert quick(data, masks=2, start="truncated-hadamard").masks == 2


@pytest.mark.parametrize("rails", ["dual", "single"])
@pytest.mark.parametrize("noise", ["ml_gauss", "poisson", "gaussian"])
@pytest.mark.parametrize("design", ["pca", "deepfsi"])
def test_features_are_standardised_over_scenes_and_noise(digits, noise, rails, design):
    one = quick(digits, design, noise=noise, sigma=4.0, rails=rails)
    photons = light_on(one, digits.x_train).repeat(20, 1)
    features = one.scanner(noise, 4.0)(photons, generator())
    scaled = (features / PHOTONS - one.mean) / one.std
    n = len(scaled)
    assert scaled.mean(dim=0).abs().max() <= 5 / math.sqrt(n)
    fourth = scaled.pow(4).mean(dim=0)
    assert ((scaled.var(dim=0) - 1).abs() <= 5 * ((fourth - 1) / n).sqrt()).all()


def test_a_common_scale_is_the_same_for_all_features(digits):
    each, common = (quick(digits, "pca", scale=scale) for scale in ("each", "common"))
    assert len(set(common.std.tolist())) == 1
    assert common.std[0].square() == pytest.approx(float(each.std.square().mean()), rel=1e-5)
    assert torch.equal(each.mean, common.mean)


@pytest.mark.parametrize("scale", ["each", "common"])
@pytest.mark.parametrize("noise", ["ml_gauss", "poisson", "gaussian", "none"])
@pytest.mark.parametrize("design", ["deepfsi", "pca", "control"])
def test_every_noise_and_scale_trains(digits, design, noise, scale):
    one = quick(digits, design, noise=noise, scale=scale, epochs=6)
    assert evaluate(one, digits, 1e7)[0].accuracy > 0.3


@pytest.mark.parametrize("design", FIXED)
def test_every_design_reads_digits_in_bright_light(digits, design):
    one = quick(digits, design, photons=1e8, epochs=8, hidden=(40, 128))
    assert evaluate(one, digits, 1e8)[0].accuracy > 0.6


@pytest.mark.parametrize("shape", [(12, 10), (10,), (3, 8)])
@pytest.mark.parametrize("design", ["deepfsi", "truncated-hadamard", "hadamard", "s-matrix", "pca"])
def test_scenes_may_have_any_shape(shape, design):
    data = synthetic(shape)
    one = quick(data, design, photons=1e7, epochs=30, batch=16)
    assert one.image_shape == shape
    assert evaluate(one, data, 1e7)[0].accuracy > 0.5


@pytest.mark.skipif(torch.cuda.is_available(), reason="has a GPU")
def test_a_missing_gpu_is_said(digits):
    with pytest.raises(InputError, match="cuda is not here"):
        TrainingSet(digits, "cuda")


def test_learned_masks_beat_their_start_in_dim_light(digits):
    accuracy = [
        evaluate(quick(digits, design, 6, photons=1e3, epochs=15), digits, 1e3)[0].accuracy
        for design in ("deepfsi", "pca")
    ]
    assert accuracy[0] > accuracy[1]


@pytest.mark.parametrize("noise", ["ml_gauss", "gaussian"])
@every_optics
def test_statistics_of_a_two_level_design_are_of_its_own_masks(digits, noise, light, rails):
    """Scaled features of its scanner have mean 0 and variance 1."""
    one = quick(digits, noise=noise, sigma=4.0, light=light, rails=rails, levels=2)
    photons = light_on(one, digits.x_train).repeat(20, 1)
    features = one.scanner(noise, 4.0)(photons, generator())
    scaled = (features / PHOTONS - one.mean) / one.std
    n = len(scaled)
    assert scaled.mean(dim=0).abs().max() <= 5 / math.sqrt(n)
    fourth = scaled.pow(4).mean(dim=0)
    assert ((scaled.var(dim=0) - 1).abs() <= 5 * ((fourth - 1) / n).sqrt()).all()

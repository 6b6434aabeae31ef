"""Budgets become photons per pixel."""

import math

import numpy as np
import pytest
import torch

from deepfsi.base import InputError
from deepfsi.camera import check_budget, photons_per_pixel, summed_reflectance


@pytest.mark.parametrize(
    "bad",
    [0, -1, -1e4, math.nan, math.inf, -math.inf, "abc", "", None, [], [1e3], "inf", 10**400, 1j],
    ids=lambda bad: repr(bad)[:12],
)
def test_a_budget_is_finite_and_above_zero(bad):
    with pytest.raises(InputError, match="photon budget"):
        check_budget(bad)


@pytest.mark.parametrize("good", [1e4, "1e4", 10000, np.float32(1e4)])
def test_a_budget_may_be_written_in_any_way(good):
    assert check_budget(good) == 1e4


def test_the_training_mean_gets_the_budget(digits):
    photons = photons_per_pixel(digits.x_train, 1e4, summed_reflectance(digits.x_train))
    assert photons.sum(axis=1, dtype=np.float64).mean() == pytest.approx(1e4, rel=1e-6)


def test_a_brighter_scene_sends_more():
    x = np.array([[0.1, 0.2], [0.2, 0.4]])
    photons = photons_per_pixel(x, 300.0, summed_reflectance(x))
    assert photons == pytest.approx(300 * x / 0.45)


@pytest.mark.parametrize("dark", [0, -1.0, float("nan")])
def test_no_photons_come_from_scenes_without_light(dark):
    with pytest.raises(InputError, match="give a number above 0"):
        photons_per_pixel(np.ones(3), 1e4, dark)


def test_arrays_and_tensors_agree(digits):
    light = summed_reflectance(digits.x_train)
    numbers = photons_per_pixel(digits.x_test, 1e5, light)
    tensor = photons_per_pixel(torch.from_numpy(digits.x_test), 1e5, light)
    assert np.allclose(numbers, tensor.numpy(), rtol=1e-6)

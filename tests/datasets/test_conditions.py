"""Scenes under stray light, and displaced ones."""

from dataclasses import replace

import numpy as np
import pytest

from conftest import quick, synthetic
from deepfsi.base import InputError
from deepfsi.camera import photons_per_pixel, summed_reflectance
from deepfsi.datasets import ambient, jitter


def test_stray_light_adds_the_same_photons_to_every_pixel(digits):
    """λ at (1 + b) Φ is that of the scene at Φ, and b Φ / N more."""
    bright = ambient(digits, 0.5)
    own = photons_per_pixel(digits.x_test, 1e4, summed_reflectance(digits.x_train))
    both = photons_per_pixel(bright.x_test, 1.5e4, summed_reflectance(bright.x_train))
    np.testing.assert_allclose(both, own + 0.5 * 1e4 / 64, rtol=1e-4)
    assert bright.x_train.max() <= 1
    assert np.array_equal(ambient(digits, 0).x_train, digits.x_train)


def test_stray_light_costs_what_its_noise_costs(digits):
    """Spread of the features under b: noise variance grows by b Φ times the mean of |M|."""
    clean = quick(digits, "pca", masks=4, photons=1e3)
    bright = ambient(digits, 2.0)
    lit = quick(bright, "pca", masks=4, photons=3e3)
    here = clean.std.numpy() ** 2
    share = np.abs(clean.matrix).mean(axis=1)
    np.testing.assert_allclose(np.abs(lit.matrix), np.abs(clean.matrix), atol=1e-5)
    np.testing.assert_allclose((3 * lit.std.numpy()) ** 2, here + 2 * share / 1e3, rtol=1e-3)


def test_a_known_displacement(digits):
    """One bright pixel goes where the shift says, and turns about the centre."""
    x = np.zeros((1, 9, 9), np.float32)
    x[0, 4, 6] = 1
    one = replace(synthetic((9, 9)), x_train=x.reshape(1, 81), x_test=x.reshape(1, 81))
    moved = jitter(one, 1.0, seed=3).x_train.reshape(9, 9)
    by = np.random.default_rng(3).normal(0, 1.0, (1, 2))[0]
    rows, columns = np.mgrid[:9, :9]
    found = np.array([(moved * rows).sum(), (moved * columns).sum()]) / moved.sum()
    np.testing.assert_allclose(found, np.array([4, 6]) + by, atol=1e-4)
    turned = jitter(one, 0.0, 20.0, seed=1).x_train.reshape(9, 9)
    rng = np.random.default_rng(1)
    rng.normal(0, 0, (1, 2))
    angle = np.deg2rad(rng.normal(0, 20.0, 1))[0]
    found = np.array([(turned * rows).sum(), (turned * columns).sum()]) / turned.sum()
    assert np.abs(found - [4 + 2 * np.sin(angle), 4 + 2 * np.cos(angle)]).max() < 0.1


def test_displacements_are_seeded_and_each_scene_has_its_own(digits):
    moved = jitter(digits, 0.5, 5.0, seed=1)
    assert np.array_equal(moved.x_train, jitter(digits, 0.5, 5.0, seed=1).x_train)
    assert not np.array_equal(moved.x_train, jitter(digits, 0.5, 5.0, seed=2).x_train)
    assert (np.abs(moved.x_test - digits.x_test).max(axis=1) > 0).all()
    assert np.array_equal(moved.y_train, digits.y_train)
    assert moved.hash != digits.hash
    np.testing.assert_allclose(jitter(digits, 0.0).x_train, digits.x_train, atol=1e-6)


@pytest.mark.parametrize("share", [-0.1, float("nan"), float("inf")])
def test_bad_light_is_refused(digits, share):
    with pytest.raises(InputError, match="0 or more"):
        ambient(digits, share)


def test_bad_displacements_are_refused(digits):
    for shift, turn in ((-1, 0), (0, -1), (float("nan"), 0)):
        with pytest.raises(InputError, match="0 or more"):
            jitter(digits, shift, turn)
    with pytest.raises(InputError, match="for images"):
        jitter(synthetic((6,)), 1.0)

"""Scenes under stray light, and displaced ones."""

from dataclasses import replace

import numpy as np

from conftest import quick, synthetic
from deepfsi.camera.light import photons_per_pixel, summed_reflectance
from shared.benchmarks import benchmark

ambient, jitter = benchmark("conditions").ambient, benchmark("conditions").jitter


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


def test_a_known_displacement():
    """One bright pixel goes where the shift says, and turns about the centre."""
    x = np.zeros((1, 81), np.float32)
    x[0, 9 * 4 + 6] = 1
    one = replace(synthetic((9, 9)), x_train=x, x_test=x)

    def centre(data):
        moved = data.x_train.reshape(9, 9)
        return np.array([(moved * index).sum() for index in np.mgrid[:9, :9]]) / moved.sum()

    by = np.random.default_rng(3).normal(0, 1.0, (1, 2))[0]
    np.testing.assert_allclose(centre(jitter(one, 1.0, seed=3)), np.array([4, 6]) + by, atol=1e-4)
    rng = np.random.default_rng(1)
    rng.normal(0, 0, (1, 2))
    angle = np.deg2rad(rng.normal(0, 20.0, 1))[0]
    turned = [4 + 2 * np.sin(angle), 4 + 2 * np.cos(angle)]
    assert np.abs(centre(jitter(one, 0.0, 20.0, seed=1)) - turned).max() < 0.1


def test_displacements_are_seeded_and_each_scene_has_its_own(digits):
    moved = jitter(digits, 0.5, 5.0, seed=1)
    assert np.array_equal(moved.x_train, jitter(digits, 0.5, 5.0, seed=1).x_train)
    assert not np.array_equal(moved.x_train, jitter(digits, 0.5, 5.0, seed=2).x_train)
    assert (np.abs(moved.x_test - digits.x_test).max(axis=1) > 0).all()
    assert np.array_equal(moved.y_train, digits.y_train)
    assert moved.hash != digits.hash
    np.testing.assert_allclose(jitter(digits, 0.0).x_train, digits.x_train, atol=1e-6)

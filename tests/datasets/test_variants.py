"""Scenes under stray light, and displaced ones."""

from dataclasses import replace

import numpy as np

from conftest import synthetic
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

"""Budgets become photons per pixel."""

import math

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi.camera.light import check_budget, photons_per_pixel, summed_reflectance


@pytest.mark.parametrize(
    "bad",
    [0, -1, math.nan, math.inf, "abc", None, [1e3], 10**400],
    ids=lambda bad: repr(bad)[:12],
)
def test_a_budget_is_finite_and_above_zero(bad):
    with pytest.raises(InputError, match="photon budget"):
        check_budget(bad)


def test_the_training_mean_gets_the_budget(digits):
    photons = photons_per_pixel(digits.x_train, 1e4, summed_reflectance(digits.x_train))
    assert photons.sum(axis=1, dtype=np.float64).mean() == pytest.approx(1e4, rel=1e-6)

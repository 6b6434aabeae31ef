"""Temperatures between the budgets and the stops of a calibration."""

import numpy as np
import pytest
import torch

from deepfsi.designfile.design_file import Temperatures
from deepfsi.networks.classifiers import temperatures_at

FITTED = Temperatures(np.array([[4.0, 2.0, 0.0], [2.0, 1.0, 0.0]]), np.array([1.0, 10.0, 100.0]))


def temperature(stop, photons):
    budget = torch.tensor([photons], dtype=torch.double)
    return float(temperatures_at(FITTED, torch.tensor([stop - 1.0]), budget))


def test_their_logarithm_is_interpolated():
    assert temperature(1, 1.0) == pytest.approx(np.exp(4))
    assert temperature(2, 10**1.5) == pytest.approx(np.exp(0.5))
    assert temperature(1.5, 10.0) == pytest.approx(np.exp(1.5))
    assert temperature(8, 1e9) == pytest.approx(1)  # the last look, the highest budget
    assert temperature(1, 0.01) == pytest.approx(np.exp(4) * 100)  # as 1 / Φ

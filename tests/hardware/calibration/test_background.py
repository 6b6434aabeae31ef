"""Counts that do not come from the scene."""

import numpy as np
import pytest

from deepfsi.hardware.calibration.fit import expected_background
from hardware.counting.recording_samples import patterns_of


@pytest.mark.parametrize("light", ["equal-dwell", "two-arm"])
def test_background_counts_dark_always_and_ambient_through_mirrors_of_the_arm(tmp_path, light):
    patterns, wanted = patterns_of(tmp_path / "p", light), np.zeros((2, 6))
    dark, ambient = (5.0, 100.0) if light == "equal-dwell" else np.array([[5.0, 7], [100, 10]])
    rail, mask, column, arm = patterns.manifest.read
    opened = patterns.fractions.mean(axis=1)[column]
    each = np.broadcast_to(np.c_[dark, ambient], (2, 2))[arm]
    light_in = each[:, 0] + each[:, 1] * np.where(arm == 1, 1 - opened, opened)
    wanted[rail, mask] = 10.0 * patterns.manifest.shares[column] * light_in
    found = expected_background(patterns, 10.0, dark, ambient)
    np.testing.assert_allclose(found, wanted, rtol=1e-6)
    assert wanted.std() > 0.1 * wanted.mean()

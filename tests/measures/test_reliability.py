"""Calibration error: distance of confidence and accuracy over groups of answers."""

import numpy as np
import pytest

from deepfsi.measures import calibration_error, chance_error, confidence_groups
from deepfsi.measures.reliability import BINS


def test_calibration_error_is_that_of_groups_written_out():
    confidence = np.repeat([0.5, 0.7, 1.0], 20 * BINS)
    right = np.concatenate([np.tile([1, 0], 10 * BINS), np.ones(40 * BINS)])
    error = calibration_error(confidence_groups(confidence, right))
    assert error == pytest.approx((0 + 0.3 + 0) / 3)


def test_answers_that_say_their_chance_still_show_an_error_of_their_number():
    """Mean |accuracy − p| of a group of n is √(2 p (1 − p) / (π n)) for a normal one."""
    few, many = (chance_error(np.full(BINS * n, 0.5)) for n in (40, 4000))
    assert few == pytest.approx(np.sqrt(0.5 / (np.pi * 40)), rel=0.1)
    assert few / many == pytest.approx(10, rel=0.1)

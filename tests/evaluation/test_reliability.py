"""Calibration error: distance of confidence and accuracy over groups of answers."""

import numpy as np
import pytest

from deepfsi.evaluation.measures import BINS, confidence_error


def test_calibration_error_is_that_of_groups_written_out():
    confidence = np.repeat([0.5, 0.7, 1.0], 20 * BINS)
    right = np.concatenate([np.tile([1, 0], 10 * BINS), np.ones(40 * BINS)])
    assert confidence_error(confidence, right) == pytest.approx((0 + 0.3 + 0) / 3)

"""Provenance of designs, and what their scenes send."""

import numpy as np
import pytest

from deepfsi.training import characterisation


def test_brightness_tells_scenes_from_classes():
    """Scenes of 1, 3 and 8 pixels' light, classes of 2, 8 and 4 in the mean, all of 4."""
    x = np.array([[1, 0], [2, 1], [4, 4], [1, 3]])
    found = characterisation.brightness(x, np.array([0, 0, 1, 2]))
    assert found == pytest.approx({"low": 1 / 4, "high": 8 / 4, "between": 8 / 2, "within": 1 / 2})
    assert characterisation.brightness(np.array([[1.0], [0.0]]), np.array([0, 1])) is None

"""The rule by which an exposure stops."""

import numpy as np
import pytest

from deepfsi.camera import StopRule
from deepfsi.design.stopping import StoppingRule


@pytest.mark.parametrize("photons", [300, 1e3, 1e4 / 3.1])
@pytest.mark.parametrize("confidence", [0.69, 0.71])
def test_the_rule_is_the_design_s(confidence, photons):
    chances = np.array([confidence, 0.2, 0.8 - confidence])
    wanted = StoppingRule((1, 2, 3), 0.7, 1e3).decide(1, chances, photons)
    assert StopRule(threshold=0.7, photons=1e3).stops(confidence, photons) == wanted
    assert wanted == (confidence > 0.7 and photons == 1e3)
    assert StopRule(threshold=0.7).stops(confidence, photons) == (confidence > 0.7)

"""The rule by which an exposure stops."""

import pytest

from deepfsi.camera.dead_time import StopRule


@pytest.mark.parametrize("photons", [300, 1e3, 1e4 / 3.1])
@pytest.mark.parametrize("confidence", [0.69, 0.71])
def test_a_rule_stops_at_its_light_where_the_answer_is_sure(confidence, photons):
    rule = StopRule(threshold=0.7, photons=1e3)
    assert rule.stops(confidence, photons) == (confidence > 0.7 and photons == 1e3)
    assert StopRule(threshold=0.7).stops(confidence, photons) == (confidence > 0.7)

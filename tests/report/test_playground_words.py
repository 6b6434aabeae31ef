"""The page of a design and what it says of its optics, without a browser."""

import pytest

from deepfsi.report.playground import page


@pytest.mark.parametrize(
    ("optics", "said"),
    [
        ({"light": "column"}, "14, one for each rail of each mask"),
        ({"light": "column", "rails": 1}, "7, one for each mask"),
        ({"light": "two-arm"}, "2, one on each arm"),
        ({"light": "free-dwell", "detectors": 4}, "4, each on its part of the scene"),
        ({"light": "free-dwell"}, "1"),
    ],
)
def test_the_detectors_are_those_of_the_optics(optics, said):
    payload = {"rails": 2, "detectors": 1, "matrix": {"shape": [7, 64]}, "exposure": {}, **optics}
    assert page.detector_count_text(payload) == said
    way, column = page.way_text(payload), optics["light"] == "column"
    assert ("no single mirror device does this" in way) == column
    assert ("one detector counts" in way) == (said == "1")

"""The page of a design and what it says of its optics, without a browser."""

import json

import pytest

from conftest import quick
from deepfsi.report.playground.page import detector_count_text, way_text
from shared.playground import KINDS


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
    assert detector_count_text(payload) == said
    way, column = way_text(payload), optics["light"] == "column"
    assert ("no single mirror device does this" in way) == column
    assert ("one detector counts" in way) == (said == "1")


def test_the_command_writes_a_page_and_says_where(done, refuse, digits, tmp_path):
    kept = digits.hold_out(237)
    file = quick(kept, **KINDS["looks"]).save(tmp_path / "looks.safetensors")
    out = tmp_path / "looks.html"
    assert done("page", file, "-o", out).splitlines()[-1] == f"page to play with: {out}"
    text = out.read_text()
    assert text.count("<script") == 3
    told = json.loads(done("page", file, "-o", out, "--json", "--force"))
    assert len(told["curve"]) == 13
    assert told["rules"][0]["photons"] == 1e4
    assert out.read_text() == text  # the same seed gives the same page
    assert "end the name in .html" in refuse("page", file, "-o", tmp_path / "looks")

"""The pattern of a design as a photomask: its files, read back, and what is refused."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi_flow import photomask

SVG = "{http://www.w3.org/2000/svg}"
PATTERNS = {
    "random": np.random.default_rng(0).integers(0, 2, (9, 14)),
    "open": np.ones((3, 5)),
    "dark": np.zeros((2, 4)),
    "checks": np.indices((5, 6)).sum(axis=0) % 2,
    "one": np.ones((1, 1)),
}


@pytest.mark.parametrize("pattern", PATTERNS.values(), ids=PATTERNS)
def test_polygons_drawn_at_their_scale_are_the_pattern(pattern):
    root = ET.fromstring(photomask.as_svg(pattern, 2.5, "a mask"))
    height, width = pattern.shape
    assert root.get("viewBox") == f"0 0 {2.5 * width:g} {2.5 * height:g}"
    for side, count in (("width", width), ("height", height)):
        assert root.get(side).endswith("mm")
        assert float(root.get(side)[:-2]) == pytest.approx(2.5e-3 * count)
    assert root.find(f"{SVG}desc").text == "a mask"
    covered = np.zeros(pattern.shape)
    for polygon in root.iter(f"{SVG}polygon"):
        x, y = np.array([each.split(",") for each in polygon.get("points").split()], float).T / 2.5
        assert set(np.r_[x, y] % 1) == {0.0}
        covered[int(y.min()) : int(y.max()), int(x.min()) : int(x.max())] += 1
    assert np.array_equal(covered, pattern)


def test_grey_levels_are_refused_as_polygons():
    grey = np.linspace(0, 1, 12).reshape(3, 4)
    with pytest.raises(InputError, match="grey levels: learn it with `levels=2`"):
        photomask.as_svg(grey, 5.0, "")

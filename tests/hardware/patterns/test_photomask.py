"""Files of a photomask, read back: polygons and picture are the pattern, at its scale."""

import io
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from PIL import Image

from deepfsi.base import InputError
from deepfsi.hardware.patterns.photomask import as_png, as_svg, rectangles

SVG = "{http://www.w3.org/2000/svg}"
PATTERNS = {
    "random": np.random.default_rng(0).integers(0, 2, (9, 14)),
    "open": np.ones((3, 5)),
    "dark": np.zeros((2, 4)),
    "checks": np.indices((5, 6)).sum(axis=0) % 2,
    "one": np.ones((1, 1)),
}

every_pattern = pytest.mark.parametrize("pattern", PATTERNS.values(), ids=PATTERNS)


@every_pattern
def test_each_open_pixel_is_in_one_rectangle_and_no_dark_one(pattern):
    covered = np.zeros(pattern.shape, int)
    for top, left, bottom, right in rectangles(pattern):
        covered[top:bottom, left:right] += 1
    assert np.array_equal(covered, pattern)


def test_rectangles_are_merged_along_rows_and_columns():
    assert len(rectangles(PATTERNS["open"])) == 1
    bars = np.tile([1, 1, 0, 1], (7, 3))
    assert len(rectangles(bars)) == 4  # of 2, 3, 3 and 1 columns


@every_pattern
def test_polygons_drawn_at_their_scale_are_the_pattern(pattern):
    root = ET.fromstring(as_svg(pattern, 2.5, "a mask"))
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


@every_pattern
def test_a_picture_has_a_dot_for_each_pixel_and_its_scale(pattern):
    picture = Image.open(io.BytesIO(as_png(pattern, 5.0, "a mask")))
    assert picture.mode == "1"
    assert np.array_equal(np.asarray(picture), pattern.astype(bool))
    assert picture.info["dpi"] == pytest.approx((5080, 5080), rel=1e-3)
    assert picture.info["Description"] == "a mask"


def test_grey_levels_are_kept_in_a_picture_and_refused_as_polygons():
    grey = np.linspace(0, 1, 12).reshape(3, 4)
    picture = np.asarray(Image.open(io.BytesIO(as_png(grey, 5.0, ""))))
    assert np.array_equal(picture, np.rint(255 * grey))
    with pytest.raises(InputError, match="grey levels: learn it with `levels=2`"):
        as_svg(grey, 5.0, "")

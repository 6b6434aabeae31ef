"""Photons and masks of a target accuracy are read off the curves of a comparison."""

import re

import numpy as np

from deepfsi.sweeps.summary import needs_of, needs_table
from shared.results import a_point, some_results

BUDGETS = (1e2, 1e3, 1e4, 1e5, 1e6)


def curve(design, shift, **fields):
    """Points of an S in log Φ, whose light is `shift` times that of another for any accuracy."""
    return [
        a_point(
            float(0.1 + 0.87 / (1 + (3e3 * shift / photons))), 0.01, design=design, title=design,
            photons=photons, keys=(f"{design}-{photons:g}",), masks=masks, **fields,
        )
        for masks, photons in enumerate(BUDGETS, 1)
    ]  # fmt: skip


def test_what_a_target_needs_is_read_off_each_curve():
    """Within the 20 % that a monotone cubic through points a decade apart is off."""
    results = some_results([*curve("pca", 2), *curve("deepfsi", 0.5), *curve("raster", 1e9)])
    needs = needs_of(results, 0.9)
    assert [need["design"] for need in needs] == ["deepfsi", "pca", "raster"]
    for need, shift, masks in zip(needs[:2], (0.5, 2), (3, 4), strict=True):
        wanted = 3e3 * shift / (0.87 / 0.8 - 1)
        assert need["low"] < wanted < need["high"]
        assert abs(np.log(need["photons"] / wanted)) < np.log(1.2)
        assert need["masks"] == masks
    assert (needs[2]["photons"], needs[2]["found"], needs[2]["masks"]) == (None, "beyond", 5)
    [low] = needs_of(some_results(curve("pca", 1e-3)), 0.5)
    assert (low["found"], low["masks"]) == ("below", 1)
    table = needs_table(0.9, needs)
    assert table.title == "accuracy 0.9 needs"
    assert [row[0] for row in table.rows] == ["deepfsi", "pca", "raster"]
    assert table.rows[2][1] == "above 1e6"
    assert re.fullmatch(r"\S+ \(\S+ to \S+\)", table.rows[0][1])


def test_each_number_of_detectors_has_its_line():
    both = [*curve("pca", 1, detectors="1x1"), *curve("pca", 0.1, detectors="2x2")]
    rows = needs_table(0.8, needs_of(some_results(both), 0.8)).rows
    assert [row[-1] for row in rows] == ["2x2", "1x1"]

"""The verdict of a comparison says what its numbers bear, and no more."""

import itertools
import re

import numpy as np
import pytest

from deepfsi.report.comparison_page import verdict_of
from shared.results import a_point, some_results

BUDGETS = (1e2, 1e3, 1e4, 1e5)
TITLES = {"deepfsi": "DeepFSI", "pca": "PCA", "raster": "raster scan", "adaptive": "adaptive masks"}


def curve(design, shift, half=0.01, budgets=BUDGETS, **fields):
    """Points of an S in log Φ, whose light is `shift` times that of another for any accuracy."""
    rises = [float(0.1 + 0.87 / (1 + (3e3 * shift / photons))) for photons in budgets]
    return [
        a_point(
            accuracy, half, design=design, title=TITLES.get(design, design), photons=photons,
            keys=(f"{design}-{photons:g}",), **fields,
        )
        for photons, accuracy in zip(budgets, rises, strict=True)
    ]  # fmt: skip


@pytest.mark.parametrize("shift", [3, 8, 40])
def test_the_ratio_of_light_is_that_of_the_curves(shift):
    """Within the 20 % that a monotone cubic through points a decade apart is off."""
    said = verdict_of(some_results([*curve("deepfsi", 1), *curve("pca", shift)]))
    words = r"(\S+) \((\S+) to (\S+)\) times less light with DeepFSI than with PCA"
    times, low, high = map(float, re.fullmatch(words, said.title).groups())
    assert abs(np.log(times / shift)) < np.log(1.35)  # of one digit, 15 % more
    assert low <= times <= high
    assert said.text.startswith(f"{said.title}: at ")
    assert said.best.design == "deepfsi"
    assert f"accuracy is {said.best.accuracy:.3f}" in said.text


def test_the_rival_is_the_best_that_is_neither_learned_nor_adaptive():
    rows = [*curve("adaptive", 1), *curve("deepfsi", 1.5), *curve("pca", 5), *curve("raster", 9)]
    ideal = curve("impulse", 0.1)
    said = verdict_of(some_results([*ideal, *rows]))
    assert said.title.endswith(" times less light with adaptive masks than with PCA")
    assert verdict_of(some_results([*ideal, *rows[4:8]])).best.design == "deepfsi"


LOW = {"budgets": (1e3,)}


@pytest.mark.parametrize(
    ("curves", "title"),
    [
        ([curve("deepfsi", 1, **LOW), curve("pca", 5, **LOW)],
         "Accuracy is higher with DeepFSI than with PCA"),
        ([curve("deepfsi", 1, 0.2, **LOW), curve("pca", 1.2, 0.2, **LOW)],
         "The best designs cannot be told apart"),
        ([curve("deepfsi", 1), curve("pca", 1e6)],
         "Accuracy is higher with DeepFSI than with PCA"),
        ([curve("deepfsi", 1), curve("pca", 1.5)],  # its interval begins at 1
         "Accuracy is higher with DeepFSI than with PCA"),
        ([curve("pca", 1), curve("raster", 9)], "times less light with PCA than with raster scan"),
        ([curve("deepfsi", 1, 0.2), curve("pca", 1.5, 0.2)],
         "The best designs cannot be told apart"),
        ([curve("pca", 1)], "Accuracy 0.945 with PCA"),
        ([curve(*each, noise=noise) for noise in ("poisson", "gaussian")
          for each in (("deepfsi", 1), ("pca", 5))], "than with PCA under photon noise"),
    ],
    ids=["one budget", "one budget, wide", "never", "hardly", "singular", "wide", "one design",
         "two noises"],
)  # fmt: skip
def test_titles(curves, title):
    assert verdict_of(some_results(itertools.chain(*curves))).title.endswith(title)


def test_values_below_0_are_no_fault():
    """R² of a bad guess is below 0."""
    rows = [*curve("deepfsi", 1), *curve("pca", 5)]
    low = [
        p.model_copy(update={"accuracy": -2.0, "low": -2.1, "high": -1.9, "accuracies": (-2.0,)})
        if p.photons == 1e2 and p.design == "pca"
        else p
        for p in rows
    ]
    data = {"measure": "R²", "classes": (), "values": ("row", "column")}
    assert "photons R² is" in verdict_of(some_results(low, data=data)).text

"""Figures of the study on MNIST: what they show is what they were given, and words can be read."""

import itertools
import math

import pytest

from deepfsi.jobs.designs import DESIGNS, mask_count
from deepfsi_paper import measures
from deepfsi_paper.mnist import figures
from shared.figures import assert_legible, assert_sound
from shared.results import a_point, some_results

BUDGETS = [1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8]
RATIOS = [mask_count((k / 10) ** 2, 1024) / 1024 for k in range(1, 11)]
SHOWN = ("impulse", "raster", "hadamard", "truncated-hadamard", "pca", "deepfsi", "control")
NOISES = ("gaussian", "poisson")


def results():
    points = []
    for noise, (place, design), photons in itertools.product(NOISES, enumerate(SHOWN), BUDGETS):
        code = DESIGNS[design]
        middle = 3 + 0.3 * place + (noise == "gaussian")
        accuracy = 0.1 + 0.87 / (1 + math.exp(2 * (middle - math.log10(photons))))
        fields = {"label": code.label, "title": code.title, "specific": code.specific}
        fields |= {"design": design, "noise": noise, "photons": photons}
        for place, ratio in enumerate([1.0] if code.complete else RATIOS):
            masks = {"masks": round(1024 * ratio), "ratio": ratio, "best": place == 0}
            points.append(a_point(accuracy - ratio / 50, **fields, **masks))
    recipe = {"camera": {"sigma": [2.0]}}
    return some_results(points, recipe=recipe, data={"mean_reflectance": 0.37})


@pytest.mark.usefixtures("drawn_once")
def test_words_can_be_read_and_fragments_are_sound():
    figure = figures.error_figure(results())
    assert figure.get_figwidth() <= 10
    assert_legible(figure)
    assert_sound(lambda: figures.error_figure(results()))


def test_both_noises_share_one_noise_axis():
    left, right = figures.error_figure(results()).axes
    heads = [ax.get_title(loc="left") for ax in (left, right)]
    assert heads == ["Gaussian read noise", "photon noise"]
    assert left.get_xlim() == right.get_xlim()
    assert left.get_ylim() == right.get_ylim() == (0, 1)
    start, end = left.get_xlim()
    errors = [
        measures.impulse_imaging_error(photons, 0.37, 1024, noise, 2.0)
        for noise, photons in itertools.product(NOISES, BUDGETS)
    ]
    assert start > max(errors) > min(errors) > end
    assert all("less noise →" in ax.get_xlabel() for ax in (left, right))

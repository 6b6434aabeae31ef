"""Test of the view of a run: its law, false alarms and power."""

from copy import copy
from itertools import islice

import numpy as np
import pytest

from deepfsi.designfile import view_test
from deepfsi.designfile.view_test import SceneModel, SceneReadouts, ViewTest

SHAPE, PHOTONS, MASKS = (8, 8), 1e4, 16


@pytest.fixture(scope="module")
def model(digits):
    return SceneModel.fit(digits.x_train, digits.y_train)


@pytest.fixture(scope="module")
def masks(digits):
    """Blocks of 2 x 2 pixels, each for an equal part of the time, counts of a white pixel."""
    blocks = np.kron(np.eye(MASKS).reshape(MASKS, 4, 4), np.ones((2, 2))).reshape(MASKS, 64)
    return blocks * PHOTONS / digits.x_train.sum(axis=1).mean() / 4


def exposed(model, masks, scenes, rng):
    test, none = ViewTest(model, SHAPE), np.zeros(MASKS)
    for x in scenes:
        read = rng.poisson(masks @ x.clip(min=0)).astype(float)[None]
        test.add(SceneReadouts(masks, read, none, none.astype(int)))
    return test.result


def test_a_likelihood_ratio_is_1_in_the_mean_of_sound_runs(model, masks):
    """The law behind the rate of false alarms, of scenes that are as the model has them.

    The mean of exp(log ratio) over 600 runs of one scene lies within 5 of its standard errors.
    """
    rng = np.random.default_rng(2)
    bright = masks * 1e3  # counts are normal, and their noise is that of the mean scene
    means, axes = (each.astype(float) for each in (model.means, model.axes))
    test_of = ViewTest(model, SHAPE)
    ratios = []
    for _ in range(600):
        x = means[rng.choice(10, p=test_of._shares)] + rng.normal(size=len(axes)) @ axes
        x = x + rng.normal(size=64) * np.sqrt(model.rest.astype(float))
        mean = bright @ (test_of._shares @ means)
        read = bright @ x + rng.normal(size=MASKS) * np.sqrt(mean)
        read = read + 0.3 * rng.normal() * mean + 0.03 * rng.normal() * mean
        test = copy(test_of)
        test._log, test._sums = 0 * test_of._log, []
        test.add(SceneReadouts(bright, read[None], np.zeros(MASKS), np.zeros(MASKS, int)))
        ratios.append(np.exp(test.result.odds))
    error = np.std(ratios, axis=0) / np.sqrt(len(ratios))
    assert (np.mean(ratios, axis=0) < 1 + 5 * error).all()


def test_sound_runs_are_let_pass_whatever_their_classes(digits, model, masks):
    """None of 35: with at most `FALSE_ALARM` each, two or more alarms have a chance of 0.014."""
    rng, alarms = np.random.default_rng(3), 0
    for label in [None] * 25 + list(range(10)):
        own = digits.x_test[digits.y_test == label] if label is not None else digits.x_test
        chosen = own[rng.permutation(len(own))[: 40 if label is None else 20]]
        alarms += exposed(model, masks, chosen.astype(float), rng).named
    assert alarms <= 1


@pytest.mark.parametrize(
    "view",
    [
        *view_test.orientation_faults(SHAPE),
        *view_test.view_faults(SHAPE),
        *islice(view_test.dark_faults(SHAPE), 3, 38, 11),
    ],
    ids=lambda view: view.words,
)
def test_each_fault_is_refused_and_named_in_40_scenes(digits, model, masks, view):
    rng = np.random.default_rng(4)
    scenes = digits.x_test[rng.integers(0, len(digits.x_test), 40)].astype(float)
    seen = view.transform(scenes.reshape(-1, *SHAPE)).reshape(scenes.shape)
    result = exposed(model, masks, seen + view.stray * scenes.mean(), rng)
    assert result.named
    assert result.likeliest == view.words
    assert view.words in result.remark

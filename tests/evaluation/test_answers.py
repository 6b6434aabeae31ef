"""What measures are made of: answers of exposures, sorted by their scenes."""

import math

import numpy as np
import pytest

from deepfsi.evaluation.measures import ClassAnswers, ValueAnswers, confidence_error
from deepfsi.evaluation.results import Estimates, Result, results_lines

TEST = {"photons": 1e3, "noise": "poisson", "covers": "", "counts": 0.0, "arriving": 0.0}


def classes(chances, truth, draws=1, scenes=None, answered=None):
    scenes = np.arange(len(chances)) if scenes is None else scenes
    answered = chances.argmax(axis=1) if answered is None else answered
    rest = {"truth": truth, "scenes": scenes, "draws": draws, "shares": [0.5, 0.25]}
    return ClassAnswers(answered, chances.astype(np.float32), **TEST, **rest)


@pytest.mark.parametrize("right", [None, 0])
def test_the_log_loss_of_knowing_nothing_or_the_wrong_is_finite(right):
    truth = np.arange(40) % 4
    wrong = np.eye(4)[(truth + 1) % 4]
    blind = np.full((40, 4), 0.25)
    chances, loss = (blind, math.log(4)) if right is None else (wrong, 23 * math.log(2))
    result = Result.of(classes(chances, truth))
    assert result.log_loss == pytest.approx(loss, rel=1e-5)
    [row] = next(iter(results_lines([result], title="", classes="abcd"))).rows
    assert row[1].startswith("0.250 ±" if right is None else "0.000 ±")
    assert row[-1] == "0.750"
    assert result.cells("abcd") == [("worst class", f"0.000 ({'a' if right == 0 else 'b'})")]


def test_errors_of_values_are_means_over_draws_and_r2_is_of_their_variance():
    truth = np.array([[0.0], [4.0]], dtype=np.float32)
    estimates = np.array([[1.0], [4.0], [-1.0], [4.0]], dtype=np.float32)  # draw by draw
    rest = {"truth": truth, "scenes": np.array([0, 1, 0, 1]), "draws": 2, "shares": [1.0]}
    found = Estimates.of(ValueAnswers(estimates, **TEST, **rest), ("x",))
    assert found.rmse == [pytest.approx(math.sqrt(0.5))]
    assert (found.r2, found.r2_each) == (0.875, [0.875])
    assert found.image_terms == {"R²": [0.75, 1]}


def test_draws_of_a_scene_stand_together_in_their_order():
    scenes = np.array([0, 1, 0, 1, 2, 2])  # a chunk of two scenes, then one of one
    answers = classes(np.eye(2)[[0, 1, 0, 0, 1, 1]], np.array([0, 1, 1]), 2, scenes)
    assert answers.by_scene(np.arange(6)).tolist() == [[0, 2], [1, 3], [4, 5]]
    assert answers.terms["accuracy"].tolist() == [1, 0.5, 1]
    assert answers.confusion.tolist() == [[2, 0], [1, 3]]
    result = Result.of(answers)
    assert (result.images, result.draws, result.accuracy) == (3, 2, 5 / 6)
    assert (result.throughput, result.photons_per_mask) == (0.75, [500, 250])


def test_calibration_error_is_that_of_fifteen_groups():
    confidence = np.repeat(np.linspace(0.1, 0.8, 15), 2)
    right = np.tile([1.0, 0.0], 15)
    wanted = np.abs(np.linspace(0.1, 0.8, 15) - 0.5).mean()
    assert confidence_error(confidence, right) == pytest.approx(wanted)
    assert confidence_error(confidence[:3], right[:3]) == pytest.approx((0.9 + 0.1 + 0.85) / 3)

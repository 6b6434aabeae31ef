"""Laws of designs of few scenes: folds that no training saw make their confidence honest."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.special import softmax

from conftest import generator
from deepfsi import Job, learn
from deepfsi.adaptive.exposure import AdaptiveExposure, AdaptiveTraining, LeftOutAnswers
from deepfsi.evaluation.confidence import draw_logits
from deepfsi.exposure.kind import Clicks, temperatures_at
from deepfsi.jobs.exposures import AdaptiveMasks
from deepfsi.training import characterisation, learning

PHOTONS, LOOKS = 1e4, 6
EACH = 16
CLASSES = (3, 8, 9)
"""Digits that are often mistaken for each other."""

SETTINGS = {
    "adaptive": {"design": "adaptive", "masks": LOOKS},
    "learned": {"masks": 8, "training": {"epochs": 20}},
}


@pytest.fixture(scope="module")
def few(digits):
    """Training scenes of three classes; all others of them are the test."""
    x = np.concatenate([digits.x_train, digits.x_test])
    y = np.concatenate([digits.y_train, digits.y_test])
    order = np.random.default_rng(5).permutation(len(x))
    rows = [order[y[order] == label] for label in CLASSES]
    train, test = (np.concatenate([own[some] for own in rows])
                   for some in (slice(EACH), slice(EACH, None)))  # fmt: skip
    labels = np.searchsorted(CLASSES, y)
    return replace(digits, x_train=x[train], y_train=labels[train], x_test=x[test],
                   y_test=labels[test], classes=("3", "8", "9"), origin=None)  # fmt: skip


@pytest.fixture(scope="module", params=SETTINGS)
def design(request, few):
    return learn(few, photons=PHOTONS, **SETTINGS[request.param])


def test_each_fold_leaves_out_what_its_training_does_not_hold(digits):
    few = replace(digits, x_train=digits.x_train[:90], y_train=digits.y_train[:90])
    folds = characterisation.folds_of(few)
    assert len(folds) == characterisation.FOLDS
    for fold in folds:
        seen, left = ({row.tobytes() for row in x} for x in (fold.x_train, fold.x_test))
        assert not seen & left
        assert seen | left == {row.tobytes() for row in few.x_train}
        share = np.bincount(few.y_train, minlength=10) / characterisation.FOLDS
        assert np.abs(np.bincount(fold.y_test, minlength=10) - share).max() < 1
    assert sum(len(fold.x_test) for fold in folds) == 90


def test_folds_read_clicks_as_the_design_does(few, monkeypatch):
    """Clicks are not in proportion to the light: at another budget a fold reads them likewise."""
    trained = []
    monkeypatch.setattr(learning, "characterise", lambda *given: trained.append(given))
    camera = {"light": "free-dwell", "rails": "single", "noise": "click"}
    learn(few, photons=300, masks=4, camera=camera, training={"epochs": 1})
    [(_, _, [design], left_out)] = trained
    clicks = {made.exposure.clicks for _, [made] in left_out}
    assert clicks == {design.exposure.clicks} == {Clicks(gates=1, photons=300.0)}


def chances(design, data, photons=PHOTONS, seed=3):
    """Probabilities (E, C) of the test scenes, and the classes that are true."""
    logits = draw_logits(design, design.camera, data.x_test, photons, 1, seed)
    if design.exposure.makes_masks:
        return np.exp(logits)
    return softmax(logits / float(temperatures_at(design.temperatures, 0, photons)), axis=1)


@pytest.mark.parametrize("sureness", [0.5, 1.4, 4.0])
def test_a_posterior_that_is_too_sure_by_a_factor_gets_it_as_its_temperature(few, sureness):
    """Classes are drawn from the odds over the factor; Fisher's information is that of log τ."""
    job = Job(design="adaptive", masks=2, photons=PHOTONS)
    training = AdaptiveTraining(few, AdaptiveMasks(looks=2))
    made = AdaptiveExposure(
        training.prior, training.settings, few.image_shape, torch.zeros(2), job.camera
    )
    draws = generator(2)
    true = 3 * torch.randn(20_000, 3, generator=draws)
    shares = made.prior.class_shares.log()
    chances = (true + shares).softmax(dim=1)
    labels = torch.multinomial(chances, 1, generator=draws)[:, 0]
    answers = LeftOutAnswers(np.array([PHOTONS]), sureness * true[None, None], labels)
    calibrated, test = characterisation.calibrate_posterior(made, answers, few, job)
    given = calibrated.prior.calibrated(sureness * true, 2, PHOTONS)
    spread = (chances * true**2).sum(dim=1) - (chances * true).sum(dim=1) ** 2
    error = float(spread.sum()) ** -0.5
    logs = calibrated.prior.temperatures.logs
    assert logs == pytest.approx(np.log(sureness), abs=4 * error + 0.01)
    assert float((given - chances).abs().max()) < 0.05
    assert test["log_loss"] <= test["uncalibrated_log_loss"]


@pytest.mark.parametrize("ratio", [0.1, 1, 10])
def test_few_scenes_make_no_design_worse_than_guessing(design, few, ratio):
    given = chances(design, few, ratio * PHOTONS)
    losses = -np.log(given[np.arange(len(given)), few.y_test].clip(1e-30))
    error = losses.std() / len(losses) ** 0.5
    assert losses.mean() < np.log(3) + 3 * error
    # 48 scenes tell an accuracy to 0.06 at best, and two in five of their digits are mistaken
    right = (given.argmax(axis=1) == few.y_test).mean()
    assert given.max(axis=1).mean() < right + 3 * (right * (1 - right) / 3 / EACH) ** 0.5 + 0.02


def test_its_test_says_what_new_scenes_give(design, few):
    """Left-out scenes of the folds, and others: four standard deviations of 48 scenes' accuracy."""
    test, given = design.info["left_out"], chances(design, few)
    right = (given.argmax(axis=1) == few.y_test).mean()
    assert test["scenes"] == 3 * EACH
    assert test["guessing"] == pytest.approx(np.log(3))
    assert not test["guesses"]
    assert abs(right - test["accuracy"]) < 4 * (right * (1 - right) / 3 / EACH) ** 0.5 + 0.05
    assert test["log_loss"] <= test["uncalibrated_log_loss"] + 0.02

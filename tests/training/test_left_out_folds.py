"""Laws of designs of few scenes: folds that no training saw make their confidence honest."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.special import softmax

from deepfsi import evaluate, learn
from deepfsi.evaluation import logits_at_stops
from deepfsi.exposure import AdaptivePosterior, next_masks, posterior
from deepfsi.networks import stop_temperatures
from deepfsi.training import characterisation

PHOTONS, LOOKS = 1e4, 6
EACH = 16
"""Scenes of each class."""

CLASSES = (3, 8, 9)
"""Digits that are often mistaken for each other."""

SETTINGS = {
    "adaptive": {"design": "adaptive", "masks": LOOKS},
    "learned": {"masks": 8, "training": {"epochs": 20}},
    "looks": {"masks": 8, "exposure": {"looks": 2}, "training": {"epochs": 10}},
}


def drawn(digits, each, seed):
    """So many training scenes of each of three classes; all others are the test."""
    x, y = (np.concatenate(pair) for pair in ((digits.x_train, digits.x_test),
                                              (digits.y_train, digits.y_test)))  # fmt: skip
    order = np.random.default_rng(seed).permutation(len(x))
    rows = [order[y[order] == label] for label in CLASSES]
    kept, others = (np.concatenate([own[part] for own in rows])
                    for part in (slice(each), slice(each, None)))  # fmt: skip
    place = {label: k for k, label in enumerate(CLASSES)}
    labels = np.array([place.get(label, -1) for label in y])
    return replace(digits, x_train=x[kept], y_train=labels[kept], x_test=x[others],
                   y_test=labels[others], classes=("3", "8", "9"), origin=None)  # fmt: skip


@pytest.fixture(scope="module")
def few(digits):
    return drawn(digits, EACH, 5)


@pytest.fixture(scope="module", params=SETTINGS)
def design(request, few):
    return learn(few, photons=PHOTONS, **SETTINGS[request.param])


@pytest.fixture(scope="module")
def adaptive(few):
    return learn(few, photons=PHOTONS, **SETTINGS["adaptive"])


def rows_of(x):
    return {row.tobytes() for row in x}


def test_each_fold_leaves_out_what_its_training_does_not_hold(digits):
    few = replace(digits, x_train=digits.x_train[:90], y_train=digits.y_train[:90])
    folds = characterisation.folds_of(few)
    assert len(folds) == characterisation.FOLDS
    for fold in folds:
        assert not rows_of(fold.x_train) & rows_of(fold.x_test)
        assert rows_of(fold.x_train) | rows_of(fold.x_test) == rows_of(few.x_train)
        part = (
            np.bincount(fold.y_test, minlength=10)
            - np.bincount(few.y_train, minlength=10) / characterisation.FOLDS
        )
        assert np.abs(part).max() < 1
    assert sum(len(fold.x_test) for fold in folds) == 90


def chances(design, data, photons=PHOTONS, seed=3):
    """Probabilities (E, C) of the test scenes, and the classes that are true."""
    if design.exposure.makes_masks:
        options = design.camera, data.x_test, photons, 1, seed
        return np.exp(logits_at_stops(design, *options, [LOOKS - 1])[0])
    scanner = design.front_end(design.camera)
    logits = logits_at_stops(design, scanner, data.x_test, photons, 1, seed)[-1]
    return softmax(logits / stop_temperatures(design.temperatures, photons)[-1], axis=1)


def loss(given, truth):
    return -np.log(given[np.arange(len(truth)), truth].clip(1e-30))


@pytest.mark.parametrize("ratio", [0.1, 1, 10])
def test_few_scenes_make_no_design_worse_than_guessing(design, few, ratio):
    given = chances(design, few, ratio * PHOTONS)
    losses = loss(given, few.y_test)
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


def test_temperatures_change_confidence_and_no_mask_or_answer(adaptive, few):
    plain = replace(
        adaptive,
        exposure=replace(
            adaptive.exposure, prior=adaptive.prior_exposure.prior.with_temperatures(None)
        ),
    )
    states = []
    for each in (adaptive, plain):
        optics = posterior.LookOptics.of(each.camera, each.image_shape, PHOTONS)
        state, generator = (
            AdaptivePosterior(each.prior_exposure.prior, 40, optics),
            torch.Generator(),
        )
        generator.manual_seed(1)
        for share in each.prior_exposure.settings.shares:
            masks = next_masks(state, share, generator)
            counts = torch.poisson(
                state.expected(masks, torch.from_numpy(few.x_test[:40]), share), generator
            )
            state.update(masks, counts, share)
        states.append((masks, counts, state.chances))
    assert torch.equal(states[0][0], states[1][0])
    assert torch.equal(states[0][1], states[1][1])
    assert torch.equal(states[0][2].argmax(dim=1), states[1][2].argmax(dim=1))
    assert float((states[0][2] - states[1][2]).abs().max()) > 0.05
    found, wanted = (evaluate(each, few, PHOTONS, draws=1)[0] for each in (adaptive, plain))
    assert found.confusion == wanted.confusion
    assert found.log_loss < wanted.log_loss

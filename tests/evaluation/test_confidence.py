"""Confidence: how sure a design is agrees with how often it is right, at any light."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import softmax

from conftest import quick
from deepfsi import Camera, Job
from deepfsi.designfile.design_file import Temperatures
from deepfsi.evaluation.confidence import (
    CalibrationScenes,
    draw_logits,
    fit_temperatures,
    measure_left_out,
)
from deepfsi.exposure.kind import temperatures_at
from deepfsi.training.characterisation import find_temperatures

PHOTONS = 1e4
HELD_OUT = 437
TRAINED = {"masks": 8, "photons": PHOTONS, "epochs": 20, "hidden": (32,), "mask_lr": 0.05}
KINDS = {"fixed": TRAINED, "range": {**TRAINED, "photons": 1e3, "span": 1e2}}


@pytest.fixture(scope="module", params=KINDS)
def design(request, digits):
    return quick(digits.hold_out(HELD_OUT), **KINDS[request.param])


@pytest.fixture(scope="module")
def fixed(digits):
    return quick(digits.hold_out(HELD_OUT), **TRAINED)


def answers(design, x, photons, draws=1, seed=1):
    """Classes of the answers to scenes, and how sure the network and the design are of them."""
    logits = draw_logits(design, Camera(), x, photons, draws, seed)
    temperature = float(temperatures_at(design.temperatures, 0, photons))
    raw, sure = (softmax(each, axis=1).max(axis=1) for each in (logits, logits / temperature))
    return logits.argmax(axis=1), raw, sure


@pytest.mark.parametrize("ratio", [0.01, 0.1, 1, 10])
def test_mean_confidence_is_the_accuracy(design, digits, ratio):
    """Five standard deviations of an accuracy of 270 scenes, and 0.05 for one temperature."""
    answer, raw, sure = answers(design, digits.x_test, ratio * PHOTONS, draws=2)
    right = answer == np.repeat(digits.y_test, 2)
    bound = 5 * (right.mean() * (1 - right.mean()) / len(digits.y_test)) ** 0.5 + 0.05
    assert abs(sure.mean() - right.mean()) < bound
    if ratio == 0.01 and design.exposure.entry.kind == "fixed":
        assert raw.mean() > right.mean() + 0.3  # what a network says by itself


def test_held_out_scenes_calibrate_where_there_are_any(fixed, digits):
    rng = np.random.default_rng(0)
    kept = digits.hold_out(HELD_OUT)
    job = Job.model_validate(fixed.info["job"])

    def found(data, *labels):
        shuffled = {name: rng.permutation(getattr(data, name)) for name in labels}
        return find_temperatures(fixed, job, replace(data, **shuffled))[0].logs

    known = found(kept)
    assert np.array_equal(known, fixed.temperatures.logs)
    assert np.array_equal(known, found(kept, "y_train"))
    assert (found(kept, "y_test") > known + 0.5).all()
    assert np.array_equal(found(digits), found(digits, "y_test"))  # none held out: no test scene


RNG = np.random.default_rng(3)
LOGITS = RNG.normal(0, 2, (4000, 4))
BASE = np.array([0.5, 0.0, -1.0, 0.2])


def drawn_classes(logits):
    """A class of each row, as softmax of its logits says."""
    return (logits + RNG.gumbel(size=logits.shape)).argmax(axis=1)


def logs_of(labels, logits, budgets=(1e2, 1e3), trained_on=False, **settings):
    scenes = CalibrationScenes(labels, lambda photons, stop: logits, **settings)
    return fit_temperatures(scenes, np.array(budgets), trained_on=trained_on).logs


@pytest.mark.parametrize("base", [0.0, BASE])
@pytest.mark.parametrize("tau", [0.4, 3.0])
def test_a_temperature_makes_probabilities_those_of_the_classes(tau, base):
    """To five errors, of which 4000 scenes leave 0.03; shifts of all logits change nothing."""
    labels = drawn_classes(LOGITS + base)
    found = logs_of(labels, 700 + tau * LOGITS, base=base)
    assert found == pytest.approx(np.full((1, 2), np.log(tau)), abs=0.15)
    up = logs_of(labels, tau * LOGITS, base=base, trained_on=True)
    assert up == pytest.approx(found.clip(min=0), abs=0.02)


@pytest.mark.parametrize("draws", [1, 2])
def test_doubt_is_as_many_scenes_of_any_class_alike(draws):
    """So the fit is that of all scenes four times, and of each with every class once."""
    labels = drawn_classes(0.5 * LOGITS)
    found = logs_of(labels, LOGITS, draws=draws, doubt=4000 / draws, base=BASE)
    every = np.concatenate([np.tile(labels, 4), *(np.full(4000, k) for k in range(4))])
    assert found == pytest.approx(logs_of(every, np.tile(LOGITS, (8, 1)), base=BASE), abs=0.02)
    assert (found > logs_of(labels, LOGITS, base=BASE) + 0.3).all()


def test_eight_numbers_of_masks_are_fitted_and_lines_join_them():
    """At their own budgets; the temperature rises here as the square root of the number."""
    labels, asked = drawn_classes(LOGITS), []

    def logits(photons, stop):
        asked.append((photons, stop))
        return LOGITS * (stop + 1) ** 0.5 * photons

    scenes = CalibrationScenes(labels, logits, stops=30)
    found = fit_temperatures(scenes, np.array([1.0, 2.0]), trained_on=False)
    fitted = np.array([1, 2, 3, 4, 7, 11, 18, 30]) - 1
    assert asked == [(budget, stop) for budget in (1.0, 2.0) for stop in fitted]
    lines = np.interp(np.arange(30), fitted, np.log(fitted + 1) / 2)
    assert found.logs == pytest.approx(lines[:, None] + np.log([1, 2]), abs=0.12)


@pytest.mark.parametrize(
    ("clear", "unseen", "guesses"), [(4.0, 0.6, False), (4.0, 0.0, True), (0.3, 0.6, True)]
)
def test_scenes_left_out_are_tested_beside_guesses(clear, unseen, guesses):
    """Two exposures of a scene are one scene; its error is that of a mean over scenes."""
    labels = np.repeat([0, 1, 1, 2, 0], 2)
    logits = clear * np.eye(3)[[0, 0, 1, 2, 1, 1, 2, 2, 1, 0]]
    scenes = CalibrationScenes(labels, lambda _, stop: stop * logits, 2, draws=2, base=BASE[:3])
    fitted = Temperatures(np.log([[1.0, 1.0], [2.0, 2.0]]), np.array([1e3, 1e4]))
    guess = np.array([0.5 - unseen / 2, 0.5 - unseen / 2, unseen])
    found = measure_left_out(scenes, fitted, 3e3, guess)
    rows = np.arange(10)
    losses, raw = (
        -np.log(softmax(logits / each + BASE[:3], axis=1)[rows, labels]) for each in (2, 1)
    )
    guessed = -np.log(np.maximum(guess, 1e-6))[labels]
    error = (losses - guessed).reshape(5, 2).mean(axis=1).std() / 5**0.5
    right = (logits + BASE[:3]).argmax(axis=1) == labels
    assert (found.scenes, found.accuracy) == (5, right.mean())
    assert (found.log_loss, found.uncalibrated_log_loss) == pytest.approx(
        (losses.mean(), raw.mean())
    )
    assert (found.guessing, found.error) == pytest.approx((guessed.mean(), error))
    assert found.guesses is guesses is bool(losses.mean() + 2 * error >= guessed.mean())

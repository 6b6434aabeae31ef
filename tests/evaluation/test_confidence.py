"""Confidence: how sure a design is agrees with how often it is right, at any light."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.special import softmax

from conftest import quick
from deepfsi import Camera
from deepfsi.designfile.design_file import calibration_budgets
from deepfsi.evaluation.confidence import (
    CalibrationScenes,
    Labelled,
    draw_logits,
    fit_temperatures,
)
from deepfsi.exposure.kind import temperatures_at
from deepfsi.jobs.job import Job
from deepfsi.training.characterisation import find_temperatures

PHOTONS = 1e4
HELD_OUT = 437
TRAINED = {"masks": 8, "photons": PHOTONS, "epochs": 20, "hidden": (32,), "mask_lr": 0.05}
KINDS = {
    "fixed": TRAINED,
    "range": {**TRAINED, "photons": 1e3, "span": 1e2},
}


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


def test_scenes_of_the_training_make_no_network_surer(fixed, digits):
    """One that is three times less sure than it could be stays so, unless scenes were held out."""
    x, y = (getattr(digits.hold_out(HELD_OUT), name) for name in ("x_test", "y_test"))
    dim = torch.nn.Linear(10, 10, bias=False)
    dim.weight.data = 0.2 * torch.eye(10)
    shy = replace(fixed, classifier=torch.nn.Sequential(fixed.classifier, dim))
    scenes = CalibrationScenes.of([Labelled(shy, Camera(), x, y)], seed=0)
    left_out, trained_on = (
        fit_temperatures(scenes, calibration_budgets(PHOTONS, PHOTONS), trained_on=seen)
        for seen in (False, True)
    )
    assert left_out.logs.min() < -0.5
    assert trained_on.logs.min() == 0

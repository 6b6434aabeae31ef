"""Confidence: how sure a design is agrees with how often it is right, at any light."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.special import softmax

from conftest import quick
from deepfsi import Design, evaluate
from deepfsi.designfile import calibration_budgets
from deepfsi.evaluation import CalibrationScenes, Exposed, fit_temperatures, logits_at_stops
from deepfsi.jobs import Job
from deepfsi.measures.reliability import BINS
from deepfsi.networks import stop_temperatures
from deepfsi.training import find_temperatures


class _Times(torch.nn.Module):
    def __init__(self, factor: float) -> None:
        super().__init__()
        self.factor = factor

    def forward(self, logits: torch.Tensor) -> torch.Tensor:
        return self.factor * logits


def fitted(design, data, trained_on):
    scenes = CalibrationScenes([Exposed(design, design.scanner(), data.x_test, data.y_test)], 1)
    budgets = calibration_budgets(PHOTONS, PHOTONS)
    return fit_temperatures(scenes, budgets, trained_on=trained_on, seed=0)


PHOTONS = 1e4
HELD_OUT = 437
TRAINED = {"masks": 8, "photons": PHOTONS, "epochs": 20, "hidden": (32,), "mask_lr": 0.05}
ONE_DEVICE = {"light": "free-dwell", "rails": "single"}
KINDS = {
    "fixed": TRAINED,
    "range": {**TRAINED, "photons": 1e3, "span": 1e2},
    "nested": {**TRAINED, "nested": 2, **ONE_DEVICE},
    "looks": {**TRAINED, "looks": 3, **ONE_DEVICE},
}


@pytest.fixture(scope="module", params=KINDS)
def design(request, digits):
    return quick(digits.hold_out(HELD_OUT), **KINDS[request.param])


@pytest.fixture(scope="module")
def fixed(digits):
    return quick(digits.hold_out(HELD_OUT), **TRAINED)


def answers(design, digits, photons, seed=1):
    """Confidence and rightness of answers to the test scenes."""
    [logits] = logits_at_stops(design, design.scanner(), digits.x_test, photons, 2, seed)[-1:]
    [temperature] = stop_temperatures(design.temperatures, photons)[-1:]
    right = logits.argmax(axis=1) == np.repeat(digits.y_test, 2)
    return softmax(logits, axis=1).max(axis=1), softmax(logits / temperature, axis=1), right


@pytest.mark.parametrize("ratio", [0.01, 0.1, 1, 10])
def test_mean_confidence_is_the_accuracy(design, digits, ratio):
    """Five standard deviations of an accuracy of 270 scenes, and 0.05 for one temperature."""
    raw, calibrated, right = answers(design, digits, ratio * PHOTONS)
    bound = 5 * (right.mean() * (1 - right.mean()) / len(digits.y_test)) ** 0.5 + 0.05
    assert abs(calibrated.max(axis=1).mean() - right.mean()) < bound
    if ratio == 0.01 and "photons" not in vars(design.exposure):
        assert raw.mean() > right.mean() + 0.3  # what a network says by itself


def test_two_photons_make_nobody_sure(design):
    """Of any scene, the blank one too; without temperatures most are answered at once."""
    scenes = torch.cat([torch.rand(200, 64, generator=torch.Generator().manual_seed(0)),
                        torch.zeros(1, 64), torch.ones(1, 64)])  # fmt: skip
    unsure = replace(design, temperatures=None)
    told = []
    for each in (design, unsure):
        logits = logits_at_stops(each, each.scanner(), scenes.numpy(), 2.0, 5, 0)[-1]
        [temperature] = (
            stop_temperatures(each.temperatures, 2.0)[-1:] if each.temperatures else [1.0]
        )
        told.append(softmax(logits / temperature, axis=1).max(axis=1))
    assert told[0].max() < 0.75
    assert told[0].mean() < 0.25
    assert told[1].mean() > 0.6


def test_the_error_of_a_result_is_that_of_its_answers(fixed, digits):
    counts = []
    [found] = evaluate(fixed, digits, 3e3, draws=1, seed=5)
    logits = logits_at_stops(fixed, fixed.scanner(), digits.x_test, 3e3, 1, 5)[-1]
    [temperature] = stop_temperatures(fixed.temperatures, 3e3)
    sure = softmax(logits / temperature, axis=1).max(axis=1)
    order = np.argsort(sure, kind="stable")
    right = (logits.argmax(axis=1) == digits.y_test)[order]
    for part in np.array_split(np.arange(len(right)), BINS):
        counts.append(len(part) * abs(sure[order][part].mean() - right[part].mean()))
    assert found.calibration_error == pytest.approx(sum(counts) / len(right), abs=1e-5)


def test_held_out_scenes_calibrate_where_there_are_any(fixed, digits):
    rng = np.random.default_rng(0)
    kept = digits.hold_out(HELD_OUT)
    shuffled = replace(kept, y_test=rng.permutation(kept.y_test))
    others = replace(kept, y_train=rng.permutation(kept.y_train))
    job = Job.model_validate(fixed.info["job"])
    known, wrong, same = (
        find_temperatures(fixed, job, data)[0].logs for data in (kept, shuffled, others)
    )
    assert np.array_equal(known, fixed.temperatures.logs)
    assert np.array_equal(known, same)
    assert (wrong > known + 0.5).all()
    test = replace(digits, y_test=rng.permutation(digits.y_test))  # of none held out: no test scene
    own, its = (find_temperatures(fixed, job, each)[0].logs for each in (digits, test))
    assert np.array_equal(own, its)


def test_scenes_of_the_training_make_no_network_surer(fixed, digits):
    """One that is three times less sure than it could be stays so, unless scenes were held out."""
    kept = digits.hold_out(HELD_OUT)
    shy = replace(fixed, classifier=torch.nn.Sequential(fixed.classifier, _Times(0.2)))
    assert fitted(shy, kept, False).logs.min() < -0.5
    assert fitted(shy, kept, True).logs.min() == 0


def test_first_masks_and_dimmer_devices_have_the_temperatures_of_their_light(digits, tmp_path):
    design = quick(digits.hold_out(HELD_OUT), **KINDS["nested"])
    for shown in (2, 5, 8):
        part = design.first(shown)
        share = part.exposure.used / design.exposure.used
        wanted = stop_temperatures(design.temperatures, 3e3)[shown - 2]
        assert stop_temperatures(part.temperatures, 3e3 * share)[-1] == pytest.approx(wanted)
        again = Design.load(part.save(tmp_path / "part.safetensors"))
        assert np.array_equal(again.temperatures.logs, part.temperatures.logs)
    shown = design.as_shown(design.rails.stacked.numpy() / 2, design.image_shape, 0.5)
    counts = np.full(design.counts_shape, 40.0)
    np.testing.assert_allclose(
        shown.classify(counts, 2 * PHOTONS), design.classify(counts, PHOTONS), atol=1e-5
    )

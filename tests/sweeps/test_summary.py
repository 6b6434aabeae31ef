"""Points of a comparison."""

import numpy as np
import pytest
from scipy import stats

from deepfsi.sweeps.summary import summarise
from shared.trials import small


def record(photons, masks, seed, validation, test, noise="ml_gauss"):
    result = {"noise": "poisson", "photons": photons, "throughput": 0.5, "low": 0.1, "high": 0.9}
    result["levels"] = 0
    job = {"light": "column", "rails": "dual", "design": "pca", "photons": photons, "masks": masks}
    job["noise"] = noise
    return {
        "key": f"{masks}-{seed}",
        "design": f"{masks}-{seed}",
        "trial": {"job": job, "variant": ""},
        "validation": [{**result, "accuracy": validation}],
        "test": [{**result, "accuracy": test}],
        "info": {"seconds": 1.0, "device": "cpu"},
    }


def summary(data, records, **changes):
    return summarise(small(**changes), data, records, command="deepfsi", seconds=1.0).points


def test_mask_counts_are_chosen_on_validation_never_on_test(digits):
    records = [record(1e3, 3, 0, 0.8, 0.5), record(1e3, 6, 0, 0.7, 0.9)]
    best = [point.masks for point in summary(digits, records) if point.best]
    assert best == [3]


def test_interval_over_trials_is_students(digits):
    values = [0.80, 0.83, 0.85, 0.79]
    (point,) = summary(digits, [record(1e3, 3, k, 0.8, v) for k, v in enumerate(values)])
    low, high = stats.t.interval(0.95, 3, loc=np.mean(values), scale=stats.sem(values))
    assert (point.low, point.high) == pytest.approx((low, high))
    assert "4 trials" in point.covers


def test_interval_of_one_trial_is_that_of_its_images(digits):
    (point,) = summary(digits, [record(1e3, 3, 0, 0.8, 0.5)])
    assert (point.low, point.high) == (0.1, 0.9)
    assert "images" in point.covers


def test_trials_of_different_training_noise_are_different_points(digits):
    records = [record(1e3, 3, 0, 0.8, 0.5, noise) for noise in ("ml_gauss", "gaussian")]
    points = summary(digits, records)
    assert [(point.trained_under, point.trials) for point in points] == [
        ("ml_gauss", 1),
        ("gaussian", 1),
    ]


def test_without_validation_nothing_is_chosen(digits):
    records = [record(1e3, 3, 0, 0.8, 0.5), record(1e3, 6, 0, 0.7, 0.9)]
    for entry in records:
        entry["validation"] = []
    assert all(point.best for point in summary(digits, records, validation=0))

"""Points of a comparison."""

import numpy as np
import pytest
from scipy import stats

from deepfsi.base.numeric import (
    accuracy_interval,
    balanced_interval,
    pack_values,
    student,
    unpack_values,
)
from deepfsi.sweeps import FoldRecords, summarise_records
from shared.trials import small


def record(photons, masks, seed, validation, test, noise="ml_gauss", detectors="1x1"):
    result = {"noise": "poisson", "photons": photons, "throughput": 0.5, "low": 0.1, "high": 0.9}
    result["covers"] = "test images"
    result |= {"counts": 0.5 * photons, "arriving": 0.5 * photons, "log_loss": 0.7}
    result |= {"levels": 0, "balanced": 0.4, "balanced_low": 0.2, "balanced_high": 0.6}
    result["rates"] = [0.4] * 10
    result["confusion"] = np.ones((10, 10)).tolist()
    camera = {"light": "column", "rails": "dual", "readout": "difference"}
    camera["detectors"] = detectors
    job = {"design": "pca", "photons": photons, "masks": masks}
    job |= {"camera": camera, "exposure": {}}
    return {
        "key": f"{masks}-{seed}",
        "design": f"{masks}-{seed}",
        "trial": {"job": job, "trained_under": noise, "variant": "", "detectors": detectors},
        "validation": [{**result, "accuracy": validation}],
        "test": [{**result, "accuracy": test}],
        "info": {"seconds": 1.0, "device": "cpu"},
    }


def summarise(data, records, **changes):
    folds = [FoldRecords(data, records)]
    return summarise_records(small(**changes), data, folds, command="deepfsi", seconds=1.0)


def summary(data, records, **changes):
    return summarise(data, records, **changes).points


def test_mask_counts_are_chosen_on_validation_never_on_test(digits):
    records = [record(1e3, 3, 0, 0.8, 0.5), record(1e3, 6, 0, 0.7, 0.9)]
    best = [point.masks for point in summary(digits, records) if point.best]
    assert best == [3]


def test_counts_are_the_mean_over_trials(digits):
    bright = record(1e3, 3, 1, 0.8, 0.5)
    bright["test"][0] |= {"counts": 700.0, "arriving": 900.0, "log_loss": 0.5}
    (point,) = summary(digits, [record(1e3, 3, 0, 0.8, 0.5), bright])
    assert (point.counts, point.arriving) == (600, 700)
    assert point.log_loss == pytest.approx(0.6)


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


def test_trials_of_other_detectors_are_other_points_with_masks_of_their_own(digits):
    records = [
        record(1e3, masks, 0, validation, 0.5, detectors=detectors)
        for detectors, masks, validation in (("1x1", 3, 0.6), ("1x1", 6, 0.7), ("2x2", 3, 0.8))
    ]
    best = {(p.detectors, p.masks) for p in summary(digits, records) if p.best}
    assert best == {("1x1", 6), ("2x2", 3)}
    ratios = {(p.detectors, p.masks): p.ratio for p in summary(digits, records)}
    assert ratios == {("1x1", 3): 3 / 64, ("1x1", 6): 6 / 64, ("2x2", 3): 12 / 64}


def test_trials_that_read_rails_otherwise_are_other_points(digits):
    records = [record(1e3, 3, 0, 0.8, 0.5) for _ in range(3)]
    ways = (("dual", "difference"), ("dual", "both"), ("single", "difference"))
    for entry, (rails, readout) in zip(records, ways, strict=True):
        entry["trial"]["job"]["camera"] |= {"rails": rails, "readout": readout}
    points = summary(digits, records)
    assert [(p.readout, p.trials) for p in points] == [("difference", 1), ("both", 1), ("", 1)]


def test_without_validation_nothing_is_chosen(digits):
    records = [record(1e3, 3, 0, 0.8, 0.5), record(1e3, 6, 0, 0.7, 0.9)]
    for entry in records:
        entry["validation"] = []
    assert all(point.best for point in summary(digits, records, validation=0))


def unlike(entry, balanced, rates=None):
    """A record whose classes differ in their accuracy."""
    for tests in (entry["validation"], entry["test"]):
        for test in tests:
            test |= {"balanced": balanced, "rates": rates or test["rates"]}
    return entry


def test_balanced_accuracy_has_the_interval_of_accuracy(digits):
    values = [0.80, 0.83, 0.85, 0.79]
    records = [unlike(record(1e3, 3, k, 0.8, 0.9), v) for k, v in enumerate(values)]
    (point,) = summary(digits, records)
    low, high = stats.t.interval(0.95, 3, loc=np.mean(values), scale=stats.sem(values))
    assert point.balanced == pytest.approx(np.mean(values))
    assert (point.balanced_low, point.balanced_high) == pytest.approx((low, high))
    (alone,) = summary(digits, records[:1])
    assert (alone.balanced_low, alone.balanced_high) == (0.2, 0.6)


def test_the_worst_class_is_that_of_the_mean_over_trials(digits):
    """Not the mean of each trial's worst; a class without test scenes has no accuracy."""
    first, second = ([0.9] * 9 + [None] for _ in range(2))
    first[3], second[3], first[5], second[6] = 0.5, 0.5, 0.3, 0.3
    records = [unlike(record(1e3, 3, k, 0.8, 0.9), 0.8, v) for k, v in enumerate((first, second))]
    (point,) = summary(digits, records)
    assert (point.worst, point.worst_class) == (pytest.approx(0.5), 3)


def test_a_class_that_is_never_recognised_is_the_worst_with_none(digits):
    (point,) = summary(digits, [unlike(record(1e3, 3, 0, 0.8, 0.9), 0.8, [0.9] * 4 + [0.0, None])])
    assert (point.worst, point.worst_class) == (0.0, 4)


@pytest.mark.parametrize("balance", [False, True])
def test_a_balanced_training_is_chosen_by_balanced_accuracy(digits, balance):
    records = [
        unlike(record(1e3, 3, 0, 0.8, 0.9), 0.3),
        unlike(record(1e3, 6, 0, 0.7, 0.9), 0.6),
    ]
    training = {"epochs": 2, "balance": balance}
    best = [p.masks for p in summary(digits, records, training=training) if p.best]
    assert best == [6 if balance else 3]


@pytest.mark.parametrize(("columns", "one"), [([3], True), ([3, 4], False)])
def test_a_design_that_answers_one_class_only_is_known_and_chance_is_that_class(
    digits, columns, one
):
    made = record(1e3, 3, 0, 0.8, 0.5)
    confusion = np.zeros((10, 10))
    confusion[:, columns] = 1
    made["test"][0]["confusion"] = confusion.tolist()
    results = summarise(digits, [made])
    assert [point.one_class for point in results.points] == [one]
    shares = [np.mean(digits.y_test == k) for k in range(10)]
    assert results.data.chance == pytest.approx(max(shares))


def test_confusions_are_the_sum_over_trials_at_chosen_mask_counts(digits):
    records = [record(1e3, m, k, v, 0.5) for m, v in ((3, 0.8), (6, 0.7)) for k in range(2)]
    found = {point.masks: point for point in summary(digits, records)}
    assert found[3].best
    assert np.array_equal(found[3].confusion, np.full((10, 10), 2))
    assert found[6].confusion == ()


def with_images(entry, right):
    """A record that keeps the share of draws of each test image that are right."""
    terms = {"accuracy": pack_values(right)}
    return {
        **entry,
        "test": [{**entry["test"][0], "accuracy": float(right.mean()), "terms": terms}],
    }


def test_an_interval_over_trials_covers_images_and_seeds_where_records_keep_them(digits):
    """One meaning of ±, whatever the number of trials: more trainings do not know other images."""
    rng = np.random.default_rng(0)
    chance = rng.random(len(digits.y_test)) ** 0.5
    rows = [rng.binomial(3, chance) / 3 for _ in range(3)]
    records = [with_images(record(1e3, 3, k, 0.8, 0.5), row) for k, row in enumerate(rows)]
    (point,) = summary(digits, records)
    assert (point.accuracy, point.low, point.high) == pytest.approx(
        accuracy_interval(np.stack(rows)), abs=1e-6
    )
    ends = balanced_interval(np.stack(rows), digits.y_test)[1:]
    assert (point.balanced_low, point.balanced_high) == pytest.approx(ends, abs=1e-6)
    assert point.high - point.low > 2 * 1.9 * np.std(np.mean(rows, axis=0)) / len(chance) ** 0.5
    assert "images" in point.covers
    assert "3 trainings" in point.covers
    assert [unpack_values(text) for text in point.terms] == [
        pytest.approx(row, abs=1e-6) for row in rows
    ]


def test_records_of_an_earlier_version_keep_the_old_rule_and_say_so(digits):
    rng = np.random.default_rng(0)
    old = [record(1e3, 3, k, 0.8, v) for k, v in enumerate((0.80, 0.83))]
    new = with_images(record(1e3, 3, 2, 0.8, 0.5), rng.binomial(3, 0.8, len(digits.y_test)) / 3)
    (point,) = summary(digits, [*old, new])
    assert (point.low, point.high) == pytest.approx(student(point.accuracies))
    assert "earlier version" in point.covers
    assert point.terms == ()


def test_images_are_kept_of_the_chosen_masks_alone(digits):
    right = np.ones(len(digits.y_test))
    records = [with_images(record(1e3, m, 0, m / 10, 0.5), right) for m in (3, 6)]
    assert [(p.masks, bool(p.terms)) for p in summary(digits, records)] == [(3, False), (6, True)]


def test_lit_masks_are_those_that_get_light_in_the_mean_over_trials(digits):
    records = [record(1e3, 3, seed, 0.8, 0.5) for seed in range(2)]
    records[0]["test"][0]["photons_per_mask"] = [3.0, 0.0, 1e-9]
    (point,) = summary(digits, records)
    assert point.lit is None  # a record of an earlier version does not say
    records[1]["test"][0]["photons_per_mask"] = [1.0, 2.0, 3.0]
    (point,) = summary(digits, records)
    assert point.lit == 2.5

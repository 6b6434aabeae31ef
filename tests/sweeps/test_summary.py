"""Points of a comparison."""

import numpy as np
import pytest

from deepfsi.base import intervals
from deepfsi.sweeps.summary import summarise_records
from shared.trials import small

PHOTONS = 1e3
TERMS = {"accuracy": intervals.pack_values(np.full(360, 0.5))}


def record(accuracy=0.5, masks=3, seed=0, validation=0.8, noise="ml_gauss", camera=(), **test):
    """A record of one test, some of whose numbers are `test`; classes are alike unless told."""
    result = {
        "noise": "poisson", "photons": PHOTONS, "throughput": 0.5, "low": 0.1, "high": 0.9,
        "covers": "test images", "counts": 500.0, "arriving": 500.0, "log_loss": 0.7,
        "levels": 0, "balanced": 0.4, "balanced_low": 0.2, "balanced_high": 0.6,
        "rates": [0.4] * 10, "confusion": np.ones((10, 10)).tolist(), "terms": TERMS, **test,
    }  # fmt: skip
    usual = {"light": "column", "rails": "dual", "readout": "difference", "detectors": "1x1"}
    camera = {**usual, **dict(camera)}
    job = {"design": "pca", "photons": PHOTONS, "masks": masks, "camera": camera, "exposure": {}}
    trained = {"trained_under": noise, "variant": "", "detectors": camera["detectors"]}
    return {
        "key": f"{masks}-{seed}",
        "design": f"{masks}-{seed}",
        "trial": {"job": job, **trained},
        "validation": [{**result, "accuracy": validation}],
        "test": [{**result, "accuracy": accuracy}],
        "info": {"seconds": 1.0, "device": "cpu"},
    }


def summarise(data, records, **changes):
    recipe = small(**changes)
    return summarise_records(recipe, data, [data], [records], command="deepfsi", seconds=1.0)


def summary(data, records, **changes):
    return summarise(data, records, **changes).points


def test_mask_counts_are_chosen_on_validation_never_on_test(digits):
    records = [record(0.5, 3, validation=0.8), record(0.9, 6, validation=0.7)]
    assert [point.masks for point in summary(digits, records) if point.best] == [3]
    for entry in records:
        entry["validation"] = []
    assert all(point.best for point in summary(digits, records, validation=0))


@pytest.mark.parametrize("balance", [False, True])
def test_a_balanced_training_is_chosen_by_balanced_accuracy(digits, balance):
    records = [record(0.9, 3, validation=0.8, balanced=0.3)]
    records.append(record(0.9, 6, validation=0.7, balanced=0.6))
    training = {"epochs": 2, "balance": balance}
    best = [p.masks for p in summary(digits, records, training=training) if p.best]
    assert best == [6 if balance else 3]


@pytest.mark.parametrize(
    ("field", "records"),
    [
        ("trained_under", {noise: {"noise": noise} for noise in ("ml_gauss", "gaussian")}),
        ("detectors", {each: {"camera": {"detectors": each}} for each in ("1x1", "2x2")}),
        (
            "readout",
            {
                "difference": {},
                "both": {"camera": {"readout": "both"}},
                "": {"camera": {"rails": "single"}},
            },
        ),
    ],
)
def test_trials_that_differ_are_other_points(digits, field, records):
    points = summary(digits, [record(**each) for each in records.values()])
    assert [(getattr(p, field), p.trials) for p in points] == [(each, 1) for each in records]


def test_trials_of_other_detectors_have_masks_of_their_own(digits):
    cases = (("1x1", 3, 0.6), ("1x1", 6, 0.7), ("2x2", 3, 0.8))
    points = summary(
        digits, [record(0.5, m, validation=v, camera={"detectors": d}) for d, m, v in cases]
    )
    ratios = {(p.detectors, p.masks): (p.ratio, p.best) for p in points}
    wanted = [(3 / 64, False), (6 / 64, True), (12 / 64, True)]
    assert ratios == {case[:2]: each for case, each in zip(cases, wanted, strict=True)}


def test_the_worst_class_is_that_of_the_mean_over_trials(digits):
    """Not the mean of each trial's worst; a class without test scenes has no accuracy."""
    first, second = ([0.9] * 9 + [None] for _ in range(2))
    first[3], second[3], first[5], second[6] = 0.5, 0.5, 0.3, 0.3
    (point,) = summary(digits, [record(seed=k, rates=v) for k, v in enumerate((first, second))])
    assert (point.worst, point.worst_class) == (pytest.approx(0.5), 3)
    (never,) = summary(digits, [record(rates=[0.9] * 4 + [0.0, None])])
    assert (never.worst, never.worst_class) == (0.0, 4)


@pytest.mark.parametrize(("columns", "one"), [([3], True), ([3, 4], False)])
def test_a_design_that_answers_one_class_only_is_known_and_chance_is_that_class(
    digits, columns, one
):
    confusion = np.zeros((10, 10))
    confusion[:, columns] = 1
    results = summarise(digits, [record(confusion=confusion.tolist())])
    assert [point.one_class for point in results.points] == [one]
    shares = [np.mean(digits.y_test == k) for k in range(10)]
    assert results.data.chance == pytest.approx(max(shares))


def test_confusions_and_images_are_kept_of_the_chosen_masks_alone(digits):
    records = [record(1.0, m, k, validation=v) for m, v in ((3, 0.8), (6, 0.7)) for k in range(2)]
    chosen, other = summary(digits, records)
    assert (chosen.masks, chosen.best) == (3, True)
    assert np.array_equal(chosen.confusion, np.full((10, 10), 2))
    assert len(chosen.terms) == 2
    assert (other.confusion, other.terms) == ((), ())


def test_an_interval_over_trials_covers_images_and_seeds_where_records_keep_them(digits):
    """One meaning of ±, whatever the number of trials: more trainings do not know other images."""
    rng = np.random.default_rng(0)
    chance = rng.random(len(digits.y_test)) ** 0.5
    rows = np.stack([rng.binomial(3, chance) / 3 for _ in range(3)])
    terms = [{"accuracy": intervals.pack_values(row)} for row in rows]
    means = rows.mean(axis=1).tolist()
    records = [record(means[k], seed=k, terms=each) for k, each in enumerate(terms)]
    (point,) = summary(digits, records)
    interval = intervals.accuracy_interval(rows)
    assert (point.accuracy, point.low, point.high) == pytest.approx(interval, abs=1e-6)
    ends = intervals.balanced_interval(rows, digits.y_test)[1:]
    assert (point.balanced_low, point.balanced_high) == pytest.approx(ends, abs=1e-6)
    assert point.high - point.low > 2 * 1.9 * np.std(np.mean(rows, axis=0)) / len(chance) ** 0.5
    assert "images" in point.covers
    assert "3 trainings" in point.covers
    kept = np.stack([intervals.unpack_values(text) for text in point.terms])
    np.testing.assert_allclose(kept, rows, atol=1e-6)


def test_lit_masks_are_those_that_get_light_in_the_mean_over_trials(digits):
    records = [record(seed=0, photons_per_mask=[3.0, 0.0, 1e-9]), record(seed=1)]
    (point,) = summary(digits, records)
    assert point.lit is None  # of a trial that does not say
    records[1]["test"][0]["photons_per_mask"] = [1.0, 2.0, 3.0]
    (point,) = summary(digits, records)
    assert point.lit == 2.5

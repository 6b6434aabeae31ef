"""Differences of accuracies, trial by trial, and what they say of a claim."""

import math
from itertools import product

import numpy as np
import pytest
from scipy import stats

from deepfsi.base.numeric import (
    Difference,
    accuracy_difference,
    accuracy_interval,
    all_above,
    mean_of_trials,
    pack_values,
    paired_difference,
    unpack_values,
)
from deepfsi.base.numeric import intervals as differences
from shared.results import a_point


def point(accuracies, half=0.01):
    return a_point(float(np.mean(accuracies)), half, accuracies=tuple(accuracies))


def test_trials_are_paired():
    """What all trials share cancels: a constant difference has no width."""
    shared = np.array([0.5, 0.7, 0.9])
    found = accuracy_difference(point(shared + 0.02), point(shared))
    assert (found.mean, found.low, found.high) == pytest.approx((0.02, 0.02, 0.02))


def test_an_interval_over_trials_covers_what_it_says():
    """Student's interval of five normal values holds their mean in 95 % of cases."""
    rng = np.random.default_rng(0)
    runs = 2000
    held = [
        each.low <= 0.3 <= each.high
        for each in (mean_of_trials(0.3 + 0.1 * rng.standard_normal(5)) for _ in range(runs))
    ]
    assert abs(np.mean(held) - 0.95) <= 5 * math.sqrt(0.95 * 0.05 / runs)


def answers(rng, images, seeds, gain):
    """Shares right (S, n) of two designs on the same images, the first better by `gain`."""
    image = 1.5 * rng.standard_normal(images)
    both = []
    for better in (gain, 0.0):
        seed = 0.1 * rng.standard_normal((seeds, 1)) * (seeds > 1)
        chance = stats.norm.cdf(0.8 + better + image + seed)
        both.append(rng.binomial(3, chance) / 3)
    return both


@pytest.mark.parametrize(("images", "seeds"), [(24, 1), (100, 1), (100, 3), (1000, 3)])
def test_alike_designs_are_told_apart_in_at_most_five_of_a_hundred_studies(images, seeds):
    rng = np.random.default_rng(images + seeds)
    found = [paired_difference(*answers(rng, images, seeds, 0.0)) for _ in range(400)]
    told = sum(each.low > 0 or each.high < 0 for each in found)
    assert told <= stats.binom.ppf(1 - 3e-5, 400, 0.05)


def test_pairs_tell_apart_what_intervals_beside_each_other_do_not():
    """What makes an image hard for both designs cancels."""
    rng = np.random.default_rng(1)
    apart = overlapping = 0
    for _ in range(100):
        one, other = answers(rng, 400, 1, 0.3)
        apart += paired_difference(one, other).low > 0
        overlapping += accuracy_interval(one).low <= accuracy_interval(other).high
    assert apart >= 80
    assert overlapping >= 80


def test_few_images_that_differ_may_be_of_one_sign_by_chance():
    """By the sign test five of one sign have p = 0.06, six have 0.03; so for thirds of draws."""
    for images, size in product((24, 200, 10_000), (1, 1 / 3)):
        wrong = np.zeros((1, images))
        for more, told in ((5, False), (6, True)):
            right = wrong + size * (np.arange(images) < more)
            assert (paired_difference(right, wrong).low > 0) is told


def test_as_many_trainings_are_paired_and_others_are_not():
    rng = np.random.default_rng(0)
    image, seed = rng.random((1, 50)), 0.1 * rng.random((4, 1))
    assert paired_difference(image + seed, image + seed).seeds_error == pytest.approx(0, abs=1e-12)
    alone = paired_difference(image + seed, image)
    assert alone.seeds_error == pytest.approx(float(stats.sem(seed[:, 0])))
    assert alone.seeds_freedom == 3


def test_points_are_paired_by_the_terms_of_their_images():
    one, other = answers(np.random.default_rng(0), 60, 2, 0.5)
    points = [point(rows.mean(axis=1)).model_copy(update={"terms": tuple(map(pack_values, rows))})
              for rows in (one, other)]  # fmt: skip
    found, expected = accuracy_difference(*points), paired_difference(one, other)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), abs=1e-6)
    assert (-found).high == -found.low


def test_damaged_terms_are_refused():
    values = np.array([0.0, 1 / 3, 1.0])
    text = pack_values(values)
    assert unpack_values(text) == pytest.approx(values, abs=1e-7)
    for damaged in (
        "",
        "§",
        text[:-8],
        text[:8] + "AAAA" + text[12:],
        pack_values(np.array([np.nan])),
    ):
        with pytest.raises(ValueError, match=r"values|base64|padding|characters|ascii"):
            unpack_values(damaged)


def spread(low, high):
    """Difference of a normal error with this 95 % interval."""
    return Difference((low + high) / 2, (high - low) / 2 / stats.norm.ppf(0.975))


def test_single_trials_combine_the_intervals_over_images():
    found = accuracy_difference(point([0.8], 0.03), point([0.7], 0.04))
    assert (found.mean, found.high - found.mean) == pytest.approx((0.1, 0.05))


@pytest.mark.parametrize(
    ("intervals", "answer"),
    [
        ([(0.1, 0.2), (0.01, 0.3)], True),
        ([(0.1, 0.2), (-0.01, 0.3)], None),
        ([(-0.3, -0.01)], False),
        ([(0.1, 0.2), (-0.3, -0.1)], False),
        ([(0.1, 0.2), (-0.3, -0.001)], None),
    ],
)
def test_a_claim_holds_only_where_every_interval_says_so(intervals, answer):
    """One of several intervals just below 0 is no surprise, and leaves the claim open."""
    assert all_above(spread(low, high) for low, high in intervals) is answer


def test_signs_are_as_wide_as_each_other():
    assert differences.signed_text(-0.01) == "−0.010"
    assert str(spread(-0.2, 0.4)) == "+0.100 [−0.200, +0.400]"
    assert str(mean_of_trials([0.1])) == "+0.100 (one trial, no interval)"

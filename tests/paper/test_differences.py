"""Differences of accuracies, trial by trial, and what they say of a claim."""

import math

import numpy as np
import pytest
from scipy import stats

from deepfsi_paper import differences
from deepfsi_paper.differences import Difference, above, difference, of_trials
from shared.results import a_point


def point(accuracies, half=0.01):
    return a_point(float(np.mean(accuracies)), half, accuracies=tuple(accuracies))


def test_trials_are_paired():
    """What all trials share cancels: a constant difference has no width."""
    shared = np.array([0.5, 0.7, 0.9])
    found = difference(point(shared + 0.02), point(shared))
    assert (found.mean, found.low, found.high) == pytest.approx((0.02, 0.02, 0.02))


def test_an_interval_over_trials_covers_what_it_says():
    """Student's interval of five normal values holds their mean in 95 % of cases."""
    rng = np.random.default_rng(0)
    runs = 2000
    held = [
        each.low <= 0.3 <= each.high
        for each in (of_trials(0.3 + 0.1 * rng.standard_normal(5)) for _ in range(runs))
    ]
    assert abs(np.mean(held) - 0.95) <= 5 * math.sqrt(0.95 * 0.05 / runs)


def spread(low, high):
    """Difference of a normal error with this 95 % interval."""
    return Difference((low + high) / 2, (high - low) / 2 / stats.norm.ppf(0.975))


def test_single_trials_combine_the_intervals_over_images():
    found = difference(point([0.8], 0.03), point([0.7], 0.04))
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
    assert above(spread(low, high) for low, high in intervals) is answer


def test_signs_are_as_wide_as_each_other():
    assert differences.signed(-0.01) == "−0.010"
    assert str(spread(-0.2, 0.4)) == "+0.100 [−0.200, +0.400]"
    assert str(of_trials([0.1])) == "+0.100 (one trial, no interval)"

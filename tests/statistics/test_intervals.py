"""Intervals of an accuracy and of the mean of the classes, and how often they cover it."""

import numpy as np
import pytest
from scipy.stats import binom, binomtest

from deepfsi.statistics.intervals import balanced, student, wilson, worst_of


@pytest.mark.parametrize("images", [1, 2, 7, 500])
def test_wilsons_interval_is_scipys(images):
    for right in {0, 1, images // 3, images - 1, images}:
        wanted = binomtest(right, images).proportion_ci(0.95, method="wilson")
        assert wilson(right / images, images) == pytest.approx(tuple(wanted), rel=1e-9, abs=1e-12)
    assert wilson(0.0, images)[0] == 0
    assert wilson(1.0, images)[1] == 1


def test_every_class_counts_alike():
    mean, low, high = balanced([0.99, 0.0, 0.5], [600, 6, 5])
    assert mean == pytest.approx(1.49 / 3)
    assert low < mean < high
    assert balanced([0.99, 0.0, None], [600, 6, 0]) == balanced([0.99, 0.0], [600, 6])


def test_of_one_class_it_is_wilsons():
    assert balanced([0.8], [50]) == pytest.approx((0.8, *wilson(0.8, 50)))


def test_of_alike_classes_it_narrows_with_the_root_of_their_number():
    """C classes of n images, far from 0 and 1, are known as well as one of C · n, but for z²/2n."""
    _, low, high = balanced([0.5] * 9, [400] * 9)
    assert high - low == pytest.approx(np.diff(wilson(0.5, 3600))[0], rel=1.96**2 / 800)


def test_a_class_of_one_image_widens_it():
    for rate in (0.0, 1.0):
        _, low, high = balanced([0.9, rate], [1000, 1])
        assert high - low > 0.3
        assert 0 <= low <= (0.9 + rate) / 2 <= high <= 1


@pytest.mark.parametrize(
    ("truth", "images", "share"),
    [
        ((0.9, 0.8, 0.7, 0.6), (40, 40, 40, 40), 0.95),
        ((0.5, 0.5), (3, 3), 0.95),
        ((0.98, 0.5, 0.3), (120, 3, 3), 0.9),
        ((0.95, 0.1), (500, 2), 0.9),
        ((0.99, 0.9, 0.9, 0.9, 0.5), (100, 10, 5, 2, 1), 0.9),
        ((0.9, 0.9, 0.9), (2, 2, 2), 0.89),
    ],
)
def test_it_covers_the_truth(truth, images, share):
    """Of 1000 tests that share, less five standard deviations."""
    rng = np.random.default_rng(3)
    right = rng.binomial(images, truth, (1000, len(images)))
    found = [balanced((row / np.array(images)).tolist(), images) for row in right]
    covered = np.mean([low <= np.mean(truth) <= high for _, low, high in found])
    assert covered >= binom.ppf(3e-7, 1000, share) / 1000


def test_the_worst_class_is_among_those_that_are_tested():
    assert worst_of([0.9, None, 0.2, 0.3]) == 2


def test_an_interval_over_trials_covers_what_it_says():
    """Student's interval of five normal values holds their mean in 95 % of cases."""
    runs = 2000
    values = np.random.default_rng(0).normal(0.3, 0.02, (runs, 5))
    held = [low <= 0.3 <= high for low, high in map(student, values)]
    assert np.mean(held) == pytest.approx(0.95, abs=5 * (0.95 * 0.05 / runs) ** 0.5)

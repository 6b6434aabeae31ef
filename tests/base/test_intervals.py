"""Intervals of an accuracy and of the mean of the classes, and how often they cover it."""

import numpy as np
import pytest
from scipy import stats
from scipy.stats import binom, binomtest

from deepfsi.base.numeric import (
    accuracy_interval,
    balanced_interval,
    image_interval,
    student,
    wilson,
    worst_class,
)
from deepfsi.base.numeric.intervals import balanced_terms, seeds_error


@pytest.mark.parametrize("images", [1, 2, 7, 500])
def test_wilsons_interval_is_scipys(images):
    for right in {0, 1, images // 3, images - 1, images}:
        wanted = binomtest(right, images).proportion_ci(0.95, method="wilson")
        assert wilson(right / images, images) == pytest.approx(tuple(wanted), rel=1e-9, abs=1e-12)
    assert wilson(0.0, images)[0] == 0
    assert wilson(1.0, images)[1] == 1


def shares(rates, images):
    """Answers right or wrong (n,) of so many images of each class at a rate, and their classes."""
    labels = np.repeat(np.arange(len(images)), images)
    counts = [round(rate * count) for rate, count in zip(rates, images, strict=True)]
    right = np.concatenate([np.arange(n) < k for k, n in zip(counts, images, strict=True)])
    return right.astype(float), labels


@pytest.mark.parametrize("images", [1, 2, 7, 500])
def test_of_one_draw_and_one_training_the_interval_is_wilsons(images):
    for right in {0, 1, images // 3, images - 1, images}:
        found = accuracy_interval(np.arange(images) < right)
        assert found == pytest.approx((right / images, *wilson(right / images, images)))


def test_draws_that_are_averaged_narrow_it():
    """Of images that are all alike, 30 draws vary by a thirtieth of right and wrong."""
    rng = np.random.default_rng(0)
    one, many = (accuracy_interval(rng.binomial(k, 0.7, 4000) / k) for k in (1, 30))
    assert many.high - many.low == pytest.approx((one.high - one.low) / 30**0.5, rel=0.1)


def crossed(rng, images, seeds, rate, spread=0.3, draws=3):
    """Shares of draws right (S, n): images, seeds and both together move a normal threshold."""
    parts = 1.5, spread if seeds > 1 else 0.0, 0.5  # deviations, in those of the noise
    place = stats.norm.ppf(rate) * (1 + sum(part**2 for part in parts)) ** 0.5
    image, seed, both = (
        part * rng.standard_normal(size)
        for part, size in zip(parts, [images, (seeds, 1), (seeds, images)], strict=True)
    )
    return rng.binomial(draws, stats.norm.cdf(place + image + seed + both)) / draws


@pytest.mark.parametrize("images", [24, 100, 1000])
@pytest.mark.parametrize("seeds", [1, 3, 5])
@pytest.mark.parametrize("rate", [0.6, 0.9])
def test_it_covers_images_seeds_and_draws(images, seeds, rate):
    """In 95 % of 400 studies and at most 99 %, less or more four standard deviations."""
    rng = np.random.default_rng(images + seeds)
    ends = [accuracy_interval(crossed(rng, images, seeds, rate)) for _ in range(400)]
    covered = sum(low <= rate <= high for _, low, high in ends)
    assert binom.ppf(3e-5, 400, 0.95) <= covered <= binom.ppf(1 - 3e-5, 400, 0.99)
    assert all(0 <= low <= mean <= high <= 1 for mean, low, high in ends)


def test_seeds_alone_or_images_alone_are_not_enough():
    """An interval over three seeds of the same 24 images misses, and so does one over images."""
    rng = np.random.default_rng(4)
    studies = [crossed(rng, 24, 3, 0.8, spread=0.05) for _ in range(300)]
    seeds = np.mean([low <= 0.8 <= high for low, high in (student(s.mean(1)) for s in studies)])
    assert seeds < 0.8
    wide = [crossed(rng, 1000, 3, 0.8) for _ in range(300)]
    images = np.mean(
        [low <= 0.8 <= high for _, low, high in (accuracy_interval(s.mean(0)) for s in wide)]
    )
    assert images < 0.6


def test_images_and_draws_count_once_where_trainings_are_alike():
    """Then (S − 1) spread / crossed is χ² of S − 1: below it, 0.632 of three alike trainings."""
    rng = np.random.default_rng(0)
    none = [seeds_error(rng.binomial(3, 0.8, (3, 200)) / 3) == 0 for _ in range(1000)]
    assert np.mean(none) == pytest.approx(
        stats.chi2.cdf(2, 2), abs=5 * (0.632 * 0.368 / 1000) ** 0.5
    )
    apart = 0.8 + 0.1 * np.array([[-1], [0], [1]]) + np.zeros((3, 50))
    assert seeds_error(apart) == pytest.approx(0.1 / 3**0.5)


def test_every_class_counts_alike():
    right, labels = shares([0.99, 0.0, 0.6], [600, 6, 5])
    mean, low, high = balanced_interval(right, labels)
    assert mean == pytest.approx(1.59 / 3)
    assert low < mean < high
    assert balanced_terms(right, labels).mean() == pytest.approx(mean)


def test_of_one_class_it_is_wilsons():
    assert balanced_interval(*shares([0.8], [50])) == pytest.approx((0.8, *wilson(0.8, 50)))


def test_of_alike_classes_it_narrows_with_the_root_of_their_number():
    """C classes of n images, far from 0 and 1, are known as well as one of C · n, but for z²/2n."""
    _, low, high = balanced_interval(*shares([0.5] * 9, [400] * 9))
    assert high - low == pytest.approx(np.diff(wilson(0.5, 3600))[0], rel=1.96**2 / 800)


def test_a_class_of_one_image_widens_it():
    for rate in (0.0, 1.0):
        _, low, high = balanced_interval(*shares([0.9, rate], [1000, 1]))
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
    right = rng.binomial(images, truth, (1000, len(images))) / np.array(images)
    found = [balanced_interval(*shares(row, images)) for row in right]
    covered = np.mean([low <= np.mean(truth) <= high for _, low, high in found])
    assert covered >= binom.ppf(3e-7, 1000, share) / 1000


def test_the_balanced_accuracy_covers_seeds_too():
    rng = np.random.default_rng(2)
    labels = np.arange(120) % 3
    ends = [balanced_interval(crossed(rng, 120, 3, 0.8), labels) for _ in range(400)]
    covered = sum(low <= 0.8 <= high for _, low, high in ends)
    assert binom.ppf(3e-5, 400, 0.95) <= covered


def test_means_without_bounds_cover_images_and_seeds():
    rng = np.random.default_rng(5)

    def study():
        return 0.9 + 0.3 * (rng.standard_normal(50) + 0.3 * rng.standard_normal((4, 1)))

    covered = sum(
        low <= 0.9 <= high for _, low, high in (image_interval(study()) for _ in range(400))
    )
    assert binom.ppf(3e-5, 400, 0.95) <= covered <= binom.ppf(1 - 3e-5, 400, 0.99)
    assert image_interval(np.full((2, 5), 0.4)) == pytest.approx((0.4, 0.4, 0.4))


def test_the_worst_class_is_among_those_that_are_tested():
    assert worst_class([0.9, None, 0.2, 0.3]) == 2


def test_an_interval_over_trials_covers_what_it_says():
    """Student's interval of five normal values holds their mean in 95 % of cases."""
    runs = 2000
    values = np.random.default_rng(0).normal(0.3, 0.02, (runs, 5))
    held = [low <= 0.3 <= high for low, high in map(student, values)]
    assert np.mean(held) == pytest.approx(0.95, abs=5 * (0.95 * 0.05 / runs) ** 0.5)

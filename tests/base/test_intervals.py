"""Intervals of what a test measures, differences of them, where a curve crosses a target."""

from itertools import product

import numpy as np
import pytest
from scipy import stats
from scipy.stats import binom, binomtest

from deepfsi.base.intervals import (
    Difference,
    accuracy_interval,
    all_above,
    balanced_interval,
    find_crossing,
    image_interval,
    mean_of_trials,
    pack_values,
    paired_difference,
    seeds_error,
    unpack_values,
    wilson,
    worst_class,
)
from deepfsi.sweeps.results import accuracy_difference
from shared.results import a_point


def wilson_of(rate, images):
    """Ends at which the score test of a rate is at its 95 % level."""
    z = stats.norm.ppf(0.975)
    ratio = z**2 / images
    half = np.sqrt(ratio * rate * (1 - rate) + ratio**2 / 4)
    return (rate + ratio / 2 - half) / (1 + ratio), (rate + ratio / 2 + half) / (1 + ratio)


@pytest.mark.parametrize("images", [1, 2, 7, 500])
def test_right_and_wrong_of_one_training_have_wilsons_interval(images):
    for right in {0, 1, images // 3, images - 1, images}:
        wanted = binomtest(right, images).proportion_ci(0.95, method="wilson")
        values, labels = (np.arange(images) < right).astype(float), np.zeros(images, int)
        for found in (wilson(right / images, images), accuracy_interval(values)[1:]):
            assert found == pytest.approx(tuple(wanted), rel=1e-9, abs=1e-12)
        assert balanced_interval(values, labels) == accuracy_interval(values)
    assert (wilson(0.0, images)[0], wilson(1.0, images)[1]) == (0, 1)


def test_an_interval_of_many_images_is_normal():
    """Of shares of draws, 1.96 standard errors; of classes, those of all added in squares."""
    rng = np.random.default_rng(0)
    groups = [rng.binomial(3, rate, size) / 3 for rate, size in ((0.6, 40_000), (0.3, 90_000))]
    halves = [1.96 * group.std() / len(group) ** 0.5 for group in groups]
    for group, half in zip(groups, halves, strict=True):
        mean, low, high = accuracy_interval(group)
        assert (mean - low, high - mean) == pytest.approx((half, half), rel=0.01)
    labels = np.repeat([4, 7], [40_000, 90_000])
    mean, low, high = balanced_interval(np.concatenate(groups), labels)
    assert mean == pytest.approx((groups[0].mean() + groups[1].mean()) / 2)
    assert (mean - low, high - mean) == pytest.approx([np.hypot(*halves) / 2] * 2, rel=0.01)


def test_an_image_with_an_error_counts_as_one_that_is_right_or_wrong():
    """A square is added to the images', and to what they would be if right or wrong."""
    for values in (np.array([0.5]), np.array([1, 1, 2 / 3]), np.array([0, 1 / 3, 0, 1])):
        mean, count = values.mean(), len(values)
        fewer = (count * mean * (1 - mean) + 1) / (values.var() * count + 1)
        wanted = wilson_of(mean, count * fewer)
        assert accuracy_interval(values)[1:] == pytest.approx(wanted)


def shares(rates, images):
    """Answers right or wrong (n,) of so many images of each class at a rate, and their classes."""
    labels = np.repeat(np.arange(len(images)), images)
    counts = [round(rate * count) for rate, count in zip(rates, images, strict=True)]
    right = np.concatenate([np.arange(n) < k for k, n in zip(counts, images, strict=True)])
    return right.astype(float), labels


def crossed(rng, images, seeds, rate, spread=0.3, draws=3):
    """Shares of draws right (S, n): images, seeds and both together move a normal threshold."""
    parts = 1.5, spread if seeds > 1 else 0.0, 0.5  # deviations, in those of the noise
    place = stats.norm.ppf(rate) * (1 + sum(part**2 for part in parts)) ** 0.5
    image, seed, both = (
        part * rng.standard_normal(size)
        for part, size in zip(parts, [images, (seeds, 1), (seeds, images)], strict=True)
    )
    return rng.binomial(draws, stats.norm.cdf(place + image + seed + both)) / draws


def assert_covers(intervals, truth, most=0.99):
    """Intervals hold the truth in 95 % of studies and at most 99 %, within four deviations."""
    covered = [low <= truth <= high for low, high in intervals]
    runs = len(covered)
    assert binom.ppf(3e-5, runs, 0.95) <= sum(covered) <= binom.ppf(1 - 3e-5, runs, most)


@pytest.mark.parametrize("images", [24, 100, 1000])
@pytest.mark.parametrize("seeds", [1, 3, 5])
@pytest.mark.parametrize("rate", [0.6, 0.9])
def test_it_covers_images_seeds_and_draws(images, seeds, rate):
    rng = np.random.default_rng(images + seeds)
    ends = [accuracy_interval(crossed(rng, images, seeds, rate)) for _ in range(200)]
    assert_covers([(low, high) for _, low, high in ends], rate)
    assert all(0 <= low <= mean <= high <= 1 for mean, low, high in ends)


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
    found = [paired_difference(*answers(rng, images, seeds, 0.0)) for _ in range(200)]
    told = sum(each.low > 0 or each.high < 0 for each in found)
    assert told <= stats.binom.ppf(1 - 3e-5, 200, 0.05)


def test_points_are_paired_by_the_terms_of_their_images():
    one, other = answers(np.random.default_rng(0), 60, 2, 0.5)
    points = [
        a_point(float(rows.mean()), accuracies=tuple(rows.mean(axis=1))).model_copy(
            update={"terms": tuple(map(pack_values, rows))}
        )
        for rows in (one, other)
    ]
    found, expected = accuracy_difference(*points), paired_difference(one, other)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), abs=1e-6)
    assert (-found).high == -found.low


def test_the_worst_class_is_the_first_of_the_lowest_accuracy():
    assert worst_class([0.9, None, 0.2, 0.2]) == 2


def test_damaged_terms_are_refused():
    values = np.array([0.0, 1 / 3, 1.0])
    text = pack_values(values)
    assert unpack_values(text) == pytest.approx(values, abs=1e-7)
    no_number = pack_values(np.array([np.nan]))
    for damaged in ("", "§", text[:-8], text[:8] + "AAAA" + text[12:], no_number):
        with pytest.raises(ValueError, match=r"values|base64|padding|characters|ascii"):
            unpack_values(damaged)


def spread(low, high):
    """Difference of a normal error with this 95 % interval."""
    return Difference((low + high) / 2, (high - low) / 2 / stats.norm.ppf(0.975))


@pytest.mark.parametrize(
    ("intervals", "answer"),
    [
        ([(0.1, 0.2), (0.01, 0.3)], True),
        ([(0.1, 0.2), (-0.01, 0.3)], None),
        ([(-0.3, -0.01)], False),
        ([(0.1, 0.2), (-0.3, -0.1)], False),
        ([(0.1, 0.2), (-0.3, -0.001)], None),
        ([(0.0, 0.0)], None),
        ([], True),
    ],
)
def test_a_claim_holds_only_where_every_interval_says_so(intervals, answer):
    """One of several intervals just below 0 is no surprise, and leaves the claim open."""
    assert all_above(spread(low, high) for low, high in intervals) is answer


@pytest.mark.parametrize("images", [(200,), (20, 200), (5, 300, 40)])
def test_images_and_draws_count_once_where_trainings_are_alike(images):
    """Then (S − 1) spread / crossed is χ² of S − 1: below it, 0.632 of three alike trainings.

    Such trainings widen no interval; others do by Student's quantile of their standard error.
    """
    rng, labels = np.random.default_rng(0), np.repeat(np.arange(len(images)), images)
    kinds = {
        "accuracy": accuracy_interval,
        "balanced": lambda values: balanced_interval(values, labels),
        "mean": image_interval,
    }
    rates = np.repeat(np.linspace(0.8, 0.5, len(images)), images)
    for interval in kinds.values():
        alike = [
            interval(right) == pytest.approx(interval(right.mean(axis=0)), rel=1e-12)
            for right in rng.binomial(3, rates, (200, 3, sum(images))) / 3
        ]
        deviation = (0.632 * 0.368 / 200) ** 0.5
        assert np.mean(alike) == pytest.approx(stats.chi2.cdf(2, 2), abs=5 * deviation)
        apart = 0.6 + 0.1 * np.array([[-1], [0], [1]]) + np.zeros((3, sum(images)))
        mean, low, high = interval(apart)
        one, below, above = interval(apart.mean(axis=0))
        reach = stats.t.ppf(0.975, 2) * 0.1 / 3**0.5
        assert low == pytest.approx(max(mean - np.hypot(one - below, reach), 0))
        assert high == pytest.approx(mean + np.hypot(above - one, reach))
    assert seeds_error(apart) == pytest.approx(0.1 / 3**0.5)
    assert seeds_error(apart[:, :1]) == pytest.approx(0.1 / 3**0.5)
    assert seeds_error(apart[:1]) == 0


@pytest.mark.parametrize("off", [0.5, 1.0])
def test_the_error_of_trainings_is_without_that_share_of_images_and_draws(off):
    """Of S trainings of n images, by the variances of both and of the rest."""
    rng, seeds, images = np.random.default_rng(1), 4, 30
    squares = []
    for _ in range(4000):
        parts = (
            rng.normal(0, 0.3, (seeds, 1)),
            rng.normal(size=images),
            rng.normal(size=(seeds, images)),
        )
        squares.append(seeds_error(sum(parts), off) ** 2)
    wanted = (0.3**2 + (1 - off) / images) / seeds
    assert np.mean(squares) == pytest.approx(wanted, abs=5 * np.std(squares) / 4000**0.5 + 3e-4)
    few = np.array([[1.6, 0.4], [-1.6, -0.4]])  # trainings ±1, and a rest of ±0.6
    assert seeds_error(few, off) == pytest.approx((1 - 0.36 * off) ** 0.5)


@pytest.mark.parametrize("images", [2, 7])
def test_one_training_on_images_has_students_interval(images):
    values = np.random.default_rng(0).normal(0.4, 1, images)
    half = stats.t.ppf(0.975, images - 1) * values.std(ddof=1) / images**0.5
    mean, low, high = image_interval(values)
    assert (mean, mean - low, high - mean) == pytest.approx((values.mean(), half, half))
    assert image_interval(values[:1]) == (values[0],) * 3


def test_a_difference_has_the_errors_of_images_and_of_both_trainings():
    """Pairs of trainings of the same seeds; of other numbers of them, each by itself."""
    rng = np.random.default_rng(2)
    first, second = 0.5 + rng.normal(size=(4, 25)), rng.normal(size=(4, 25))
    first += rng.normal(0, 2, (4, 1))
    second[:3] += rng.normal(0, 2, (3, 1))
    gaps = (first - second).mean(axis=0)
    error = ((25 * gaps.var() + 2 * max(gaps**2)) / 24 / 25) ** 0.5
    alike = paired_difference(first, second)
    assert (alike.mean, alike.error) == pytest.approx((gaps.mean(), error))
    assert (alike.freedom, alike.seeds_freedom) == (24, 3)
    assert alike.seeds_error == pytest.approx(seeds_error(first - second, 0.5))
    other = paired_difference(first, second[:3])
    errors = seeds_error(first, 0.5), seeds_error(second[:3], 0.5)
    assert (other.seeds_error, other.seeds_freedom) == (pytest.approx(np.hypot(*errors)), 2)
    alone = paired_difference(first, second[:1])
    assert (alone.seeds_error, alone.seeds_freedom) == (pytest.approx(errors[0]), 3)
    assert paired_difference(first, second[:2]).seeds_freedom == 1
    single = paired_difference(first[:1], second[:1])
    assert (single.seeds_error, single.seeds_freedom) == (0, 1)
    for confidence in (0.5, 0.95):
        images, seeds = stats.t.ppf((1 + confidence) / 2, [24, 2])
        half = np.hypot(images * other.error, seeds * other.seeds_error)
        low, high = other.interval(confidence)
        assert (other.mean - low, high - other.mean) == pytest.approx((half, half))
    assert (other.low, other.high) == (low, high)


def test_a_difference_is_written_with_its_interval():
    assert str(Difference(-0.0123456, 0.01)) == "−0.012 [−0.032, +0.007]"
    assert str(mean_of_trials([0.25])) == "+0.250 (one trial, no interval)"
    three = mean_of_trials([0.1, 0.2, 0.3])
    assert (three.mean, three.error, three.freedom) == pytest.approx((0.2, 0.1 / 3**0.5, 2))


def test_few_images_that_differ_may_be_of_one_sign_by_chance():
    """By the sign test five of one sign have p = 0.06, six have 0.03; so for thirds of draws."""
    for images, size in product((24, 200, 10_000), (1, 1 / 3)):
        wrong = np.zeros((1, images))
        for more, told in ((5, False), (6, True)):
            right = wrong + size * (np.arange(images) < more)
            assert (paired_difference(right, wrong).low > 0) is told


@pytest.mark.parametrize(
    ("accuracies", "low", "high"),
    [
        ((0.5, 0.6, 0.7), None, None),
        ((0.5, 0.6, 0.899), (1e3, 0.999e4), None),
        ((0.95, 0.96, 0.97), None, None),
        ((0.901, 0.96, 0.97), None, (1.001e2, 1e3)),
    ],
    ids=["surely beyond", "perhaps beyond", "surely below", "perhaps below"],
)
def test_targets_beyond_what_was_tried(accuracies, low, high):
    """An interval's end that is not known is None, and what is known of it lies within bounds."""
    tests = [[accuracy] for accuracy in accuracies]
    least, best, most = find_crossing([1e2, 1e3, 1e4], tests, 300, 0.9)
    assert best is None
    for end, bounds in ((least, low), (most, high)):
        assert end is None if bounds is None else bounds[0] <= end <= bounds[1]


FINE = np.linspace(2, 6, 41)
"""Logarithms of budgets between which a curve that is a line has hardly a bound to itself."""


@pytest.mark.parametrize("images", [100, 10**12])
@pytest.mark.parametrize("apart", [0.0, 0.03])
def test_the_crossing_of_a_line_is_as_wide_as_its_target_is_by_images_and_trainings(images, apart):
    """Of images, the score test of the target; of three trainings at each of 41 budgets, t."""
    line = 0.1 + 0.2 * (FINE - 2)
    trials = line[:, None] + apart * np.array([-1, 0, 1])
    trials = trials if apart else trials[:, :1]
    target, seeds = 0.5, stats.t.ppf(0.975, 82) * apart / 3**0.5
    found = find_crossing(10**FINE, trials.tolist(), images, target)
    tried = np.linspace(0.2, 0.8, 60_001)
    ends = wilson_of(tried, images)
    upper = tried + np.hypot(ends[1] - tried, seeds)
    lower = tried - np.hypot(tried - ends[0], seeds)
    rates = tried[(upper >= target).argmax()], target, tried[(lower >= target).argmax()]
    assert np.log10(found) == pytest.approx([2 + (rate - 0.1) / 0.2 for rate in rates], abs=0.01)


@pytest.mark.parametrize(
    ("target", "low", "high"), [(0.26, 2.6, 3.0), (0.38, 3.2, 3.8), (0.59, 4.0, 4.6)]
)
def test_between_few_budgets_a_crossing_is_where_lines_beside_it_reach(target, low, high):
    """Of the chord, and of those of the gaps beside it, continued, or flat beyond the last."""
    tests = [[accuracy] for accuracy in (0.2, 0.3, 0.5, 0.65)]
    found = np.log10(find_crossing([1e2, 1e3, 1e4, 1e5], tests, 10**15, target))
    assert found[[0, 2]] == pytest.approx((low, high), abs=0.004)
    assert low <= found[1] <= high

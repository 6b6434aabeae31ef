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
)
from deepfsi.sweeps.results import accuracy_difference
from shared.results import a_point


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
    ends = [accuracy_interval(crossed(rng, images, seeds, rate)) for _ in range(400)]
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


def test_means_without_bounds_cover_images_and_seeds():
    rng = np.random.default_rng(5)
    studies = [
        0.9 + 0.3 * (rng.standard_normal(50) + 0.3 * rng.standard_normal((4, 1)))
        for _ in range(400)
    ]
    assert_covers([image_interval(study)[1:] for study in studies], 0.9)
    assert image_interval(np.full((2, 5), 0.4)) == pytest.approx((0.4, 0.4, 0.4))


def test_an_interval_over_five_trials_covers_what_it_says():
    """Student's interval of five normal values holds their mean in 95 % of cases."""
    values = np.random.default_rng(0).normal(0.3, 0.02, (2000, 5))
    assert_covers([mean_of_trials(five).interval() for five in values], 0.3, most=0.95)


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
    ],
)
def test_a_claim_holds_only_where_every_interval_says_so(intervals, answer):
    """One of several intervals just below 0 is no surprise, and leaves the claim open."""
    assert all_above(spread(low, high) for low, high in intervals) is answer


def test_images_and_draws_count_once_where_trainings_are_alike():
    """Then (S − 1) spread / crossed is χ² of S − 1: below it, 0.632 of three alike trainings."""
    rng = np.random.default_rng(0)
    none = [seeds_error(rng.binomial(3, 0.8, (3, 200)) / 3) == 0 for _ in range(1000)]
    deviation = (0.632 * 0.368 / 1000) ** 0.5
    assert np.mean(none) == pytest.approx(stats.chi2.cdf(2, 2), abs=5 * deviation)
    apart = 0.8 + 0.1 * np.array([[-1], [0], [1]]) + np.zeros((3, 50))
    assert seeds_error(apart) == pytest.approx(0.1 / 3**0.5)


def test_few_images_that_differ_may_be_of_one_sign_by_chance():
    """By the sign test five of one sign have p = 0.06, six have 0.03; so for thirds of draws."""
    for images, size in product((24, 200, 10_000), (1, 1 / 3)):
        wrong = np.zeros((1, images))
        for more, told in ((5, False), (6, True)):
            right = wrong + size * (np.arange(images) < more)
            assert (paired_difference(right, wrong).low > 0) is told


DECADES = (1e2, 1e3, 1e4, 1e5, 1e6)
TARGET, REPEATS = 0.9, 100


class MadeUp:
    """Accuracy that rises with log Φ in an S from chance to a ceiling, tested on the same images.

    An image is classified right where the accuracy exceeds its own threshold, so that all budgets
    err together; each training is off by some more.
    """

    def __init__(self, rng: np.random.Generator, width: float, ceiling: float, images: int) -> None:
        self.rng, self.width, self.ceiling = rng, width, ceiling
        self.middle = rng.uniform(3.2, 4.8)
        self.thresholds = np.sort(rng.random(images))

    def accuracy(self, photons: float) -> float:
        steps = (np.log10(photons) - self.middle) / self.width
        return 0.1 + (self.ceiling - 0.1) / (1 + np.exp(-steps))

    @property
    def crossing(self) -> float:
        odds = (TARGET - 0.1) / (self.ceiling - TARGET)
        return 10 ** (self.middle + self.width * np.log(odds))

    def tested(self, photons: float) -> float:
        true = self.accuracy(photons) + 0.004 * self.rng.standard_normal()
        return float(np.searchsorted(self.thresholds, true)) / len(self.thresholds)


@pytest.mark.parametrize("images", [300, 10_000])
@pytest.mark.parametrize(("width", "ceiling"), [(0.15, 0.95), (0.3, 0.97), (0.5, 1.0)])
def test_the_crossing_is_in_the_interval_at_the_stated_rate(width, ceiling, images):
    rng = np.random.default_rng(images)
    inside = 0
    for _ in range(REPEATS):
        curve = MadeUp(rng, width, ceiling, images)
        tests = [[curve.tested(budget) for _ in range(3)] for budget in DECADES]
        low, _, high = find_crossing(DECADES, tests, images, TARGET)
        inside += (low or 0.0) <= curve.crossing <= (high or np.inf)
    assert inside / REPEATS >= 0.95 - 5 * np.sqrt(0.95 * 0.05 / REPEATS)


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

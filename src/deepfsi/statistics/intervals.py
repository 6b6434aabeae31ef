"""95 % intervals of what a test measures, over test images and training seeds.

A test of S trainings with different seeds on the same n images gives a value of each image by each
training, such as the share of its noise draws that are right: values (S, n). Images and seeds are
crossed random effects. The mean over seeds of each image tells the variance over images, in which
the noise draws and what is of one training on one image are held already; the means of the
trainings vary by the seeds and by a share of the same, which is taken off. Half widths of both
parts, each by its own quantile, add as squares. Of one training the interval is over images alone.
`benchmarks/coverage.py` measures how often the intervals hold the truth.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

Z = NormalDist().inv_cdf(0.975)

PRIOR_SQUARES = 1.0
"""Sum of squares, beside the images' own, with which their values are taken to spread as right and
wrong do: among few images with an error the true spread may not show."""


class Interval(NamedTuple):
    """A mean and its 95 % interval."""

    mean: float
    low: float
    high: float

    @property
    def text(self) -> str:
        """Mean and ends, with three decimals."""
        return f"{self.mean:.3f} ({self.low:.3f} to {self.high:.3f})"


def accuracy(right: np.ndarray) -> Interval:
    """Accuracy with its interval, which lies in [0, 1].

    Parameters
    ----------
    right : array, shape (S, n) or (n,)
        Share of the noise draws of each of n images that a training answers right.

    Notes
    -----
    Over images it is Wilson's score interval at an effective number of images: with the mean of
    several draws as one value, images vary less than right and wrong do. Of one draw and one
    training it is Wilson's.
    """
    values = np.atleast_2d(right)
    mean, low, high = _score(values.mean(axis=0))
    return over_seeds(Interval(mean, low, high), values, (0.0, 1.0))


def balanced(right: np.ndarray, labels: np.ndarray) -> Interval:
    """Mean of the classes' accuracies with its interval.

    Every class counts alike, whatever its number of images; classes without any are left out.

    Parameters
    ----------
    right : array, shape (S, n) or (n,)
        As of `accuracy`.
    labels : array, shape (n,)
        Class of each image.

    Notes
    -----
    The interval combines those of the classes (the method of variance estimates recovery): the
    squared distances of their lower ends from their rates add up to that of the mean's lower end
    times the number of classes, and those of the upper ends likewise. So a class of one image,
    right or wrong, still has its say in the width. It covers the truth in 95 of 100 tests of 40
    images a class, and in 90 to 97 where classes have one to three.
    """
    values = np.atleast_2d(right)
    each = values.mean(axis=0)
    ends = [_score(each[labels == label]) for label in np.unique(labels)]
    mean = sum(rate for rate, _, _ in ends) / len(ends)
    below = math.hypot(*(rate - low for rate, low, _ in ends)) / len(ends)
    above = math.hypot(*(high - rate for rate, _, high in ends)) / len(ends)
    terms = np.stack([balanced_terms(row, labels) for row in values])
    return over_seeds(Interval(mean, mean - below, mean + above), terms, (0.0, 1.0))


def balanced_terms(right: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Terms (n,) of images whose mean is the balanced accuracy, and varies as it does."""
    # right (n,) and labels (n,) of one training
    _, groups, sizes = np.unique(labels, return_inverse=True, return_counts=True)
    rates = np.bincount(groups, right) / sizes
    weights = len(labels) / (len(sizes) * sizes)
    return np.asarray(rates.mean() + weights[groups] * (right - rates[groups]))


def over_images(values: np.ndarray) -> Interval:
    """Mean of values (S, n) or (n,) without bounds, such as the shares that make R²."""
    from scipy import stats

    rows = np.atleast_2d(values)
    each = rows.mean(axis=0)
    mean, count = float(each.mean()), len(each)
    if count < 2:
        return Interval(mean, mean, mean)
    half = float(stats.t.ppf(0.975, count - 1)) * float(stats.sem(each))
    return over_seeds(Interval(mean, mean - half, mean + half), rows)


def over_seeds(
    found: Interval, terms: np.ndarray, bounds: tuple[float, float] = (-math.inf, math.inf)
) -> Interval:
    """An interval over images, which covers training seeds, too, where there are several."""
    # terms (S, n), whose mean is what is measured
    from scipy import stats

    mean, low, high = found
    reach = 0.0
    if len(terms) > 1:
        reach = float(stats.t.ppf(0.975, len(terms) - 1)) * seeds_error(terms)
    low, high = mean - math.hypot(mean - low, reach), mean + math.hypot(high - mean, reach)
    return Interval(mean, max(low, bounds[0]), min(high, bounds[1]))


def seeds_error(terms: np.ndarray, off: float = 1.0) -> float:
    """Standard error that training seeds alone give the mean of terms (S, n); 0 of one seed."""
    # off: part of the share of images and draws in the trainings' variance that is taken off it
    seeds, images = terms.shape
    if seeds < 2:
        return 0.0
    trainings = terms.mean(axis=1)
    spread = float(trainings.var(ddof=1)) / seeds
    if images < 2:
        return math.sqrt(spread)
    rest = terms - terms.mean(axis=0) - trainings[:, None] + terms.mean()
    crossed = float(np.square(rest).sum()) / ((seeds - 1) * (images - 1)) / (seeds * images)
    return math.sqrt(max(spread - off * crossed, 0.0))


def wilson(accuracy: float, images: int) -> tuple[float, float]:
    """95 % interval of a mean over images, each of which counts as one trial."""
    # in closed form: scipy's binomtest, which gives it too, tests a hypothesis first
    return _wilson(round(accuracy * images) / images, images)


def _wilson(rate: float, images: float) -> tuple[float, float]:
    part = Z**2 / images
    half = math.sqrt(part * (rate * (1 - rate) + part / 4))
    low, high = ((rate + part / 2 + off) / (1 + part) for off in (-half, half))
    return low if rate > 0 else 0.0, high if rate < 1 else 1.0


def _score(values: np.ndarray) -> Interval:
    """Mean of values (n,) in [0, 1], with Wilson's interval at their effective number."""
    mean, count = float(values.mean()), len(values)
    squares = float(np.square(values - mean).sum())
    share = (squares + PRIOR_SQUARES) / (count * mean * (1 - mean) + PRIOR_SQUARES)
    return Interval(mean, *_wilson(mean, count / share))


def student(values: Sequence[float]) -> tuple[float, float]:
    """95 % interval of a mean over trials."""
    from scipy import stats

    mean = float(np.mean(values))
    half = float(stats.t.ppf(0.975, len(values) - 1)) * float(stats.sem(values))
    return mean - half, mean + half


def worst_of(rates: Sequence[float | None]) -> int:
    """Place of the class with the lowest accuracy, of those that have one."""
    return min((rate, place) for place, rate in enumerate(rates) if rate is not None)[1]

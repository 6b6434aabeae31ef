"""95 % intervals of what a test measures, over test images and training seeds.

A test of S trainings with different seeds on the same n images gives values (S, n), such as the
share of noise draws that are right. Images and seeds are crossed random effects. Means over seeds
tell the variance over images, which already holds that of noise draws, and of one training on one
image. Means over images vary by the seeds and by a share of that variance, which is taken off.
Half widths of both, each by its own quantile, add as squares. With one training the interval
covers images alone.
`benchmarks/coverage.py` measures how often the intervals hold the truth.
"""

import base64
import math
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

Z_95 = NormalDist().inv_cdf(0.975)


class Interval(NamedTuple):
    """A mean and its 95 % interval."""

    mean: float
    low: float
    high: float


def accuracy_interval(right: np.ndarray) -> Interval:
    """Accuracy of S trainings on n images (S, n) or (n,), with its interval in [0, 1].

    Over images it is Wilson's score interval at an effective number of images: with the mean of
    several draws as one value, images vary less than right and wrong do. Of one draw and one
    training it is Wilson's.
    """
    values = np.atleast_2d(right)
    mean, low, high = _score(values.mean(axis=0))
    return _widen_by_seeds(Interval(mean, low, high), values, (0.0, 1.0))


def balanced_interval(right: np.ndarray, labels: np.ndarray) -> Interval:
    """Mean of the classes' accuracies with its interval, of shares (S, n) or (n,) and labels (n,).

    Every class counts alike, whatever its number of images; classes without any are left out. The
    interval combines those of the classes (the method of variance estimates recovery). It covers
    the truth in 95 of 100 tests of 40 images a class, and in 90 to 97 where classes have one to
    three.
    """
    values = np.atleast_2d(right)
    images = values.mean(axis=0)
    scores = [_score(images[labels == label]) for label in np.unique(labels)]
    mean = sum(rate for rate, _, _ in scores) / len(scores)
    below = math.hypot(*(rate - low for rate, low, _ in scores)) / len(scores)
    above = math.hypot(*(high - rate for rate, _, high in scores)) / len(scores)
    terms = np.stack([_balanced_terms(row, labels) for row in values])
    return _widen_by_seeds(Interval(mean, mean - below, mean + above), terms, (0.0, 1.0))


def _balanced_terms(right: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Terms (n,) of one training, from right (n,) and labels (n,).

    Their mean is the balanced accuracy, and varies as it does.
    """
    _, groups, sizes = np.unique(labels, return_inverse=True, return_counts=True)
    rates = np.bincount(groups, right) / sizes
    weights = len(labels) / (len(sizes) * sizes)
    return np.asarray(rates.mean() + weights[groups] * (right - rates[groups]))


def image_interval(values: np.ndarray) -> Interval:
    """Mean of values (S, n) or (n,) without bounds, such as the shares that make R²."""
    from scipy import stats

    rows = np.atleast_2d(values)
    images = rows.mean(axis=0)
    mean = float(images.mean())
    count = len(images)
    if count < 2:
        return Interval(mean, mean, mean)
    half = float(stats.t.ppf(0.975, count - 1)) * float(stats.sem(images))
    return _widen_by_seeds(Interval(mean, mean - half, mean + half), rows)


def _widen_by_seeds(
    interval: Interval, terms: np.ndarray, bounds: tuple[float, float] = (-math.inf, math.inf)
) -> Interval:
    """Widen an interval over images, the mean of terms (S, n), by the variance of S > 1 seeds."""
    from scipy import stats

    mean = interval.mean
    reach = float(stats.t.ppf(0.975, max(len(terms) - 1, 1))) * seeds_error(terms)
    low = mean - math.hypot(mean - interval.low, reach)
    high = mean + math.hypot(interval.high - mean, reach)
    return Interval(mean, max(low, bounds[0]), min(high, bounds[1]))


def seeds_error(terms: np.ndarray, off: float = 1.0) -> float:
    """Standard error that training seeds alone give the mean of terms (S, n); 0 for one seed.

    The variance of the trainings holds a share of images and draws: `off` times it is taken off.
    """
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
    """95 % interval of a mean over images; each image counts as one trial."""
    # in closed form: scipy's binomtest, which gives it too, tests a hypothesis first
    return _wilson(round(accuracy * images) / images, images)


def _wilson(rate: float, images: float) -> tuple[float, float]:
    ratio = Z_95**2 / images
    half = math.sqrt(ratio * (rate * (1 - rate) + ratio / 4))
    low, high = ((rate + ratio / 2 + off) / (1 + ratio) for off in (-half, half))
    # Rounding must not leave 0 or 1 outside
    return low if rate > 0 else 0.0, high if rate < 1 else 1.0


def _score(values: np.ndarray) -> Interval:
    """Mean of values (n,) in [0, 1], with Wilson's interval at their effective number."""
    mean = float(values.mean())
    count = len(values)
    squares = float(np.square(values - mean).sum())
    # A square beside the images' own is taken to spread as right and wrong do: among few images
    # with an error the true spread may not show
    share = (squares + 1.0) / (count * mean * (1 - mean) + 1.0)
    return Interval(mean, *_wilson(mean, count / share))


def worst_class(rates: Sequence[float | None]) -> int:
    """Index of the class with the lowest accuracy; classes without one are passed over."""
    return min((rate, index) for index, rate in enumerate(rates) if rate is not None)[1]


CONFIDENCE = 0.95
"""Probability that an interval holds the truth."""


@dataclass(frozen=True)
class Difference:
    """A difference with its standard error."""

    mean: float
    error: float
    freedom: float = math.inf  # degrees of freedom of the error, infinite for a normal one
    seeds_error: float = 0.0
    seeds_freedom: float = math.inf

    def interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """Both ends of an interval of that confidence."""
        from scipy import stats

        images, seeds = stats.t.ppf((1 + confidence) / 2, [self.freedom, self.seeds_freedom])
        half = math.hypot(images * self.error, seeds * self.seeds_error)
        return self.mean - half, self.mean + half

    @property
    def low(self) -> float:
        """Lower end of the 95 % interval."""
        return self.interval()[0]

    @property
    def high(self) -> float:
        """Upper end of the 95 % interval."""
        return self.interval()[1]

    def __neg__(self) -> "Difference":
        return replace(self, mean=-self.mean)

    def __str__(self) -> str:
        if not math.isfinite(self.error):
            return f"{signed_text(self.mean)} (one trial, no interval)"
        return f"{signed_text(self.mean)} [{signed_text(self.low)}, {signed_text(self.high)}]"


def signed_text(value: float, digits: int = 3) -> str:
    """Number with its sign, the minus as wide as the plus."""
    return f"{value:+.{digits}f}".replace("-", "−")


def mean_of_trials(values: Sequence[float]) -> Difference:
    """Mean of a value that each trial has, with its error over trials, if there are several."""
    from scipy import stats

    mean = float(np.mean(values))
    if len(values) < 2:
        return Difference(mean, math.inf)
    return Difference(mean, float(stats.sem(values)), len(values) - 1)


def paired_difference(first: np.ndarray, second: np.ndarray) -> Difference:
    """Mean of values (S, n) of images less that of others (T, n) of the same images.

    Where S is T, trainings of the same seeds are paired.
    """
    # Two more squares as large as the largest are added to those of the images: where few images
    # differ, those that do may be of one sign by chance. Five images that one design alone reads do
    # not tell it apart, and six do, as in the sign test
    gaps = first.mean(axis=0) - second.mean(axis=0)
    mean = float(gaps.mean())
    freedom = max(len(gaps) - 1, 1)
    squares = float(np.square(gaps - mean).sum() + 2 * np.square(gaps).max())
    images = Difference(mean, math.sqrt(squares / freedom / len(gaps)), freedom)
    # Half of the share of images and draws is taken off the trainings' variance: the whole is right
    # in the mean, but the variance of three trainings is often far below that, and alike designs
    # would be told apart in up to 9 of 100 studies instead of 7 (`benchmarks/coverage.py`)
    off = 0.5
    if len(first) == len(second):
        error = seeds_error(first - second, off)
        return replace(images, seeds_error=error, seeds_freedom=max(len(first) - 1, 1))
    error = math.hypot(*(seeds_error(values, off) for values in (first, second)))
    fewest = min(len(values) for values in (first, second) if len(values) > 1)
    return replace(images, seeds_error=error, seeds_freedom=fewest - 1)


def all_above(differences: Iterable[Difference], limit: float = 0.0) -> bool | None:
    """True if all differences are above a limit, False if one is below it, None if unsure."""
    tests = list(differences)
    # Any of them may be below by chance (Bonferroni); that all are above by chance is less likely
    wide = 1 - (1 - CONFIDENCE) / max(len(tests), 1)
    if any(test.interval(wide)[1] < limit for test in tests):
        return False
    return True if all(test.low > limit for test in tests) else None


def find_crossing(
    photons: Sequence[float], accuracies: Sequence[Sequence[float]], images: int, target: float
) -> tuple[float | None, float | None, float | None]:
    """Photons at which the accuracy reaches a target: low end, best value, high end.

    `photons` are the tried budgets (B,), rising; `accuracies` are those of the trials at each. A
    value that the budgets do not enclose is None.

    The tried accuracies are made to rise with the budget (isotonic regression) and joined by a
    monotone cubic over its logarithm. The interval holds all budgets at which the interval of the
    curve holds the target: over test images (Wilson) and training seeds (Student, with one variance
    for all budgets), added in squares.
    """
    from scipy.interpolate import PchipInterpolator
    from sklearn.isotonic import IsotonicRegression

    tried = np.log10(photons)
    means = [float(np.mean(trials)) for trials in accuracies]
    fitted = IsotonicRegression().fit_transform(tried, means)
    below, above = _half_widths(fitted, accuracies, images)
    budgets = np.union1d(np.linspace(tried[0], tried[-1], 1000), tried)
    curve = PchipInterpolator(tried, fitted)(budgets)
    least, most = _curve_bounds(tried, fitted, budgets)
    lower = least - np.interp(budgets, tried, below)
    upper = np.maximum.accumulate(most + np.interp(budgets, tried, above))

    def reached(accuracy: np.ndarray) -> int:
        """Index of the budget from which on the target is reached; their number if none."""
        return int(np.flatnonzero(np.append(True, accuracy < target))[-1])

    indices = reached(upper), reached(curve), reached(lower)
    low, best, high = (
        float(10 ** budgets[index]) if 0 < index < len(budgets) else None for index in indices
    )
    return low, best, high


def _curve_bounds(x: np.ndarray, y: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest values at `at` that a rising curve through points x, y may have."""
    # The hull of three straight lines: the chord of a gap, and those of both gaps beside it,
    # continued into this one (flat where there is none); clipped to the two points of the gap, and
    # at a point its own value
    slopes = np.diff(y) / np.diff(x)
    gap = np.searchsorted(x[1:-1], at, side="right")
    before = np.append(0.0, slopes)[gap]
    after = np.append(slopes, 0.0)[gap + 1]
    lines = np.stack(
        [
            y[gap] + slopes[gap] * (at - x[gap]),
            y[gap] + before * (at - x[gap]),
            y[gap + 1] - after * (x[gap + 1] - at),
        ]
    )
    lines = np.where(np.isin(at, x), lines[0], np.clip(lines, y[gap], y[gap + 1]))
    return lines.min(axis=0), lines.max(axis=0)


def _half_widths(
    fitted: np.ndarray, accuracies: Sequence[Sequence[float]], images: int
) -> tuple[np.ndarray, np.ndarray]:
    """Distance of accuracies to the lower and the upper end of their 95 % interval."""
    from scipy import stats

    low, high = np.transpose([_wilson(rate, images) for rate in fitted])
    # One variance of the seeds for all budgets: three trials tell little of that at one
    freedom = sum(len(trials) - 1 for trials in accuracies)
    seeds = np.zeros(len(fitted))
    if freedom:
        squares = sum(float(np.var(trials)) * len(trials) for trials in accuracies)
        counts = np.array([len(trials) for trials in accuracies])
        seeds = stats.t.ppf(0.975, freedom) * np.sqrt(squares / freedom / counts)
    return np.hypot(fitted - low, seeds), np.hypot(high - fitted, seeds)


def pack_values(values: np.ndarray) -> str:
    """Values (n,) of images as text."""
    content = np.asarray(values, dtype="<f4").tobytes()
    return base64.b64encode(zlib.compress(content, 9)).decode()


def unpack_values(text: str) -> np.ndarray:
    """Values (n,) that `pack_values` wrote; `ValueError` of other text."""
    reader = zlib.decompressobj()
    try:
        # A limit: a short text may unpack to any size
        content = reader.decompress(base64.b64decode(text, validate=True), 2**27)
    except zlib.error as error:
        raise ValueError("values of images are damaged") from error
    values = np.frombuffer(content, dtype="<f4").astype(float)
    if not (reader.eof and values.size and np.isfinite(values).all()):
        raise ValueError("values of images are damaged")
    return values

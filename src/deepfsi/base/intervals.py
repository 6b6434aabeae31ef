"""95 % intervals of what a test measures, over test images and training seeds.

A test of S trainings with different seeds on the same n images gives a value of each image by each
training, such as the share of its noise draws that are right: values (S, n). Images and seeds are
crossed random effects. The mean over seeds of each image tells the variance over images, in which
the noise draws and what is of one training on one image are held already; the means of the
trainings vary by the seeds and by a share of the same, which is taken off. Half widths of both
parts, each by its own quantile, add as squares. Of one training the interval is over images alone.
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
    each = values.mean(axis=0)
    ends = [_score(each[labels == label]) for label in np.unique(labels)]
    mean = sum(rate for rate, _, _ in ends) / len(ends)
    below = math.hypot(*(rate - low for rate, low, _ in ends)) / len(ends)
    above = math.hypot(*(high - rate for rate, _, high in ends)) / len(ends)
    terms = np.stack([_balanced_terms(row, labels) for row in values])
    return _widen_by_seeds(Interval(mean, mean - below, mean + above), terms, (0.0, 1.0))


def _balanced_terms(right: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Terms (n,) of images whose mean is the balanced accuracy, and varies as it does."""
    # right (n,) and labels (n,) of one training
    _, groups, sizes = np.unique(labels, return_inverse=True, return_counts=True)
    rates = np.bincount(groups, right) / sizes
    weights = len(labels) / (len(sizes) * sizes)
    return np.asarray(rates.mean() + weights[groups] * (right - rates[groups]))


def image_interval(values: np.ndarray) -> Interval:
    """Mean of values (S, n) or (n,) without bounds, such as the shares that make R²."""
    from scipy import stats

    rows = np.atleast_2d(values)
    each = rows.mean(axis=0)
    mean = float(each.mean())
    count = len(each)
    if count < 2:
        return Interval(mean, mean, mean)
    half = float(stats.t.ppf(0.975, count - 1)) * float(stats.sem(each))
    return _widen_by_seeds(Interval(mean, mean - half, mean + half), rows)


def _widen_by_seeds(
    found: Interval, terms: np.ndarray, bounds: tuple[float, float] = (-math.inf, math.inf)
) -> Interval:
    """An interval over images, which covers training seeds, too, where there are several."""
    # terms (S, n), whose mean is what is measured
    from scipy import stats

    mean = found.mean
    reach = 0.0
    if len(terms) > 1:
        reach = float(stats.t.ppf(0.975, len(terms) - 1)) * seeds_error(terms)
    low = mean - math.hypot(mean - found.low, reach)
    high = mean + math.hypot(found.high - mean, reach)
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
    """95 % interval of a mean over images; each image counts as one trial."""
    # in closed form: scipy's binomtest, which gives it too, tests a hypothesis first
    return _wilson(round(accuracy * images) / images, images)


def _wilson(rate: float, images: float) -> tuple[float, float]:
    part = Z_95**2 / images
    half = math.sqrt(part * (rate * (1 - rate) + part / 4))
    low, high = ((rate + part / 2 + off) / (1 + part) for off in (-half, half))
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
    """Place of the class with the lowest accuracy, of those that have one."""
    return min((rate, place) for place, rate in enumerate(rates) if rate is not None)[1]


CONFIDENCE = 0.95
"""Of the intervals."""


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
    each = first.mean(axis=0) - second.mean(axis=0)
    mean = float(each.mean())
    freedom = max(len(each) - 1, 1)
    squares = float(np.square(each - mean).sum() + 2 * np.square(each).max())
    images = Difference(mean, math.sqrt(squares / freedom / len(each)), freedom)
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
    """Test that all differences are above a limit."""
    every = list(differences)
    wide = 1 - (1 - CONFIDENCE) / max(len(every), 1)
    if any(each.interval(wide)[1] < limit for each in every):
        return False
    return True if all(each.low > limit for each in every) else None


def find_crossing(
    photons: Sequence[float], accuracies: Sequence[Sequence[float]], images: int, target: float
) -> tuple[float | None, float | None, float | None]:
    """Photons at which the accuracy reaches a target, of budgets (B,) that rise; their interval.

    Low end, best value and high end; None for one that the tried budgets do not enclose.

    The tried accuracies are made to rise with the budget (isotonic regression) and joined by a
    monotone cubic over its logarithm. The interval holds all budgets at which the curve's own one
    holds the target, over test images (Wilson) and training seeds (Student, with one variance for
    all budgets), added in squares.
    """
    from scipy.interpolate import PchipInterpolator
    from sklearn.isotonic import IsotonicRegression

    tried = np.log10(photons)
    means = [float(np.mean(trials)) for trials in accuracies]
    fitted = IsotonicRegression().fit_transform(tried, means)
    below, above = _half_widths(fitted, accuracies, images)
    budgets = np.union1d(np.linspace(tried[0], tried[-1], 1000), tried)
    curve = PchipInterpolator(tried, fitted)(budgets)
    least, most = _shapes(tried, fitted, budgets)
    lower = least - np.interp(budgets, tried, below)
    upper = np.maximum.accumulate(most + np.interp(budgets, tried, above))

    def reached(accuracy: np.ndarray) -> int:
        """From which budget on the target is reached; the number of budgets if at none."""
        short = np.flatnonzero(accuracy < target)
        return int(short[-1]) + 1 if len(short) else 0

    places = reached(upper), reached(curve), reached(lower)
    low, best, high = (
        float(10 ** budgets[place]) if 0 < place < len(budgets) else None for place in places
    )
    return low, best, high


def _shapes(x: np.ndarray, y: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and most that a rising curve through points may plausibly be between them."""
    # The hull of three straight lines: the one that joins two points, and those of the gaps beside
    # it, continued into this one (flat where there is none); never below the lower point nor above
    # the upper one, and at a point its own value
    slopes = np.diff(y) / np.diff(x)
    gap = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(slopes) - 1)
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
    # One variance of the seeds for all budgets: three trials tell little of their own
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
        content = reader.decompress(base64.b64decode(text, validate=True), 2**27)
    except zlib.error as error:
        raise ValueError("values of images are damaged") from error
    values = np.frombuffer(content, dtype="<f4").astype(float)
    if not (reader.eof and values.size and np.isfinite(values).all()):
        raise ValueError("values of images are damaged")
    return values

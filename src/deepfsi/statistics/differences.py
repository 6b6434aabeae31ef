"""Differences of accuracies, image by image and training by training, and tests of claims on them.

Designs are compared on the same test images: what makes an image easy or hard for both cancels in
the difference of each, which interval beside interval would not tell.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from deepfsi.statistics.intervals import Z, seeds_error
from deepfsi.statistics.terms import unpack

CONFIDENCE = 0.95
"""Of the intervals."""


OFF = 0.5
"""Part of the share of images and draws in the trainings' variance that is taken off it: the whole
is right in the mean, but the variance of three trainings is often far below that, and alike designs
would then be told apart in up to 9 of 100 studies instead of 7 (`benchmarks/coverage.py`)."""


class Trials(Protocol):
    """Accuracies of trials, the 95 % interval of their mean, and terms of the test images."""

    @property
    def accuracies(self) -> Sequence[float]:
        """Of each trial, by seed."""

    @property
    def low(self) -> float:
        """Lower end of the interval."""

    @property
    def high(self) -> float:
        """Upper end of the interval."""

    @property
    def terms(self) -> Sequence[str]:
        """Of each trial, values of the test images whose mean is its accuracy; none of old ones."""


@dataclass(frozen=True)
class Difference:
    """A difference with its standard error.

    Attributes
    ----------
    mean : float
    error : float
        Standard error; infinite where one trial cannot give one.
    freedom : float
        Degrees of freedom of the error, infinite for a normal one.
    seeds_error, seeds_freedom : float
        What training seeds add where `error` is over test images.
    """

    mean: float
    error: float
    freedom: float = math.inf
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
            return f"{signed(self.mean)} (one trial, no interval)"
        return f"{signed(self.mean)} [{signed(self.low)}, {signed(self.high)}]"


def signed(value: float, digits: int = 3) -> str:
    """Number with its sign, the minus as wide as the plus."""
    return f"{value:+.{digits}f}".replace("-", "−")


def of_trials(values: Sequence[float]) -> Difference:
    """Mean of one value for each trial, with its error over trials, if there are several."""
    from scipy import stats

    mean, count = float(np.mean(values)), len(values)
    if count < 2:
        return Difference(mean, math.inf)
    return Difference(mean, float(stats.sem(values)), count - 1)


def paired(first: np.ndarray, second: np.ndarray) -> Difference:
    """Mean of values of images less that of others of the same images.

    Parameters
    ----------
    first, second : array, shape (S, n) and (T, n)
        Values of each of n images by each of S and of T trainings. As many trainings are those of
        the same seeds.

    Notes
    -----
    Images and seeds are crossed random effects, as in `statistics.intervals`. Two more squares as
    large as the largest are added to those of the images: where few images differ, those that do
    may be of one sign by chance. Five images that one design alone reads do not tell it apart, and
    six do, as in the sign test.
    """
    each = first.mean(axis=0) - second.mean(axis=0)
    mean, count = float(each.mean()), len(each)
    squares = float(np.square(each - mean).sum() + 2 * np.square(each).max())
    error = math.sqrt(squares / max(count - 1, 1) / count)
    freedom = max(count - 1, 1)
    if len(first) == len(second):
        return Difference(
            mean, error, freedom, seeds_error(first - second, OFF), max(len(first) - 1, 1)
        )
    errors = seeds_error(first, OFF), seeds_error(second, OFF)
    fewest = min(len(part) for part in (first, second) if len(part) > 1)
    return Difference(mean, error, freedom, math.hypot(*errors), fewest - 1)


def difference(first: Trials, second: Trials) -> Difference:
    """Accuracy of some trials less that of others, paired on the images that both were tested with.

    Of trials that keep no values of images those of one seed are paired, and the error is that over
    seeds; of a single such trial it combines the two intervals over images as if these were
    independent.
    """
    if first.terms and second.terms:
        rows = [np.stack([unpack(each) for each in point.terms]) for point in (first, second)]
        if rows[0].shape[1] == rows[1].shape[1]:
            return paired(*rows)
    one, other = (np.asarray(each.accuracies) for each in (first, second))
    if len(one) == len(other) > 1:
        return of_trials((one - other).tolist())
    half = math.hypot(*((each.high - each.low) / 2 for each in (first, second)))
    return Difference(float(one.mean() - other.mean()), half / Z)


def above(differences: Iterable[Difference], limit: float = 0.0) -> bool | None:
    """Test that all differences are above a limit."""
    # Yes if every 95 % interval is. No if one lies below it, by an interval widened for as many
    # comparisons as there are differences (Bonferroni). Else open
    every = list(differences)
    wide = 1 - (1 - CONFIDENCE) / max(len(every), 1)
    if any(each.interval(wide)[1] < limit for each in every):
        return False
    return True if all(each.low > limit for each in every) else None

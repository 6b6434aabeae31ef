"""Differences of accuracies, trial by trial, and tests of claims about them."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import stats

CONFIDENCE = 0.95
"""Of the intervals."""


class Trials(Protocol):
    """Accuracies of trials, and the 95 % interval of their mean."""

    @property
    def accuracies(self) -> Sequence[float]:
        """Of each trial, by seed."""

    @property
    def low(self) -> float:
        """Lower end of the interval."""

    @property
    def high(self) -> float:
        """Upper end of the interval."""


@dataclass(frozen=True)
class Difference:
    """A difference with its standard error."""

    mean: float
    error: float  # standard error; infinite where one trial cannot give one
    freedom: float = math.inf  # degrees of freedom of the error, infinite for a normal one

    def interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """Both ends of an interval of that confidence."""
        half = float(stats.t.ppf((1 + confidence) / 2, self.freedom)) * self.error
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
        return Difference(-self.mean, self.error, self.freedom)

    def __str__(self) -> str:
        if not math.isfinite(self.error):
            return f"{signed(self.mean)} (one trial, no interval)"
        return f"{signed(self.mean)} [{signed(self.low)}, {signed(self.high)}]"


def signed(value: float, digits: int = 3) -> str:
    """Number with its sign, the minus as wide as the plus."""
    return f"{value:+.{digits}f}".replace("-", "−")


def of_trials(values: Sequence[float]) -> Difference:
    """Mean of one value for each trial, with its error over trials, if there are several."""
    mean, count = float(np.mean(values)), len(values)
    if count < 2:
        return Difference(mean, math.inf)
    return Difference(mean, float(stats.sem(values)), count - 1)


def difference(first: Trials, second: Trials) -> Difference:
    """Accuracy of some trials less that of others."""
    # Trials of one seed are paired, and the error is that over them. Of a single trial it combines
    # the two intervals over test images, as if these were independent
    one, other = (np.asarray(each.accuracies) for each in (first, second))
    if len(one) == len(other) > 1:
        return of_trials((one - other).tolist())
    half = math.hypot(*((each.high - each.low) / 2 for each in (first, second)))
    error = half / float(stats.norm.ppf((1 + CONFIDENCE) / 2))
    return Difference(float(one.mean() - other.mean()), error)


def above(differences: Iterable[Difference], limit: float = 0.0) -> bool | None:
    """Test that all differences are above a limit."""
    # Yes if every 95 % interval is. No if one lies below it, by an interval widened for as many
    # comparisons as there are differences (Bonferroni). Else open
    every = list(differences)
    wide = 1 - (1 - CONFIDENCE) / max(len(every), 1)
    if any(each.interval(wide)[1] < limit for each in every):
        return False
    return True if all(each.low > limit for each in every) else None

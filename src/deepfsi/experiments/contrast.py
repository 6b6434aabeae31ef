"""Differences of accuracies, trial by trial, and what they say of a claim."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

Point = Mapping[str, Any]


@dataclass(frozen=True)
class Difference:
    """A difference with its 95 % interval."""

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        low, high = signed(self.low), signed(self.high)
        return f"{signed(self.mean)} [{low}, {high}]"


def signed(value: float, digits: int = 3) -> str:
    """Number with its sign, the minus as wide as the plus."""
    return f"{value:+.{digits}f}".replace("-", "−")


def of_trials(values: Sequence[float]) -> Difference:
    """Mean of one value for each trial, with Student's interval over trials (two at least)."""
    mean = float(np.mean(values))
    half = float(stats.t.ppf(0.975, len(values) - 1) * stats.sem(values))
    return Difference(mean, mean - half, mean + half)


def difference(first: Point, second: Point) -> Difference:
    """Accuracy of one point less that of another.

    Trials of one seed are paired, and the interval is Student's over them. Of a single trial it
    combines the two intervals over test images, as if these were independent.
    """
    one, other = (np.asarray(point["accuracies"]) for point in (first, second))
    if len(one) == len(other) > 1:
        return of_trials(one - other)
    mean = float(one.mean() - other.mean())
    half = math.hypot(*((point["high"] - point["low"]) / 2 for point in (first, second)))
    return Difference(mean, mean - half, mean + half)


def above(differences: Iterable[Difference]) -> bool | None:
    """Whether all differences are above 0: no if an interval lies below, open if one holds 0."""
    every = list(differences)
    if any(each.high < 0 for each in every):
        return False
    return True if all(each.low > 0 for each in every) else None

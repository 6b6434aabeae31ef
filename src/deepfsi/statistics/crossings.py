"""Photons at which a curve of accuracy meets a target, and what they are known to.

The answer is an interval: all budgets at which the curve's own 95 % interval holds the target.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

CURVE_BUDGETS = 1000
"""Budgets at which a curve is computed, between the lowest and the highest tried."""


@dataclass(frozen=True)
class Crossing:
    """Where a curve of accuracy over photons meets a target."""

    # Best estimate; None if the curve does not meet the target within the tried budgets
    photons: float | None
    # Its 95 % interval. An end beyond the tried budgets is None; where all of the interval is, the
    # other end is the budget that it lies beyond
    low: float | None
    high: float | None
    # Whether the estimate is within the tried budgets, the target is reached at the lowest already,
    # or not even at the highest
    found: Literal["within", "below", "beyond"]


def crossing(
    photons: Sequence[float], accuracies: Sequence[Sequence[float]], images: int, target: float
) -> Crossing:
    """Photons at which the accuracy reaches a target."""
    # Accuracy does not fall with more photons, so that the tried ones are brought to order
    # (isotonic regression) and joined by a monotone cubic over the logarithm of the budget. The
    # interval holds all budgets at which the curve's own one holds the target: that of the test
    # images (Wilson) and of training seeds (Student, with one variance for all budgets; none where
    # each has one trial), added in squares, about any shape that the curve may plausibly have
    # between tried budgets
    from scipy.interpolate import PchipInterpolator
    from sklearn.isotonic import IsotonicRegression

    tried = np.log10(photons)
    means = [float(np.mean(trials)) for trials in accuracies]
    fitted = IsotonicRegression().fit_transform(tried, means)
    below, above = _half_widths(fitted, accuracies, images)
    budgets = np.union1d(np.linspace(tried[0], tried[-1], CURVE_BUDGETS), tried)
    curve = PchipInterpolator(tried, fitted)(budgets)
    least, most = _shapes(tried, fitted, budgets)
    lower = least - np.interp(budgets, tried, below)
    upper = np.maximum.accumulate(most + np.interp(budgets, tried, above))

    def reached(accuracy: np.ndarray) -> int:
        """From which budget on the target is reached; the number of budgets if at none."""
        short = np.flatnonzero(accuracy < target)
        return int(short[-1]) + 1 if len(short) else 0

    place, low, high = reached(curve), reached(upper), reached(lower)
    budgets, last = 10**budgets, len(budgets) - 1
    return Crossing(
        photons=float(budgets[place]) if 0 < place <= last else None,
        low=float(budgets[min(low, last)]) if low else None,
        high=float(budgets[high]) if high <= last else None,
        found="below" if place == 0 else "beyond" if place > last else "within",
    )


def _shapes(x: np.ndarray, y: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and most that a rising curve through points may plausibly be between them."""
    # The hull of three straight lines: the one that joins two points, and those of the gaps beside
    # it, continued into this one (flat where there is none); never below the lower point nor above
    # the upper one, and at a point its own value
    slopes = np.diff(y) / np.diff(x)
    gap = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(slopes) - 1)
    before, after = np.append(0.0, slopes)[gap], np.append(slopes, 0.0)[gap + 1]
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

    z = stats.norm.ppf(0.975)
    shrunk = 1 / (1 + z**2 / images)  # Wilson's interval, for rates that are no counts
    middle = shrunk * (fitted + z**2 / (2 * images))
    half = shrunk * z * np.sqrt(fitted * (1 - fitted) / images + z**2 / (4 * images**2))
    freedom = sum(len(trials) - 1 for trials in accuracies)
    seeds = np.zeros(len(fitted))
    if freedom:
        squares = sum(float(np.var(trials)) * len(trials) for trials in accuracies)
        counts = np.array([len(trials) for trials in accuracies])
        seeds = stats.t.ppf(0.975, freedom) * np.sqrt(squares / freedom / counts)
    return np.hypot(fitted - middle + half, seeds), np.hypot(middle + half - fitted, seeds)

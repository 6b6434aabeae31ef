"""Model of the readouts of scenes, and what of counts is compared with it.

The *brightness* of an exposure is all its counts over those of the mean scene. Its *pattern* is the
readouts less their mean shares of all counts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from sklearn.utils.extmath import randomized_svd

DIRECTIONS = 32
"""Directions of the scenes' covariance that are kept, at most; the rest is a diagonal."""

READOUT_ERROR = 0.02
"""Relative error of a readout that a sound device may have: rounded masks, dead time."""

BRIGHTNESS_ERROR = 0.1
"""Relative error of a budget that is estimated well: dead time in the all-ON frame."""

SMALLEST = 1e-12
"""Smallest value of a statistic that is told from 0."""


@dataclass(frozen=True)
class ReadoutModel:
    """Mean and covariance of the R readouts of scenes."""

    total: float  # all counts of the mean scene over the budget
    share: np.ndarray  # (R,): What each readout has of them; above 0
    spread: float  # standard deviation of the brightness
    # (k, R): Patterns of one standard deviation each, along the principal axes of their covariance
    directions: np.ndarray
    rest: np.ndarray  # (R,): Variance of the patterns beyond these

    @classmethod
    def fit(cls, rates: np.ndarray) -> "ReadoutModel":
        """Model of the expected readouts (n, R) of scenes for a budget of one photon."""
        mean = rates.mean(axis=0)
        total = float(mean.sum())
        share = mean / total
        sums = rates.sum(axis=1, keepdims=True) / total
        patterns = (rates / total - sums * share) / np.sqrt(share)
        count = min(DIRECTIONS, *patterns.shape)
        _, sizes, axes = randomized_svd(patterns, count, random_state=0)
        axes = axes * (sizes[:, None] / np.sqrt(len(rates)))
        rest = (np.square(patterns).mean(axis=0) - np.square(axes).sum(axis=0)).clip(min=0)
        return cls(total, share, float(sums.std()), axes * np.sqrt(share), rest * share)

    def statistics(
        self, read: np.ndarray, expected: np.ndarray, dark: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Brightness and pattern of counts (n, R), each a squared distance (n,) from the mean."""
        # read (n, R); expected (n,); dark (n, R)
        scale = expected[:, None]
        sums = read.sum(axis=1, keepdims=True)
        power = (1 + dark.sum(axis=1) / expected) / expected
        power += self.spread**2 + BRIGHTNESS_ERROR**2
        brightness = np.square(sums[:, 0] / expected - 1) / power
        off = (read - sums * self.share) / scale
        floor = self.rest + np.square(READOUT_ERROR * self.share)
        pattern = np.empty(len(read))
        for level, rows in _levels(np.column_stack([expected, dark])):
            noise = (self.share + level[1:] / level[0]) / level[0] + floor
            pattern[rows] = _distance(off[rows], noise, self.directions)
        return brightness, pattern

    def likeness(self, one: Sequence[np.ndarray], other: Sequence[np.ndarray]) -> np.ndarray:
        """Inverse (n,) of the mean squared distance of patterns in units of their noise."""
        power, off = np.zeros(self.share.shape), 0.0
        for sign, (read, expected, dark) in ((1, one), (-1, other)):
            scale, mean = expected[:, None], read.sum(axis=1, keepdims=True) * self.share
            off = off + sign * (read - mean) / scale
            power = power + (np.maximum(mean, self.share) + dark) / np.square(scale)
        return 1 / np.maximum((np.square(off) / power).mean(axis=1), SMALLEST)


def _levels(every: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Different rows (q,) of an array (n, q), each with where it is (n,)."""
    first = every[0]
    if (every == first).all():  # most often, and sorting long rows is slow
        yield first, np.ones(len(every), dtype=bool)
        return
    levels, place = np.unique(every, axis=0, return_inverse=True)
    for k, level in enumerate(levels):
        yield level, place.ravel() == k


def _distance(off: np.ndarray, noise: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Squared Mahalanobis distance (n,) of (n, R) for a diagonal (R,) and directions (k, R)."""
    scaled = directions / noise
    inner = np.eye(len(directions)) + scaled @ directions.T
    along = off @ scaled.T
    within = (along * np.linalg.solve(inner, along.T).T).sum(axis=1)
    return (np.square(off) / noise).sum(axis=1) - within

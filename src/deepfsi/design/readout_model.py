"""Model of the readouts of scenes, and what of counts is compared with it.

The *brightness* of an exposure is all its counts over those of the mean scene. Its *pattern* is the
readouts less their mean shares of all counts.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

DIRECTIONS = 32
"""Directions of the scenes' covariance that are kept, at most; the rest is a diagonal."""

FEW_READOUTS = 128
"""Readouts whose whole covariance is decomposed faster than its main directions are drawn."""

READOUT_ERROR = 0.02
"""Relative error of a readout that a sound device may have: rounded masks, dead time."""

BRIGHTNESS_ERROR = 0.1
"""Relative error of a budget that is estimated well: dead time in the all-ON frame."""

AT_ONCE = 256
"""Exposures with noise of their own that are held in memory."""

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
        axes = _principal(patterns)
        rest = (np.square(patterns).mean(axis=0) - np.square(axes).sum(axis=0)).clip(min=0)
        return cls(total, share, float(sums.std()), axes * np.sqrt(share), rest * share)

    def statistics(
        self, read: np.ndarray, expected: np.ndarray, dark: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Brightness and pattern of counts (n, R), each a squared distance (n,) from the mean."""
        # read, dark (n, R); expected (n,), of the mean scene at weights of 1; weights (n, R), how
        # long each readout was counted over its usual time: one of 0 was not
        whole = expected * (weights @ self.share)
        power = (1 + dark.sum(axis=1) / whole) / whole
        power += self.spread**2 + BRIGHTNESS_ERROR**2
        bright = read.sum(axis=1) / whole
        brightness = np.square(bright - 1) / power
        shown = weights > 0
        scale = np.where(shown, weights, 1.0) * expected[:, None]
        off = np.where(shown, read / scale - bright[:, None] * self.share, 0.0)
        floor = self.rest + np.square(READOUT_ERROR * self.share)
        noise = np.where(shown, (self.share + dark / scale) / scale + floor, np.inf)
        if (noise == noise[0]).all():  # most often of fixed dwells: one matrix serves them all
            return brightness, _distance(off, noise[0], self.directions)
        parts = [
            _distance(off[a : a + AT_ONCE, None], noise[a : a + AT_ONCE], self.directions)[:, 0]
            for a in range(0, len(off), AT_ONCE)
        ]
        return brightness, np.concatenate(parts)

    def likeness(self, one: Sequence[np.ndarray], other: Sequence[np.ndarray]) -> np.ndarray:
        """Inverse (n,) of the mean squared distance of patterns in units of their noise."""
        power, off = np.zeros(self.share.shape), 0.0
        for sign, (read, expected, dark) in ((1, one), (-1, other)):
            scale, mean = expected[:, None], read.sum(axis=1, keepdims=True) * self.share
            off = off + sign * (read - mean) / scale
            power = power + (np.maximum(mean, self.share) + dark) / np.square(scale)
        return 1 / np.maximum((np.square(off) / power).mean(axis=1), SMALLEST)


def _principal(patterns: np.ndarray) -> np.ndarray:
    """Principal axes (k, R) of patterns (n, R), each as long as their standard deviation."""
    count = min(DIRECTIONS, *patterns.shape)
    if patterns.shape[1] <= FEW_READOUTS:
        variances, axes = np.linalg.eigh(patterns.T @ patterns / len(patterns))
        return (axes * np.sqrt(variances.clip(min=0))).T[: -count - 1 : -1]
    from sklearn.utils.extmath import randomized_svd

    _, sizes, axes = randomized_svd(patterns, count, random_state=0)
    return axes * (sizes[:, None] / np.sqrt(len(patterns)))


def _distance(off: np.ndarray, noise: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Squared Mahalanobis distance (..., n) of (..., n, R) for a diagonal (..., R) and (k, R)."""
    scaled = directions / noise[..., None, :]
    inner = np.eye(len(directions)) + scaled @ directions.T
    along = off @ scaled.swapaxes(-1, -2)
    solved = np.linalg.solve(inner, along.swapaxes(-1, -2)).swapaxes(-1, -2)
    return (np.square(off) / noise[..., None, :]).sum(axis=-1) - (along * solved).sum(axis=-1)

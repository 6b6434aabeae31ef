"""Sharing of light: where exposures end, so that scenes take the budget in the mean."""

from bisect import bisect_right
from typing import NamedTuple

import numpy as np

from deepfsi.base.errors import InputError

LIGHT_ROUNDING = 1e-9
"""Light over the budget that sums of shares differ by, at most."""


class Stops(NamedTuple):
    """Where an exposure may stop: after each look."""

    used: np.ndarray  # (K,), share of the budget that is taken then

    def threshold(self, confidence: np.ndarray, light: float) -> float:
        """Highest confidence above which exposures stop and take a share of the light at most.

        From the confidence (E, K) of exposures after each stop.
        """

        def taken(threshold: float) -> float:
            return float(self.used[self.ends(confidence, threshold)].mean())

        tried: list[float] = np.unique(np.append(confidence[:, :-1], [0.0, 1.0])).tolist()
        if taken(tried[0]) > light:
            raise InputError(
                f"the first stop alone takes {self.used[0]:.3g} of the budget, and {light:.3g} is "
                "asked for in the mean: give more looks or a lower cap"
            )
        first = bisect_right(range(len(tried)), light, key=lambda place: taken(tried[place]))
        return tried[first - 1]

    def rules(
        self, confidence: np.ndarray, wrong: np.ndarray, *, light: float, least: float
    ) -> "list[CappedRule]":
        """Rules that take the light, one for each number of stops that takes `least` or more.

        From the confidence (E, K) of exposures after each stop, and whether the answer is wrong (E,
        K). Exposures that are never sure take light from others: it may be better to end them
        sooner.
        """
        every = np.arange(len(confidence))
        rules = []
        for count in range(1, len(self.used) + 1):
            if self.used[count - 1] < least - LIGHT_ROUNDING:
                continue
            stops = Stops(self.used[:count])  # none goes on
            threshold = stops.threshold(confidence[:, :count], light)
            ends = stops.ends(confidence[:, :count], threshold)
            errors = float(wrong[every, ends].mean())
            rules.append(CappedRule(errors, count, float(self.used[count - 1]), threshold))
        return rules

    @staticmethod
    def ends(confidence: np.ndarray, threshold: float) -> np.ndarray:
        """Stop (E,), from 0, at which exposures of confidence (E, K) end: once sure, or last."""
        enough = confidence > threshold
        enough[:, -1] = True
        return enough.argmax(axis=1)

    @classmethod
    def going(cls, confidence: np.ndarray, threshold: float) -> np.ndarray:
        """True where an exposure (E, K) takes a part."""
        return np.arange(confidence.shape[1]) <= cls.ends(confidence, threshold)[:, None]


class CappedRule(NamedTuple):
    """Where exposures end; the least is that of fewest wrong answers, of equals the shortest."""

    wrong: float  # share of the answers that are
    stops: int  # number of stops that the longest exposure has
    cap: float  # share of the budget that it takes
    threshold: float  # confidence above which others end

"""Transits in a photon file without markers: rises of the rate, and the counts of their bins.

A window as long as a transit slides over the record, and a transit is where it holds k photons or
more. Of background alone, Poisson events of rate b, it holds N photons with the mean μ = b L. N
rises to k where a photon arrives while N = k − 1, and arrivals see N as it is at any time. So a
record of the time D has

    b D P(N = k − 1) + P(N ≥ k)

rises to k in the mean, overlapping windows and all, the last term for a record that begins so. That
bounds the chance of any false alarm, and k is the least that keeps it below what is asked for.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import poisson

from deepfsi.base.errors import InputError

FINE = 8
"""Steps of a bin in which the place of a transit is sought."""

DIMMEST = 0.01
"""Background over the mean rate of a transit that a stray photon is held against at least."""

LEAST_WINDOWS = 10
"""Windows without transits that the background is estimated from at least."""

ROUNDS = 50
"""Rounds in which the background is estimated from what is left beside transits, at most."""


@dataclass(frozen=True)
class Threshold:
    """Least photons in a window that make a transit, and how often background has them."""

    photons: int  # k
    false_alarms: float  # expected ones in the record


def false_alarms(level: int, background: float, window: float, duration: float) -> float:
    """Expected number of windows that background alone fills to a level in a record."""
    mean = background * window
    rises = background * duration * poisson.pmf(level - 1, mean)
    return float(rises + poisson.sf(level - 1, mean))


def find_threshold(background: float, window: float, duration: float, allowed: float) -> Threshold:
    """Least level whose false alarms in a record are so many at most, and not below the mean."""
    level = max(int(background * window) + 1, 2)  # below the mean rises are rare, too
    while (found := false_alarms(level, background, window, duration)) > allowed:
        level += max(1, int(math.sqrt(level) / 8))
    while level > 2 and level > background * window + 1:
        less = false_alarms(level - 1, background, window, duration)
        if less > allowed:
            break
        level, found = level - 1, less
    return Threshold(level, found)


def find_transits(times: np.ndarray, window: float, level: int) -> np.ndarray:
    """Starts (n,) of the windows that hold most photons, of each transit in rising times."""
    low = np.searchsorted(times, times - window, side="right")
    bright = np.flatnonzero(np.arange(len(times)) - low + 1 >= level)
    starts, first = list[float](), 0
    while True:
        # photons of a transit are not counted again in the next one
        place = np.searchsorted(bright, first + level - 1)
        if place == len(bright):
            return np.array(starts, float)
        risen = int(bright[place])
        until = np.searchsorted(times, times[risen] + window, side="right")
        near = np.arange(risen, until)
        last = int(near[np.argmax(near - np.maximum(low[near], first))])
        starts.append(times[last] - window)
        first = last + 1


def find_background(times: np.ndarray, window: float, duration: float, allowed: float) -> float:
    """Rate of the background, from the record without its transits and a window on each side."""
    # One photon is added, so that none in a short stretch is not taken for none at all
    kept, left = len(times), duration
    for _ in range(ROUNDS):
        rate = kept / left
        level = find_threshold(rate, window, duration, allowed).photons
        starts = find_transits(times, window, level)
        spans = _joined(starts - window, starts + 2 * window, duration)
        left = duration - float(np.diff(spans, axis=1).sum())
        if left < LEAST_WINDOWS * window:
            raise InputError(
                f"less than {LEAST_WINDOWS} transits of this record's time is without any, too "
                "little to know the background from: give `background`"
            )
        inside = np.diff(np.searchsorted(times, spans), axis=1).sum()
        if (found := len(times) - int(inside)) == kept:
            break
        kept = found
    return (kept + 1) / left


def _joined(starts: np.ndarray, stops: np.ndarray, duration: float) -> np.ndarray:
    """Spans (m, 2) that cover some that rise and may overlap, within a record."""
    starts, stops = starts.clip(0, duration), stops.clip(0, duration)
    if not len(starts):
        return np.zeros((0, 2))
    apart = starts[1:] > stops[:-1]
    return np.stack([starts[np.append(True, apart)], stops[np.append(apart, True)]], axis=1)


def align(
    times: np.ndarray, starts: np.ndarray, bin_s: float, trace: np.ndarray, background: float
) -> np.ndarray:
    """Starts (n,) at which photons are likeliest those of a mean trace, up to half a transit off.

    The trace (T,) is the mean counts of each bin. Σ log(1 + rate / background) over the photons is
    the logarithm of the likelihood, but for a constant.
    """
    cells = FINE * len(trace)
    rate = np.repeat(trace, FINE) / bin_s
    weight = np.log1p(rate / max(background, DIMMEST * rate.mean()))
    step = bin_s / FINE
    moved = []
    for start in starts:
        origin = start - cells // 2 * step
        inside = times[np.searchsorted(times, origin) :]
        inside = inside[: np.searchsorted(inside, origin + 2 * cells * step)]
        found = np.bincount(((inside - origin) / step).astype(int), minlength=2 * cells)
        score = np.correlate(found[: 2 * cells].astype(float), weight, "valid")
        best = np.flatnonzero(score == score.max())
        moved.append(origin + step * float(best.mean()))
    return np.array(moved)


def count_bins(times: np.ndarray, starts: np.ndarray, bin_s: float, bins: int) -> np.ndarray:
    """Photons (n, T) in the bins of transits that begin at some times."""
    edges = starts[:, None] + bin_s * np.arange(bins + 1)
    return np.diff(np.searchsorted(times, edges), axis=1)

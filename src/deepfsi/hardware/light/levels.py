"""Rates from pass to pass: where they change, and what is common between two changes.

A row of passes is cut where a part of it, at one of its ends or within, is brighter or darker than
the rest beyond chance and beyond what is allowed; then each part is looked at in the same way.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from deepfsi.hardware.light.tails import excess_chance

Allowed = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Ratio of the rates of two parts at most, from the passes of each."""


@dataclass(frozen=True)
class Row:
    """Rates of passes in their order; those of several sum."""

    counts: np.ndarray  # (P,): Photons, less the background where it is known, and their variance
    variances: np.ndarray  # (P,)
    seconds: np.ndarray  # (P,)

    def sums(self) -> np.ndarray:
        """Sums of counts, variances and seconds over the first 0 … P passes, (3, P + 1)."""
        held = np.stack([self.counts, self.variances, self.seconds]).astype(np.float64)
        return np.pad(np.cumsum(held, axis=1), ((0, 0), (1, 0)))


def find_parts(row: Row, allowed: Allowed, chance: float) -> list[slice]:
    """Parts of a row that have one rate each, in their order."""
    parts, todo, sums = [], [(0, len(row.counts))], row.sums()
    while todo:
        start, stop = todo.pop()
        cut = _find_cut(sums[:, start : stop + 1], allowed, chance)
        if cut is None:
            parts.append(slice(start, stop))
            continue
        edges = [0, *cut, stop - start]
        todo += [(start + a, start + b) for a, b in pairwise(edges) if b > a]
    return sorted(parts, key=lambda part: int(part.start))


def _find_cut(sums: np.ndarray, allowed: Allowed, chance: float) -> tuple[int, int] | None:
    """Start and stop of the part that stands out most from the rest of a row, if any does."""
    passes = sums.shape[1] - 1
    if passes < 2:
        return None
    edges = np.arange(1, passes)
    starts, stops = [np.zeros_like(edges)], [edges]
    length = 1
    while length <= passes // 2:
        first = np.arange(1, passes - length)
        starts.append(first)
        stops.append(first + length)
        length *= 2
    start, stop = np.concatenate(starts), np.concatenate(stops)
    clearness, chances = _compare(sums, start, stop, allowed)
    best = int(np.argmax(clearness))
    if chances[best] * len(start) > chance:
        return None
    return _refine(sums, (int(start[best]), int(stop[best])), allowed)


def _refine(sums: np.ndarray, cut: tuple[int, int], allowed: Allowed) -> tuple[int, int]:
    """Move both ends of a part, pass by pass, while it stands out more."""
    passes = sums.shape[1] - 1
    while True:
        tries = [(cut[0] + i, cut[1] + j) for i in (0, -1, 1) for j in (0, -1, 1)]
        tries = [(a, b) for a, b in tries if 0 <= a < b <= passes and b - a < passes]
        start, stop = np.array(tries).T
        best = tries[int(np.argmax(_compare(sums, start, stop, allowed)[0]))]
        if best == cut:
            return cut
        cut = best


def _compare(
    sums: np.ndarray, start: np.ndarray, stop: np.ndarray, allowed: Allowed
) -> tuple[np.ndarray, np.ndarray]:
    """Difference of each part from the rest in standard errors, and the chance of it."""
    passes = sums.shape[1] - 1
    inner = sums[:, stop] - sums[:, start]
    outer = sums[:, -1:] - sums[:, :1] - inner
    (one, one_s), (other, other_s) = _as_photons(inner), _as_photons(outer)
    ratio = allowed(stop - start, passes - (stop - start))
    more = excess_chance(one, one_s, other, other_s, ratio)
    less = excess_chance(other, other_s, one, one_s, ratio)
    apart = np.abs(np.log((one + 0.5) / one_s) - np.log((other + 0.5) / other_s)) - np.log(ratio)
    clearness = apart / np.sqrt(1 / (one + 0.5) + 1 / (other + 0.5))
    return clearness, np.minimum(1.0, 2 * np.minimum(more, less))


def _as_photons(sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Photons, and the time they take, of Poisson counts with the same rate and relative error."""
    counts, variances, seconds = np.maximum(sums[0], 0.0), sums[1], sums[2]
    # Counts below their noise, or less than 0, tell as little as those that are as large as it
    size = np.maximum(counts, np.sqrt(variances))
    weight = np.where(variances > 0, size / np.where(variances > 0, variances, 1.0), 1.0)
    return counts * weight, seconds * weight

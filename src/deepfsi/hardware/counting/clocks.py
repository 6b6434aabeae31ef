"""Clock of a recording: by how much its frames last longer or shorter than planned.

The counter's clock and the device's may differ, and a device may add the same time to every frame.
Either stretches the whole schedule; which one is measured from markers that follow each other, at
many places of the recording, so that missing or doubled markers do not matter. Nothing is decided
here: markers are then brought to the stretched schedule as closely as to the planned one.
"""

from dataclasses import dataclass

import numpy as np

FRAMES_OF_BLOCK = 8
"""Frames in a row that are compared with the schedule, at most, and half of a pass."""

MOST_BLOCKS = 64
"""Places of a recording that are compared."""

MOST_PLACES = 4096
"""Places of the schedule that each is compared with, the first ones."""

MOST_RATE = 0.02
"""Most that all frames may be longer or shorter than planned, as a share of each."""

MOST_EXTRA = 0.2
"""Most that may be added to each frame, as a share of the shortest."""

GOLDEN = 0.6180339887498949
"""Golden section: fractional parts of its multiples are spread evenly, out of step with passes."""


@dataclass(frozen=True)
class Clock:
    """Frames on the counter's clock: 1 + `rate` times the planned time, and `extra_s` seconds."""

    rate: float = 0.0
    extra_s: float = 0.0

    def stretch(self, pictures: np.ndarray) -> np.ndarray:
        """Picture times on the counter's clock, from the planned ones, seconds."""
        return (1 + self.rate) * pictures + self.extra_s


def measure_clock(times: np.ndarray, pictures: np.ndarray, tolerance: float) -> Clock | None:
    """Clock on which most markers in a row follow the schedule, None where there is none."""
    # times (n,); pictures (F,)
    size = min(FRAMES_OF_BLOCK, len(pictures) // 2)
    if len(times) <= size:
        return None
    planned = np.lib.stride_tricks.sliding_window_view(pictures[:-1], size)[:MOST_PLACES]
    steps = np.lib.stride_tricks.sliding_window_view(np.diff(times), size)
    places = np.unique((np.arange(MOST_BLOCKS) * GOLDEN % 1 * len(steps)).astype(np.int64))
    total, shortest = planned.sum(axis=1), float(pictures.min())
    rates, extras = [], []
    for block in steps[places]:
        rate = block.sum() / total - 1
        extra = (block.sum() - total) / size
        proportional = np.abs(block - (1 + rate[:, None]) * planned).max(axis=1)
        constant = np.abs(block - planned - extra[:, None]).max(axis=1)
        proportional[np.abs(rate) > MOST_RATE] = np.inf
        constant[(extra > MOST_EXTRA * shortest) | (extra < -MOST_RATE * shortest)] = np.inf
        rates.append(_best(rate, proportional))
        extras.append(_best(extra, constant))
    by_rate, by_extra = (_agree(found, 2 * tolerance) for found in (rates, extras))
    if by_rate is None and by_extra is None:
        return None
    if by_extra is None or (by_rate is not None and by_rate[1] <= by_extra[1]):
        assert by_rate is not None
        return Clock(rate=by_rate[0])
    return Clock(extra_s=by_extra[0])


def _best(values: np.ndarray, off: np.ndarray) -> tuple[float, float]:
    """Value that fits best, and by how much it is off."""
    place = int(np.argmin(off))
    return float(values[place]), float(off[place])


def _agree(found: list[tuple[float, float]], most: float) -> tuple[float, float] | None:
    """Middle value of those that fit and by how much they are off; None if few fit."""
    fits = np.array([each for each in found if each[1] <= most])
    if len(fits) < len(found) / 8:
        return None
    values, off = np.median(fits, axis=0)
    return float(values), float(off)

"""Timing of patterns: gates in which photons of each frame are counted, and the cost of a pass."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from deepfsi.base import InputError, time_text
from deepfsi.hardware.patterns.sequence import Manifest

SHORTEST_GATE_S = 1e-15
"""Shortest gate, seconds."""

LONGEST_SETTLE_S = 1e4
"""Longest time before the first gate of a frame, seconds."""


USUAL_TOLERANCE_S = 1e-5
"""By how much a frame's marker may be off, seconds."""

USUAL_SHARE = 0.1
"""The most of it, as a share of the shortest frame."""


@dataclass(frozen=True)
class Gates:
    """Gates of the masks' frames, in seconds after each frame's start."""

    settle_s: float  # before the first gate of each frame
    length_s: np.ndarray  # (f,): Duration of a gate: share times exposure
    # R, gates that follow each other in every frame; gate r of all frames is one exposure
    repeats: int

    @property
    def starts_s(self) -> np.ndarray:
        """Starts of the gates, shape (f, R)."""
        return self.settle_s + self.length_s[:, None] * np.arange(self.repeats)


@dataclass(frozen=True)
class ClickGates:
    """Equal parts of what each frame is exposed for, in which a detector fires at most once."""

    # Of a mask's frame the gates of its exposures, each cut in as many parts; of an all-ON or
    # all-OFF frame what is left of it between settling and the usual tolerance of markers
    number: int  # in an exposure
    offset_s: float  # of the first in each frame, after its start
    width_s: np.ndarray  # (F,): Duration of each
    exposures: np.ndarray  # (F,): How many follow each other in a frame: R, or 1 of a sentinel

    @classmethod
    def of(cls, manifest: Manifest, gates: Gates, number: int) -> Self:
        """So many in each exposure of the frames of a pass."""
        width = (manifest.picture_s - gates.settle_s - usual_tolerance(manifest)) / number
        width[manifest.shown] = gates.length_s / number
        exposures = np.ones(len(width), np.int64)
        exposures[manifest.shown] = gates.repeats
        return cls(number, gates.settle_s, width, exposures)


def usual_tolerance(manifest: Manifest) -> float:
    """By how much a frame's marker may be off unless another tolerance is given, seconds."""
    return min(USUAL_SHARE * float(manifest.picture_s.min()), USUAL_TOLERANCE_S)


def longest_exposure(manifest: Manifest, settle_s: float) -> float:
    """Longest exposure, seconds, whose gates fit all frames after the time to settle."""
    room = (manifest.picture_s[manifest.shown] - settle_s) / manifest.shares
    return float(room.min())


def find_gates(
    manifest: Manifest, exposure_s: float, settle_s: float | None = None, repeats: int | None = None
) -> Gates:
    """Gates of an exposure, as many of them in a frame as fit all frames."""
    settle = manifest.device.settle_us * 1e-6 if settle_s is None else settle_s
    if not (math.isfinite(exposure_s) and exposure_s > 0):
        raise InputError(f"exposure {exposure_s!r} is not allowed: give seconds above 0")
    if not 0 <= settle <= LONGEST_SETTLE_S:
        raise InputError(
            f"settle time {settle!r} is not allowed: give 0 to {LONGEST_SETTLE_S:g} seconds"
        )
    length = manifest.shares * exposure_s
    if not (len(length) and length.min() > SHORTEST_GATE_S):
        raise InputError(
            f"an exposure of {time_text(exposure_s)} leaves a frame less than {SHORTEST_GATE_S:g} "
            "s: "
            "give a longer one"
        )
    longest = longest_exposure(manifest, settle)
    fit = int(np.floor(longest / exposure_s * (1 + 1e-9)))
    if fit < 1:
        raise InputError(
            f"an exposure of {time_text(exposure_s)} does not fit these frames, whose mirrors take "
            f"{time_text(settle)} to settle: "
            f"give at most {time_text(max(longest, 0))}, or export with a longer --exposure"
        )
    if repeats is not None and not 1 <= repeats <= fit:
        raise InputError(f"{repeats} repeats do not fit: give 1 to {fit}")
    return Gates(settle, length, repeats or fit)


@dataclass(frozen=True)
class Cost:
    """Shares of a pass in which nothing is counted."""

    sentinels: float  # frames for alignment, flux and dark
    settling: float  # starts of the masks' frames, while mirrors move
    # What the gates leave of the masks' frames: pictures that are longer than their share because
    # no device shows shorter ones, and what is left where one more gate does not fit
    idle: float

    @property
    def total(self) -> float:
        """Share of the clock in which no gate is open."""
        return self.sentinels + self.settling + self.idle


def find_cost(manifest: Manifest, gates: Gates) -> Cost:
    """Shares of a pass in which no gate is open, by their causes."""
    masks = float(manifest.picture_s[manifest.shown].sum())
    settling = gates.settle_s * len(manifest.shown)
    idle = masks - settling - gates.repeats * float(gates.length_s.sum())
    whole = manifest.pass_s
    return Cost((whole - masks) / whole, settling / whole, max(idle, 0.0) / whole)

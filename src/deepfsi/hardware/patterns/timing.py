"""Timing of patterns: gates in which photons of each frame are counted, and the cost of a pass."""

import math
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.quantities import time_text
from deepfsi.hardware.patterns.manifest import Manifest

SHORTEST_GATE_S = 1e-15
"""Shortest gate, seconds."""

LONGEST_SETTLE_S = 1e4
"""Longest time before the first gate of a frame, seconds."""


@dataclass(frozen=True)
class ExposureCost:
    """Shares of a pass in which nothing is counted."""

    sentinels: float  # frames for alignment, flux and dark
    settling: float  # starts of the masks' frames, while mirrors move
    idle: float

    @property
    def total(self) -> float:
        """Share of the clock in which no gate is open."""
        return self.sentinels + self.settling + self.idle


@dataclass(frozen=True)
class GatePlan:
    """Gates of the frames of a pass, as they are asked for, in seconds after each frame's start.

    With clicks, each gate of a mask's frame is cut in as many equal parts, in which a detector
    fires at most once. An all-ON or all-OFF frame then has as many parts of what is left of it
    between settling and the usual tolerance of markers.
    """

    settle_s: float  # time before the first gate of each frame
    length_s: np.ndarray  # duration of a gate of each mask's frame, (f,): share times exposure
    repeats: int  # R, gates that follow each other in every mask's frame
    clicks: int = 0  # parts of each gate
    click_width_s: np.ndarray = field(default_factory=lambda: np.zeros(0))
    click_exposures: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))

    @classmethod
    def of(
        cls,
        manifest: Manifest,
        exposure_s: float,
        settle_s: float | None = None,
        repeats: int | None = None,
    ) -> Self:
        """Gates of an exposure."""
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
                f"an exposure of {time_text(exposure_s)} leaves a frame less than "
                f"{SHORTEST_GATE_S:g} s: give a longer one"
            )
        longest = manifest.longest_exposure_s(settle)
        fit = int(np.floor(longest / exposure_s * (1 + 1e-9)))
        if fit < 1:
            raise InputError(
                f"an exposure of {time_text(exposure_s)} does not fit these frames, whose mirrors "
                f"take {time_text(settle)} to settle: give at most {time_text(max(longest, 0))}, "
                "or export with a longer --exposure"
            )
        if repeats is not None and not 1 <= repeats <= fit:
            raise InputError(f"{repeats} repeats do not fit: give 1 to {fit}")
        return cls(settle, length, repeats or fit)

    def with_clicks(self, manifest: Manifest, number: int) -> Self:
        """Gates each cut in so many parts, in which a detector fires at most once."""
        left = manifest.picture_s - self.settle_s - manifest.usual_tolerance_s
        width = left / number
        width[manifest.shown] = self.length_s / number
        exposures = np.ones(len(width), np.int64)
        exposures[manifest.shown] = self.repeats
        return replace(self, clicks=number, click_width_s=width, click_exposures=exposures)

    @property
    def starts_s(self) -> np.ndarray:
        """Starts of the gates, shape (f, R)."""
        return self.settle_s + self.length_s[:, None] * np.arange(self.repeats)

    def cost(self, manifest: Manifest) -> ExposureCost:
        """Shares of a pass in which no gate is open, by their causes."""
        masks = float(manifest.picture_s[manifest.shown].sum())
        settling = self.settle_s * len(manifest.shown)
        idle = masks - settling - self.repeats * float(self.length_s.sum())
        total = manifest.pass_s
        return ExposureCost(
            sentinels=(total - masks) / total,
            settling=settling / total,
            idle=max(idle, 0.0) / total,
        )

"""Counts that do not come from the scene: dark counts and ambient light."""

import numpy as np

from deepfsi.errors import InputError
from deepfsi.hardware.patterns.sequence import Patterns


def black_rates(on_rate: np.ndarray, off_rate: np.ndarray) -> tuple[float, float]:
    """Dark and ambient rates of a run with the display black."""
    # From counts/s in the frames with all mirrors ON and OFF, as `counts.Counts` has them. NaN
    # passes are left out; an ambient rate below 0 is noise and becomes 0. Raises `InputError` if no
    # pass has both rates
    on, off = np.broadcast_arrays(np.asarray(on_rate, float), np.asarray(off_rate, float))
    whole = np.isfinite(on) & np.isfinite(off)
    if not whole.any():
        raise InputError("no pass has frames all ON and all OFF: record the black scene again")
    dark = float(off[whole].mean())
    return dark, max(0.0, float(on[whole].mean()) - dark)


def expected_background(
    patterns: Patterns,
    exposure_s: float,
    dark: float | np.ndarray,
    ambient: float | np.ndarray = 0.0,
) -> np.ndarray:
    """Expected counts of each readout that do not come from the scene."""
    # The dark rate counts during every gate; ambient light as far as the frame's mirrors are ON,
    # spread evenly over the cells. dark, ambient (rails,)
    manifest = patterns.manifest
    dark, ambient = (np.broadcast_to(rate, manifest.rails) for rate in (dark, ambient))
    opened = patterns.fractions.mean(axis=1)
    lit, gates = np.stack([opened, 1 - opened]), manifest.shares * exposure_s
    rail, mask, column, arm = manifest.read
    out = np.zeros((manifest.rails, manifest.masks))
    out[rail, mask] = gates[column] * (dark[rail] + ambient[rail] * lit[arm, column])
    return out


def subtract_background(counts: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Counts (..., rails, m) less what `expected_background` gives; its noise stays."""
    # Raises `InputError` if the counts are not those of the patterns
    if np.shape(counts)[-2:] != expected.shape:
        raise InputError(
            f"counts of shape {np.shape(counts)} are not of these patterns: give "
            f"(..., {expected.shape[0]}, {expected.shape[1]})"
        )
    return np.asarray(counts) - expected

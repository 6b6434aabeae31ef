"""Counts that do not come from the scene: dark counts and ambient light."""

import numpy as np

from deepfsi.hardware.patterns.sequence import Patterns


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

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
    out = np.zeros((manifest.rails, manifest.masks))
    opened = patterns.fractions.mean(axis=1)
    for place, share, part in zip(manifest.shown, manifest.shares, opened, strict=True):
        frame, gate = manifest.frames[place], share * exposure_s
        if frame.rail in ("plus", "both"):
            out[0, frame.mask] = gate * (dark[0] + ambient[0] * part)
        if frame.rail in ("minus", "both"):
            part = 1 - part if frame.rail == "both" else part
            out[1, frame.mask] = gate * (dark[1] + ambient[1] * part)
    return out

"""Counts of a counter's inputs in each frame, put in the order of the readouts."""

from typing import Any

import numpy as np

from deepfsi.hardware.patterns.sequence import Manifest


def by_readout(manifest: Manifest, found: np.ndarray) -> np.ndarray:
    """Numbers of readouts (..., rails, m[, D]) from those of masks' frames (..., f, inputs)."""
    # 0 for a rail that is dark
    lead, detectors = found.shape[:-2], manifest.detector_count
    split = found.reshape(*found.shape[:-1], -1, detectors)
    out = np.zeros((*lead, manifest.rails, manifest.masks, detectors), found.dtype)
    rail, mask, column, arm = manifest.read
    out[..., rail, mask, :] = split[..., column, arm, :]
    return out.reshape(*out.shape[:-1], *manifest.several)


def lengths_by_readout(manifest: Manifest, lengths: np.ndarray) -> np.ndarray:
    """For how long each readout is counted (rails, m), from the gates of masks' frames (f,)."""
    out = np.zeros((manifest.rails, manifest.masks))
    rail, mask, column, _ = manifest.read
    out[rail, mask] = lengths[column]
    return out


def by_rail(manifest: Manifest, found: np.ndarray) -> np.ndarray:
    """Numbers (..., rails[, D]) of the inputs that read each rail, from those of all (..., i)."""
    # One arm reads both rails, of two each its own
    split = found.reshape(*found.shape[:-1], -1, manifest.detector_count)
    wide: Any = (*found.shape[:-1], manifest.rails, manifest.detector_count)
    return np.broadcast_to(split, wide).reshape(*wide[:-1], *manifest.several)

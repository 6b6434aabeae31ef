"""Least-squares pictures of scenes from their counts."""

import os

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.camera.detectors import DetectorMap
from deepfsi.hardware.counting.acquisition import read_run
from deepfsi.hardware.counting.counts import read_counts

LEAST_SINGULAR_VALUE = 1e-3
"""Least singular value that a picture is made from, of the sensing matrix's largest."""


def reconstruct(folder: str | os.PathLike[str]) -> np.ndarray:
    """Least-squares picture of each scene from its counts, less background."""
    # The mean of all valid exposures, and of all pictures that explain it the one of smallest norm.
    # Directions that the masks hardly see are left out (singular values below 1e-3 of the largest)
    run = read_run(folder)
    patterns = run.patterns
    counts = read_counts(run).check_photons(folder)
    stated = run.acquisition.flux
    flux = np.nanmean(counts.flux) if stated is None else stated
    budget = float(flux * counts.exposure_s)
    if not budget > 0:
        raise InputError(f"{folder} has no light: its all-ON frames are not brighter than the dark")
    valid = np.asarray(counts.valid.any(axis=1))
    weights = counts.valid / np.maximum(counts.valid.sum(axis=1, keepdims=True), 1)
    mean = np.einsum("sr,sr...->s...", weights, counts.signal())[valid]
    read = counts.lengths_s > 0
    out = np.full((len(valid), patterns.on.shape[1]), np.nan)
    found = _solve(patterns.rails[read], mean[:, read], patterns.manifest.detectors)
    out[valid] = found * (patterns.manifest.summed_reflectance / budget)
    return out.reshape(len(valid), *patterns.manifest.image_shape)


def _solve(masks: np.ndarray, counts: np.ndarray, detectors: DetectorMap | None) -> np.ndarray:
    """Pictures (S, N) of counts (S, k[, D]) behind masks (k, N): each detector's of its cells."""
    from scipy.linalg import lstsq

    if detectors is not None and detectors.cells is not None:
        out = np.empty((len(counts), masks.shape[1]))
        labels = np.array(detectors.cells)
        for place in range(detectors.count):
            own = labels == place
            out[:, own] = _solve(masks[:, own], counts[..., place], None)
        return out
    every = counts if detectors is None else counts.sum(axis=-1)
    return np.asarray(lstsq(masks, every.T, cond=LEAST_SINGULAR_VALUE)[0].T)

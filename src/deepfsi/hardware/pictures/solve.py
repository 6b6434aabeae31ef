"""Least-squares pictures of scenes from their counts, or from the wavelet coefficients they are."""

import os
import re
from typing import Any

import numpy as np

from deepfsi.base.errors import InputError, closest_choice
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


ROWS_AT_ONCE = 512
"""Masks that are turned into floating point at once."""

ORTHOGONAL = 1e-9
"""Relative error up to which M Mᵀ is a multiple of the identity."""


def solve_masks(masks: np.ndarray, readouts: np.ndarray) -> np.ndarray:
    """Least-squares pictures of readouts behind masks."""
    # Of masks that are orthogonal and of one norm, M⁺ = Mᵀ / c. A random vector, which other
    # matrices do not carry to c times itself, tells whether they are
    rows = [slice(a, a + ROWS_AT_ONCE) for a in range(0, len(masks), ROWS_AT_ONCE)]
    probe = np.random.default_rng(0).standard_normal(len(masks))
    both = np.vstack([probe, readouts])
    back = np.zeros((len(both), masks.shape[1]))
    for part in rows:
        back += both[:, part] @ masks[part].astype(np.float64)
    again = np.concatenate([masks[part].astype(np.float64) @ back[0] for part in rows])
    scale = float(again @ probe / (probe @ probe))
    if np.abs(again - scale * probe).max() <= ORTHOGONAL * abs(scale):
        return np.asarray(back[1:] / scale)
    return _solve(masks.astype(np.float64), readouts, None)


WAVELETS = {"legall": "bior2.2", "cdf5.3": "bior2.2", "cdf9.7": "bior4.4"}
"""Wavelets that PyWavelets has under another name."""


def wavelet_of(name: str) -> tuple[str, int] | None:
    """Wavelet and levels of a name such as "wavelet-haar-4"; None for another name."""
    parts = re.fullmatch(r"wavelet-([a-z0-9.]+)-([1-9]\d?)", name.lower())
    if parts is None:
        return None
    try:
        import pywt
    except ImportError:
        raise InputError(
            f"{name} needs PyWavelets: install it with pip install 'deepfsi[wavelets]'"
        ) from None
    wavelet = WAVELETS.get(parts[1], parts[1])
    known = [*WAVELETS, *pywt.wavelist(kind="discrete")]
    if wavelet not in known:
        raise InputError(f"unknown wavelet {parts[1]!r}: {closest_choice(parts[1], known)}")
    return wavelet, int(parts[2])


def solve_wavelets(coefficients: np.ndarray, wavelet: str, levels: int) -> tuple[np.ndarray, bool]:
    """Picture of wavelet coefficients, and whether their details are the second less the first."""
    if any(side % 2**levels for side in coefficients.shape):
        raise InputError(
            f"coefficients of shape {coefficients.shape} have no {levels} levels: each side must "
            f"be a multiple of {2**levels}"
        )
    return _smoother(split_levels(coefficients, levels), wavelet)


def coarse_light(parts: list[Any], wavelet: str) -> np.ndarray:
    """Means of the next finer level, of either sign of the details the smoother ones."""
    return _smoother(parts, wavelet)[0]


def _smoother(parts: list[Any], wavelet: str) -> tuple[np.ndarray, bool]:
    """The smoother picture of both signs of the details, and whether it is the reverse one."""
    found = [_synthesise(parts, wavelet, sign) for sign in (1.0, -1.0)]
    place = int(np.argmin([_roughness(one) for one in found]))
    return found[place], bool(place)


def _synthesise(parts: list[Any], wavelet: str, sign: float) -> np.ndarray:
    import pywt

    tree = [parts[0], *((sign * down, sign * across, both) for down, across, both in parts[1:])]
    return np.asarray(pywt.waverec2(tree, wavelet, mode="periodization"))


def _roughness(picture: np.ndarray) -> float:
    """Total variation."""
    return float(sum(np.abs(np.diff(picture, axis=axis)).sum() for axis in (0, 1)))


def split_levels(coefficients: np.ndarray, levels: int) -> list[Any]:
    """Coarsest means, then (down, across, both) of each level from the coarsest to the finest."""
    down, across = coefficients.shape
    parts: list[Any] = [coefficients[: down >> levels, : across >> levels]]
    for level in range(levels, 0, -1):
        a = down >> level
        b = across >> level
        parts.append(
            (
                coefficients[a : 2 * a, :b],
                coefficients[:a, b : 2 * b],
                coefficients[a : 2 * a, b : 2 * b],
            )
        )
    return parts

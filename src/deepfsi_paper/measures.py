"""Measures of sensing matrices (what light they use, how alike two are), and the noise axis.

Matrices are numpy arrays (m, N), one signed mask a row, as everywhere.
"""

import math
from typing import Literal

import numpy as np
import scipy.linalg
import scipy.special


def throughput(matrix: np.ndarray, mean_scene: np.ndarray) -> float:
    """Share of a scene's light that the detectors count, Σ_ij |M_ij| x̄_j / Σ_j x̄_j."""
    # M (m, N) are shares of each pixel's photons, in masks of which each pixel is on one rail (on
    # two arms it is on both), x̄ (N,) the mean reflectance of each pixel over the training scenes.
    # For a single detector it is at most 1
    masks = _masks(matrix)
    scene = np.asarray(mean_scene, dtype=np.float64)
    light = float(scene.sum())
    return float((np.abs(masks) @ scene).sum() / light)


def effective_directions(matrix: np.ndarray) -> float:
    """Effective rank of masks (m, N): the number of independent directions that they measure."""
    # It is exp(H), with H the Shannon entropy of the singular values divided by their sum: m for
    # orthogonal masks of equal norm, 1 for copies of one mask, in between where masks resemble each
    # other or some hardly measure, and 0 where every mask is dark. The singular values themselves,
    # not their squares, as in the published definition; and it is to them that the counts along a
    # direction are proportional. The masks' signs, order and common scale do not matter; their
    # scales relative to each other do
    strengths = scipy.linalg.svdvals(_masks(matrix))
    if not strengths.any():
        return 0.0
    shares = strengths / strengths.sum()
    return float(np.exp(scipy.special.entr(shares).sum()))


def matched_similarity(first: np.ndarray, second: np.ndarray) -> float:
    """Likeness of two sets of masks, mask by mask: mean |cosine| of the best pairing, 0 to 1."""
    # Each mask of the smaller set (m₁, N) gets one of the larger (m₂, N) for itself, so that the
    # sum of |cosine| is largest. Order, signs and the scale of each mask do not matter; mixing
    # masks does. Dark masks resemble nothing. Unrelated masks are above 0: of two single random
    # directions |cosine| is √(2/πN) on average for large N, and the choice of pairs adds to it
    from scipy.optimize import linear_sum_assignment

    a, b = _masks(first), _masks(second)
    cosines = np.abs(_units(a) @ _units(b).T)
    return float(cosines[linear_sum_assignment(cosines, maximize=True)].mean())


def _masks(matrix: np.ndarray) -> np.ndarray:
    masks = np.asarray(matrix)
    return masks if masks.dtype == np.float32 else masks.astype(np.float64)


def _units(masks: np.ndarray) -> np.ndarray:
    """Masks at unit norm, float64; dark ones stay dark."""
    norms = np.linalg.norm(masks.astype(np.float64), axis=1, keepdims=True)
    return masks / np.where(norms > 0, norms, 1.0)


def impulse_imaging_error(
    photons: float,
    mean_reflectance: float,
    pixels: int,
    noise: Literal["poisson", "gaussian"],
    sigma: float = 1.0,
) -> float:
    """Root mean square error of impulse imaging in reflectance, the paper's noise axis."""
    # With x̄ = s / N, each of N detectors counts λ = Φ x / s, and x̂ = s y / Φ. Hence the error is
    # x̄ √(N / Φ) under photon noise and σ x̄ N / Φ under gaussian noise
    if noise == "poisson":
        return mean_reflectance * math.sqrt(pixels / photons)
    return sigma * mean_reflectance * pixels / photons

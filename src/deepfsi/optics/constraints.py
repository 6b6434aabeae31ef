"""Light laws: what a set of masks may do with a pixel's photons, and what realises it.

    column       max_j Σ_i |M_ij| ≤ 1            optics that split each pixel's light (paper)
    equal-dwell  M⁺_ij, M⁻_ij ≤ 1/F              one DMD, one detector, equal times for F frames
    free-dwell   Σ_frames max_j(frame) ≤ 1       one DMD, one detector, each frame its own time
    two-arm      M⁺_ij + M⁻_ij = t_i, Σ t_i ≤ 1  one DMD, a detector on each arm

A law is one of frames: here the rails of masks are the tensor (..., 2, m, N) of M⁺ and M⁻ for
signed masks, or (..., 1, m, N) where there is one rail, `Rails.stacked`.
"""

import math

import numpy as np
import torch
from torch import Tensor

from deepfsi.base import InputError
from deepfsi.camera import LightLawName, RailsKind, check_light_law
from deepfsi.optics.rails import Rails

SLACK = 1e-5
"""Relative excess that float32 rounding may cause and `check` forgives."""

BRIGHTEST = 1e30
"""Entry beyond which sums of float32 may be infinite."""


def expand(matrix: Tensor, light: LightLawName, rails: RailsKind = "dual") -> Tensor:
    """Rails (..., 2 or 1, m, N) whose difference is a matrix (..., m, N)."""
    # A single rail is the matrix itself. Two are its positive and its negative part; on two arms
    # each mask is shown for the time t of its peak, and what one arm does not get, the other does:
    # M⁺ = (t + M) / 2 and M⁻ = (t − M) / 2. matrix (..., m, N)
    if rails == "single":
        return matrix.unsqueeze(-3)
    if light == "two-arm":
        return Rails(matrix, matrix.abs().amax(dim=-1, keepdim=True)).stacked
    return torch.stack([matrix.clamp(min=0), (-matrix).clamp(min=0)], dim=-3)


def frames(rails: Tensor) -> Tensor:
    """Frames of a design (F, N): every rail of every mask that is not dark, mask by mask."""
    every = rails.transpose(0, 1).flatten(0, 1)
    return every[every.amax(dim=-1) > 0]


def fit(matrix: Tensor, light: LightLawName, rails: RailsKind = "dual") -> Tensor:
    """Rails (2 or 1, m, N) of a matrix at a light law, using as much light as it allows."""
    # `column` and `free-dwell` take one common factor, `equal-dwell` each frame's own peak, and
    # `two-arm` each mask's own peak. matrix (m, N)
    check_light_law(light, rails)
    if light == "two-arm":
        return expand(matrix / (peak(matrix.abs()) * len(matrix)), light)
    parts = expand(matrix, light, rails)
    if light == "column":
        return parts / parts.sum(dim=(0, 1)).max()
    if light == "free-dwell":
        return parts / parts.amax(dim=-1).sum()
    return parts / (peak(parts) * len(frames(parts)))


def equalise(rails: Tensor) -> Tensor:
    """Rails (..., 2 or 1, m, N) of which every frame has the same dwell and peak."""
    return rails / (peak(rails) * rails.shape[-2] * rails.shape[-3])


def excess(rails: Tensor, light: LightLawName) -> float:
    """Relative excess of rails (2 or 1, m, N) over a constraint: 0 or less if they obey it."""
    if light == "column":
        return float(rails.sum(dim=(0, 1)).max()) - 1
    if light == "free-dwell":
        return float(rails.amax(dim=-1).sum()) - 1
    if light == "equal-dwell":
        return float(rails.max()) * max(len(frames(rails)), 1) - 1
    dwell = rails.sum(dim=0)
    return max(
        float(dwell.amax(dim=-1).sum()) - 1,
        float((dwell.amax(dim=-1) - dwell.amin(dim=-1)).max()) * len(dwell),
    )


def used(rails: Tensor, light: LightLawName) -> Tensor:
    """Share (..., m) of a constraint that the first k masks of rails use; 0 while they are dark."""
    # Shown alone for the whole exposure these k may be brighter by the inverse; shown at the
    # beginning of all, on one device, they have taken this share of its time
    if light == "column":
        return rails.sum(dim=-3).cumsum(dim=-2).amax(dim=-1)
    peaks = rails.amax(dim=-1)
    if light == "free-dwell":
        return peaks.sum(dim=-2).cumsum(dim=-1)
    if light == "two-arm":
        return rails.sum(dim=-3).amax(dim=-1).cumsum(dim=-1)
    shown = (peaks > 0).sum(dim=-2).cumsum(dim=-1)
    return shown / shown[..., -1:].clamp(min=1)


def check(rails: Tensor, light: LightLawName) -> Tensor:
    """Return rails, or raise `InputError` if not finite, negative or beyond their constraint."""
    if not bool(torch.isfinite(rails).all()):
        raise InputError("the matrix holds NaN or infinity: give finite numbers")
    if float(rails.min()) < 0:
        raise InputError(
            "the matrix has negative entries: use {rails:dual}, or give frames of 0 or more",
            setting="rails",
        )
    if float(rails.max()) > BRIGHTEST:
        raise InputError(
            f"the matrix has entries above {BRIGHTEST:g}: give shares of each pixel's photons"
        )
    factor = 1 + excess(rails, light)
    if factor > 1 + SLACK:
        raise InputError(
            "the matrix is {factor:.4g} times as bright as {given} allows, and breaks the {given} "
            "constraint: divide it by {above:.4g}, or choose another with {light}",
            setting="light",
            factor=factor,
            given=light,
            above=_above(factor),
        )
    return rails


def own_rails(matrix: np.ndarray, light: LightLawName, rails: RailsKind) -> Tensor:
    """Rails (2 or 1, m, N) of a user's matrix (m, N); `InputError` if it breaks the light law."""
    signed = torch.from_numpy(np.asarray(matrix, dtype=np.float32))
    return check(expand(signed, light, rails), light)


def _above(factor: float) -> float:
    """Least number of four digits that is at least the factor."""
    step = 10.0 ** (math.floor(math.log10(factor)) - 3)
    return math.ceil(factor / step) * step


def peak(parts: Tensor) -> Tensor:
    """Largest entry of each frame (..., m, 1), 1 where it is dark."""
    return _or_one(parts.amax(dim=-1, keepdim=True))


def _or_one(divisor: Tensor) -> Tensor:
    return torch.where(divisor > 0, divisor, 1.0)

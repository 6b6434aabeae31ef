"""Light budgets: from a number of photons to photons per pixel.

The budget Φ is the number of photons that are expected to reach the coding device while masks are
shown, averaged over the training set. Illumination is fixed, so a brighter scene sends more:

    λ = Φ x / s,    s = mean over training scenes of Σ_j x_j

with x the reflectance in [0, 1] and λ the expected photons of each pixel.
"""

import math
from typing import TYPE_CHECKING, TypeVar

from deepfsi.errors import InputError

if TYPE_CHECKING:
    import numpy as np

Array = TypeVar("Array")
"""A numpy array or a tensor."""


BUDGETS = (1e-12, 1e15)
"""Smallest and largest photon budget; beyond the second float32 would overflow in squares."""


def check_budget(photons: float) -> float:
    """Return a photon budget as a float; `InputError` unless it is within `BUDGETS`."""
    try:
        budget = float(photons)
    except (TypeError, ValueError, OverflowError):
        budget = math.nan
    if not BUDGETS[0] <= budget <= BUDGETS[1]:
        raise InputError(
            f"photon budget {photons!r} is not allowed: give a number from {BUDGETS[0]:g} to "
            f"{BUDGETS[1]:g}, such as 1e4"
        )
    return budget


def check_one_budget(photons: float | None, counts: float | None) -> float:
    """Return what is given of a budget of photons and one of counts, or raise `InputError`."""
    if photons is not None and counts is None:
        return check_budget(photons)
    if counts is None or photons is not None:
        raise InputError(
            "the light of a design is told once: give `photons`, the budget on the device, or "
            "`counts`, the photons that its detectors are to count, or a camera with its flux"
        )
    if not BUDGETS[0] <= counts <= BUDGETS[1]:
        raise InputError(
            f"{counts!r} counts are not allowed: give a number from {BUDGETS[0]:g} to "
            f"{BUDGETS[1]:g}, such as 30"
        )
    return float(counts)


def summed_reflectance(x: "np.ndarray") -> float:
    """Mean over scenes (n, N) of their summed reflectance, s, in fully reflecting pixels."""
    return float(x.sum(axis=1, dtype="float64").mean())


def brightness(x: "np.ndarray", labels: "np.ndarray") -> dict[str, float] | None:
    """By how much scenes (n, N) of some classes differ in summed reflectance."""
    import numpy as np

    sums = x.sum(axis=1, dtype=np.float64)
    groups = [sums[labels == label] for label in np.unique(labels)]
    means = np.array([group.mean() for group in groups])
    if not means.min() > 0:
        return None
    return {
        "low": float(sums.min() / sums.mean()),
        "high": float(sums.max() / sums.mean()),
        "between": float(means.max() / means.min()),
        "within": max(float(g.std() / mean) for g, mean in zip(groups, means, strict=True)),
    }


def photons_per_pixel(x: Array, photons: float, summed_reflectance: float) -> Array:
    """Expected photons per pixel, λ = Φ x / s.

    Parameters
    ----------
    x : array or tensor, shape (..., N)
        Reflectance.
    photons : float
        Budget Φ, expected photons on the coding device.
    summed_reflectance : float
        s of the training set, from `summed_reflectance`.

    Examples
    --------
    >>> import deepfsi, numpy
    >>> deepfsi.photons_per_pixel(numpy.array([0.2, 0.6]), 1e2, 0.8)
    array([25., 75.])
    """
    if not summed_reflectance > 0:
        raise InputError(
            f"summed reflectance {summed_reflectance!r} is not allowed: give a number above 0, "
            "such as `Design.summed_reflectance`"
        )
    return x * (check_budget(photons) / summed_reflectance)  # type: ignore[operator, return-value]

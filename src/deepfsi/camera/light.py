"""Light budgets: from a number of photons to photons per pixel.

The budget Φ is the number of photons that are expected to reach the coding device while masks are
shown, averaged over the training set. Illumination is fixed, so a brighter scene sends more:

    λ = Φ x / s,    s = mean over training scenes of Σ_j x_j

with x the reflectance in [0, 1] and λ the expected photons of each pixel.
"""

import math
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import Field

from deepfsi.base.errors import InputError

Array = TypeVar("Array")
"""A numpy array or a tensor."""


BUDGETS = (1e-12, 1e15)
"""Smallest and largest photon budget; beyond the second float32 would overflow in squares."""

PhotonBudget = Annotated[float, Field(ge=BUDGETS[0], le=BUDGETS[1])]
"""Φ, photons that are expected on the coding device."""

TOO_DIM = 10.0
"""Lowest budget of a training over that below which a design has too little light."""


def check_budget(photons: Any, name: str = "photon budget") -> float:
    """Return a photon budget as a float; `InputError` unless it is within `BUDGETS`."""
    try:
        number = math.nan if isinstance(photons, bool) else float(photons)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not BUDGETS[0] <= number <= BUDGETS[1]:
        raise InputError(
            f"{name} {photons!r} is not allowed: give a number from {BUDGETS[0]:g} to "
            f"{BUDGETS[1]:g}, such as 1e4"
        )
    return number


def summed_reflectance(x: np.ndarray) -> float:
    """Mean over scenes (n, N) of their summed reflectance, s, in fully reflecting pixels."""
    return float(x.sum(axis=1, dtype="float64").mean())


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
    return x * (check_budget(photons) / summed_reflectance)  # type: ignore[operator, return-value]

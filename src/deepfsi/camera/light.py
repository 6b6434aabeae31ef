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
from deepfsi.base.keywords import plain_keywords

Array = TypeVar("Array")
"""A numpy array or a tensor."""


BUDGETS = (1e-12, 1e15)
"""Smallest and largest photon budget; beyond the second float32 would overflow in squares."""

PhotonBudget = Annotated[float, Field(ge=BUDGETS[0], le=BUDGETS[1])]
"""Φ, photons that are expected on the coding device."""

TOO_DIM = 10.0
"""Lowest budget of a training over that below which a design has too little light."""


def check_budget(photons: Any) -> float:
    """Return a photon budget as a float; `InputError` unless it is within `BUDGETS`."""
    if isinstance(photons, tuple | list):
        raise InputError(
            f"photon budget {photons!r} is no number: give the lowest of a range, with "
            "`exposure=Range(span=...)`, its highest divided by its lowest"
        )
    return _checked(photons, f"photon budget {photons!r} is", "1e4")


def _checked(value: Any, what: str, example: str) -> float:
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not BUDGETS[0] <= number <= BUDGETS[1]:
        raise InputError(
            f"{what} not allowed: give a number from {BUDGETS[0]:g} to {BUDGETS[1]:g}, such as "
            f"{example}"
        )
    return number


def check_one_budget(photons: float | None, counts: float | None) -> float:
    """Return the budget, told as photons or as counts."""
    if photons is not None and counts is None:
        return check_budget(photons)
    if counts is None or photons is not None:
        raise InputError(
            "the light of a design is told once: give {photons}, the budget on the device, or "
            "{counts}, the photons that its detectors are to count, or a camera with its flux",
            setting=("photons", "counts"),
        )
    return _checked(counts, f"{counts!r} counts are", "30")


def summed_reflectance(x: np.ndarray) -> float:
    """Mean over scenes (n, N) of their summed reflectance, s, in fully reflecting pixels."""
    return float(x.sum(axis=1, dtype="float64").mean())


@plain_keywords()
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


Shares = TypeVar("Shares", bound=Any)
"""Array of NumPy or tensor of torch."""

ROUNDING = 1e-6
"""Share by which a dwell may fall short of the shortest one, which is rounding."""


def share_out(dwell: Shares, shortest: float | Shares) -> Shares:
    """Leave out the frames that are too short, and give their time to those that are shown.

    The shortest frames are left out one after another, until the time of a look, shared out among
    the others in proportion to their dwells, leaves none of them below the shortest dwell. So as
    many frames are shown as can be, and the longest one always is.

    Parameters
    ----------
    dwell : array or tensor, shape (..., q)
        Share of the exposure of each frame. It can be differentiated: the choice of the frames is
        fixed, their times are not.
    shortest : float, or array or tensor, shape (..., 1)
        Shortest dwell of a frame that is shown, a share of the exposure.

    Returns
    -------
    array or tensor, shape (..., q)
        Dwells of the same sum, 0 of the frames that are left out.
    """
    order, longest_first = _longest_first(dwell)
    total = dwell.sum(-1)[..., None]
    enough = longest_first * total >= shortest * (1 - ROUNDING) * longest_first.cumsum(-1)
    count = enough.sum(-1)[..., None].clip(min=1)
    shown = dwell * (order.argsort() < count)
    return shown * (total / shown.sum(-1)[..., None])


def _longest_first(dwell: Any) -> tuple[Any, Any]:
    """Indices of dwells from the longest to the shortest, and the dwells in this order."""
    if isinstance(dwell, np.ndarray):
        order = np.argsort(-dwell, axis=-1, kind="stable")
        return order, dwell[order] if dwell.ndim == 1 else np.take_along_axis(dwell, order, -1)
    order = dwell.argsort(dim=-1, descending=True, stable=True)
    return order, dwell.gather(-1, order)

"""Dwells that a device can show: no frame is shorter than its shortest one."""

from typing import Any, TypeVar

import numpy as np

Shares = TypeVar("Shares", bound=Any)
"""Array of NumPy or tensor of torch."""

ROUNDING = 1e-6
"""Share by which a dwell may fall short of the shortest one, which is rounding."""


def share_out(dwell: Shares, shortest: float | Shares) -> Shares:
    """Leave out the frames that are too short, and give their time to those that are shown."""
    # The shortest frames are left out one after another, until the time of a look, shared out among
    # the others in proportion to their dwells, leaves none of them below the shortest dwell. So as
    # many frames are shown as can be, and the longest one always is. What is left can be
    # differentiated: the choice of the frames is fixed, their times are not. dwell (..., q);
    # shortest, or (..., 1)
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

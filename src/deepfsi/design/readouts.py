"""Counts of a camera as tensors, refused with one line where they do not fit a design."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepfsi.errors import InputError

LONGEST_LOOK = 1.05
"""Longest time of a look over that asked for: frames last whole microseconds."""


def as_readouts(
    counts: Any, photons: Any, dwell: Any, wanted: tuple[int, ...]
) -> tuple[Tensor, Tensor, Tensor | None]:
    """Counts, budgets and dwells of one or many exposures, checked.

    Parameters
    ----------
    counts : array, shape (..., *wanted)
    photons : float or array, shape (...)
    dwell : array of the shape of `counts`, optional
    wanted : tuple of int
        Shape of one exposure: (2, m) or (m,).

    Returns
    -------
    counts : tensor, shape (..., *wanted)
    photons : tensor, shape (..., 1)
    dwell : tensor of the shape of `counts`, optional

    Raises
    ------
    InputError
        If shapes do not match, counts are not finite or a budget is not above 0.
    """
    try:
        read = torch.from_numpy(np.asarray(counts, dtype=np.float32).copy())
        budget = torch.from_numpy(np.asarray(photons, dtype=np.float32).copy())
        shown = (
            None if dwell is None else torch.from_numpy(np.asarray(dwell, dtype=np.float32).copy())
        )
    except (TypeError, ValueError):
        raise InputError("counts, photons and dwell must be arrays of numbers") from None
    if tuple(read.shape[-len(wanted) :]) != wanted:
        raise InputError(
            f"counts of shape {tuple(read.shape)} do not fit this design: give (..., "
            f"{', '.join(map(str, wanted))})"
        )
    if not bool(torch.isfinite(read).all()):
        raise InputError("counts hold NaN or infinity: give finite counts")
    if shown is not None and (
        shown.shape != read.shape or not bool((torch.isfinite(shown) & (shown >= 0)).all())
    ):
        raise InputError(
            f"dwells of shape {tuple(shown.shape)} do not fit counts of shape "
            f"{tuple(read.shape)}: give a share of 0 or more for each count"
        )
    if not bool((torch.isfinite(budget) & (budget > 0)).all()):
        raise InputError("photons must be a finite number above 0 for every exposure")
    try:
        budget = budget.expand(read.shape[: -len(wanted)]).unsqueeze(-1)
    except RuntimeError:
        raise InputError(
            f"photons of shape {tuple(budget.shape)} do not fit counts of shape "
            f"{tuple(read.shape)}: give one number, or one for each exposure"
        ) from None
    return read, budget, shown


class LiveReadouts:
    """Readouts of a camera that shows the dwells it is asked for, look by look.

    Parameters
    ----------
    read : callable
        As for `Design.classify_live`.
    photons : float
        Budget Φ.
    masks : int
        m.
    """

    def __init__(self, read: Callable[[np.ndarray], Any], photons: float, masks: int) -> None:
        self.read, self.photons = read, photons
        self.counted = np.zeros(masks)

    def show(self, dwell: Tensor) -> tuple[Tensor, Tensor]:
        """Counts (m,) of a look over the budget, and the dwells (m,) shown.

        Raises
        ------
        InputError
            If they do not fit the masks, or the look took longer than was asked for.
        """
        asked = dwell.cpu().numpy()
        seen = self.read(asked.copy())
        pair = seen if isinstance(seen, tuple) else (seen, asked)
        try:
            counts, shown = (np.asarray(part, dtype=float) for part in pair)
        except (TypeError, ValueError):
            counts, shown = np.empty(0), asked
        if not counts.shape == shown.shape == asked.shape:
            raise InputError(
                f"a look does not fit this design: return {asked.shape} counts, or a pair of "
                "counts and shares shown"
            )
        if not np.isfinite(counts).all():
            raise InputError("a look holds NaN or infinity: return finite counts")
        if not 0 <= shown.sum() <= asked.sum() * LONGEST_LOOK:
            raise InputError(
                f"a look that took {shown.sum():.4g} of the exposure was to take "
                f"{asked.sum():.4g}: show each mask for at most the shares asked"
            )
        self.counted = self.counted + counts
        return torch.from_numpy(counts / self.photons).to(dwell), torch.from_numpy(shown).to(dwell)

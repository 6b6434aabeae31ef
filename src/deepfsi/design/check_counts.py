"""Checks of counts and budgets as users give them."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepfsi.base.errors import InputError

PatternShapes = tuple[tuple[int, ...], tuple[int, ...]]
"""Shapes of rails (rails, m, N), and of the cells of a pattern."""


def check_readouts(
    counts: Any,
    photons: Any,
    wanted: tuple[int, ...],
    parts: tuple[int, ...] = (),
) -> tuple[Tensor, Tensor]:
    """Counts (..., *parts, *wanted) and budgets (..., 1), checked."""

    def tensor(values: Any) -> Tensor:
        return torch.from_numpy(np.asarray(values, dtype=np.float32).copy())

    try:
        read = tensor(counts)
        budget = tensor(photons)
    except (TypeError, ValueError):
        raise InputError("counts and photons must be arrays of numbers") from None
    shape = (*parts, *wanted)
    if tuple(read.shape[-len(shape) :]) != shape:
        raise InputError(
            f"counts of shape {tuple(read.shape)} do not fit this design: give (..., "
            f"{', '.join(map(str, shape))})"
        )
    if not bool(torch.isfinite(read).all()):
        raise InputError("counts hold NaN or infinity: give finite counts")
    if not bool((torch.isfinite(budget) & (budget > 0)).all()):
        raise InputError("photons must be a finite number above 0 for every exposure")
    try:
        budget = budget.expand(read.shape[: -len(wanted)]).unsqueeze(-1)
    except RuntimeError:
        raise InputError(
            f"photons of shape {tuple(budget.shape)} do not fit counts of shape "
            f"{tuple(read.shape)}: give one number, or one for each exposure"
        ) from None
    return read, budget


def check_click_counts(read: Tensor, gates: int | None) -> None:
    """Raise `InputError` where a readout has more counts than its detector can click."""
    if gates is not None and bool((read > gates).any() | (read < 0).any()):
        raise InputError(
            f"this design reads detectors that click at most {gates} times in a frame, and a "
            f"readout has {float(read.max()):g} counts: give clicks from 0 to {gates}"
        )


def check_dimmed(dimmed: float, gates: int | None) -> None:
    """Raise `InputError` where clicks are of patterns that pass less light than their design."""
    if gates is not None and dimmed != 1:
        raise InputError(
            f"the patterns pass {dimmed:.3g} of the design's light, and clicks are not in "
            "proportion to it: learn a design under a light law of the device"
        )


def check_realised(given: PatternShapes, own: PatternShapes) -> None:
    """Raise `InputError` where patterns of a device are not of a design's own shape."""
    if given != own:
        (rails, masks, _), cells = given
        (own_rails, own_masks, _), own_cells = own
        raise InputError(
            f"patterns of {masks} masks of {cells} cells and {rails} rails are not of this design, "
            f"with {own_masks} masks of {own_cells} and {own_rails} rails: export it with "
            "`deepfsi dmd`"
        )

"""Checks of counts, budgets and dwells as users give them."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepfsi.base.errors import InputError

PatternShapes = tuple[tuple[int, ...], tuple[int, ...]]
"""Shapes of rails (rails, m, N), and of the cells of a pattern."""

LONGEST_LOOK = 1.05
"""Longest time of a look over that asked for: frames last whole microseconds."""


def check_readouts(
    counts: Any,
    photons: Any,
    dwell: Any,
    wanted: tuple[int, ...],
    frames: tuple[int, ...] | None = None,
    parts: tuple[int, ...] = (),
) -> tuple[Tensor, Tensor, Tensor | None]:
    """Counts (..., *parts, *wanted), budgets (..., 1) and dwells as counts, checked."""

    def tensor(values: Any) -> Tensor:
        return torch.from_numpy(np.asarray(values, dtype=np.float32).copy())

    try:
        read = tensor(counts)
        budget = tensor(photons)
        shown = None if dwell is None else tensor(dwell)
    except (TypeError, ValueError):
        raise InputError("counts, photons and dwell must be arrays of numbers") from None
    shape = (*parts, *wanted)
    if tuple(read.shape[-len(shape) :]) != shape:
        raise InputError(
            f"counts of shape {tuple(read.shape)} do not fit this design: give (..., "
            f"{', '.join(map(str, shape))})"
        )
    if not bool(torch.isfinite(read).all()):
        raise InputError("counts hold NaN or infinity: give finite counts")
    if shown is not None and (
        tuple(shown.shape) != (*read.shape[: -len(wanted)], *(frames or ()))
        or not bool((torch.isfinite(shown) & (shown >= 0)).all())
    ):
        raise InputError(
            f"dwells of shape {tuple(shown.shape)} do not fit counts of shape "
            f"{tuple(read.shape)}: give a share of 0 or more for each frame"
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


def check_look(
    read: Callable[[np.ndarray], Any], asked: np.ndarray, wanted: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Counts of one look of a camera and the dwells shown, checked."""
    seen = read(asked.copy())
    pair = seen if isinstance(seen, tuple) else (seen, asked)
    try:
        counts, shown = (np.asarray(part, dtype=float) for part in pair)
    except (TypeError, ValueError):
        counts = np.empty(0)
        shown = asked
    if (counts.shape, shown.shape) != (wanted, asked.shape):
        raise InputError(
            f"a look does not fit this design: return {wanted} counts, or a pair of counts and "
            f"{asked.shape} shares shown"
        )
    if not np.isfinite(counts).all():
        raise InputError("a look holds NaN or infinity: return finite counts")
    if not 0 <= shown.sum() <= asked.sum() * LONGEST_LOOK:
        raise InputError(
            f"a look that took {shown.sum():.4g} of the exposure was to take "
            f"{asked.sum():.4g}: show each mask for at most the shares asked"
        )
    return counts, shown


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

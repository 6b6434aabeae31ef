"""Masks rounded to the grey levels of a device."""

import torch
from torch import Tensor

from deepfsi.base import InputError
from deepfsi.camera import LightLawName
from deepfsi.optics.constraints import peak


def check_levels(levels: int) -> None:
    """Raise `InputError` unless masks can have so many grey levels."""
    if levels < 2:
        raise InputError(f"{levels} grey levels are not allowed: give at least 2, dark included")


def quantise(rails: Tensor, light: LightLawName, levels: int) -> Tensor:
    """Rails as a device shows them: each frame in `levels` grey levels from dark to its own peak.

    Where rounding breaks `column`, all frames are dimmed by the common factor that mends it. On two
    arms the positive rail is the pattern, and the other gets what is left of the time.

    Shapes: rails (..., 2 or 1, m, N).
    """
    check_levels(levels)
    steps = levels - 1
    if light == "two-arm":
        total = rails.sum(dim=-3)
        time = total.amax(dim=-1, keepdim=True)
        plus = (rails[..., 0, :, :] / peak(total) * steps).round() / steps * time
        return torch.stack([plus, time - plus], dim=-3)
    step = peak(rails) / steps
    shown = (rails / step).round() * step
    if light != "column":
        return shown
    return shown / shown.sum(dim=(-3, -2), keepdim=True).amax(dim=-1, keepdim=True).clamp(min=1)

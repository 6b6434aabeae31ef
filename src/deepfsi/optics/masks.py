"""Masks as modules: fixed ones, and learned ones that cannot break their light law."""

from typing import Any

import torch
from torch import Tensor, nn

from deepfsi.base import InputError
from deepfsi.camera import LightLawName, RailsKind, check_light_law, share_out
from deepfsi.optics.constraints import peak
from deepfsi.optics.grey_levels import quantise
from deepfsi.optics.rails import Rails


class FixedMasks(nn.Module):
    """Masks that do not learn; `forward` gives their rails."""

    difference: Tensor
    total: Tensor | None

    def __init__(self, rails: Tensor) -> None:
        super().__init__()
        _check_tensor(rails, "rails", 3, "(2 or 1, masks, pixels)")
        given = Rails.of(rails)
        self.register_buffer("difference", given.difference)
        self.register_buffer("total", given.total if given.count == 2 else None)

    def forward(self) -> Rails:
        """Rails of the masks, (..., m, N)."""
        return Rails(self.difference, self.total)


class LearnedMasks(nn.Module):
    """Masks as a differentiable function of free weights that cannot break their constraint.

    `column` divides each pixel's column by its sum where that exceeds 1. The others write a frame
    as its dwell (a share of the time) times a pattern in [0, 1]: dwells are equal or, for
    `free-dwell` and `two-arm`, a softmax. Weights are in units of the start's own rms, so that one
    learning rate serves any number of masks.

    Quantised masks have the gradient of the continuous ones that they are rounded from: it goes
    straight through the rounding, whose own is 0. So do dwells, so that a dark frame may come back.

    Shapes: start (..., m, N).
    """

    unit: Tensor

    def __init__(
        self,
        start: Tensor,
        light: LightLawName,
        rails: RailsKind = "dual",
        levels: int = 0,
        shortest: float = 0.0,
    ) -> None:
        super().__init__()
        check_light_law(light, rails)
        _check_tensor(start, "a start", 2, "(masks, pixels)")
        if rails == "single" and bool((start < 0).any()):
            raise InputError("a start of a single rail has negative entries: give 0 or more")
        self.light, self.rails, self.levels, self.shortest = light, rails, levels, shortest
        *replicas, masks, _ = start.shape
        if light == "column":
            most = start.abs().sum(dim=-2, keepdim=True).amax(dim=-1, keepdim=True)
            if not bool(most.all()):
                raise InputError("a start is 0 everywhere: give masks that pass light")
            fitted = start / most
            unit = fitted.square().mean(dim=(-2, -1), keepdim=True).sqrt()
            self.weight = nn.Parameter(fitted / unit)
            self.register_buffer("unit", unit)
            return
        pattern = 0.9 * start / peak(start.abs())
        self.weight = nn.Parameter(
            torch.atanh(pattern) if rails == "dual" else torch.logit(pattern.clamp(min=0.05))
        )
        if light != "equal-dwell":
            per_mask = 2 if (light, rails) == ("free-dwell", "dual") else 1
            self.dwell = nn.Parameter(start.new_zeros(*replicas, per_mask, masks))

    def forward(self) -> Rails:
        """Rails of the masks, (..., m, N)."""
        matrix = self.matrix()
        if self.rails == "single":
            return self._shown(Rails(matrix))
        if self.light == "two-arm":
            return self._shown(Rails(matrix, self._dwell()[..., 0, :, None].expand_as(matrix)))
        return self._shown(Rails(matrix, matrix.abs()))

    def dim(self, factor: Tensor) -> None:
        """Pass a factor (R,) of the light, up to 1."""
        with torch.no_grad():
            each = factor[:, None, None]
            if self.light == "column":
                self.unit *= each
            elif self.rails == "single":
                self.weight.copy_(torch.logit(torch.sigmoid(self.weight) * each, eps=1e-6))
            else:
                self.weight.copy_(torch.atanh(torch.tanh(self.weight) * each))

    @property
    def disjoint(self) -> bool:
        """True if the total is |M|, and its gradient that of |M|."""
        # So it is where there are two rails of which each pixel is on one, and no rounding
        return self.rails == "dual" and self.light != "two-arm" and not self.levels

    def matrix(self) -> Tensor:
        """Difference M⁺ − M⁻ before it is quantised, (..., m, N)."""
        if self.light == "column":
            sums = self.weight.abs().sum(dim=-2, keepdim=True)
            matrix = self.weight * (self.unit / (sums * self.unit).clamp(min=1))
            return matrix if self.rails == "dual" else matrix.abs()
        if self.rails == "single":
            pattern = torch.sigmoid(self.weight)
            return pattern * self._dwell(pattern)[..., 0, :, None]
        pattern = torch.tanh(self.weight)
        if self.light != "free-dwell":
            return pattern * self._dwell()[..., 0, :, None]
        plus, minus = self._dwell(pattern).unbind(dim=-2)
        return pattern * torch.where(pattern > 0, plus.unsqueeze(-1), minus.unsqueeze(-1))

    def _shown(self, rails: Rails) -> Rails:
        if not self.levels:
            return rails
        with torch.no_grad():
            shown = Rails.of(quantise(rails.stacked, self.light, self.levels))
        return rails.each(through, shown)

    def _dwell(self, pattern: Tensor | None = None) -> Tensor:
        """Dwells (..., 1 or 2, m); a frame is read for its peak's share of its dwell."""
        if self.light == "equal-dwell":
            masks = self.weight.shape[-2]
            count = 2 * masks if self.rails == "dual" else masks
            return self.weight.new_full((1, masks), 1 / count)
        dwell = self.dwell.flatten(-2).softmax(dim=-1)
        if not self.shortest:
            return dwell.view_as(self.dwell)
        with torch.no_grad():
            peaks = torch.ones_like(dwell)
            if pattern is not None:
                ends = [pattern.amax(dim=-1), -pattern.amin(dim=-1)][: self.dwell.shape[-2]]
                peaks = torch.cat(ends, dim=-1).clamp(min=0)
            shown = share_out(dwell * peaks, self.shortest) / torch.where(peaks > 0, peaks, 1.0)
        return through(dwell, shown).view_as(self.dwell)


def _check_tensor(given: Any, what: str, axes: int, shape: str) -> None:
    """Raise `InputError` unless a tensor of real numbers has so many axes or more."""
    if not isinstance(given, Tensor) or not given.is_floating_point() or given.ndim < axes:
        found = tuple(given.shape) if isinstance(given, Tensor) else type(given).__name__
        kind = f" and type {given.dtype}" if isinstance(given, Tensor) else ""
        raise InputError(
            f"{what} of {'shape ' * bool(kind)}{found}{kind} cannot be used: give a tensor of real "
            f"numbers {shape}"
        )


def through(continuous: Tensor, shown: Tensor) -> Tensor:
    """Second tensor, exactly, with the gradient of the first (straight through)."""
    return _Through.apply(continuous, shown)  # type: ignore[no-untyped-call]


class _Through(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, continuous: Tensor, shown: Tensor) -> Tensor:
        return shown

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        return gradient, None

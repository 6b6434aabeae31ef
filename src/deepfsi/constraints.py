"""Light constraints: what a set of masks may do with a pixel's photons, and what realises it.

    column       max_j Σ_i |M_ij| ≤ 1            optics that split each pixel's light (paper)
    equal-dwell  M⁺_ij, M⁻_ij ≤ 1/F              one DMD, one detector, equal times for F frames
    free-dwell   Σ_frames max_j(frame) ≤ 1       one DMD, one detector, each frame its own time
    two-arm      M⁺_ij + M⁻_ij = t_i, Σ t_i ≤ 1  one DMD, a detector on each arm

A set of masks is its *rails*: an array (..., 2, m, N) of M⁺ and M⁻ for signed masks, or
(..., 1, m, N) where there is one rail. The physics needs two combinations of them, the difference
M⁺ − M⁻ (which gives the mean of a feature) and the total M⁺ + M⁻ (which gives its photon noise).
"""

from typing import Any, Literal, get_args

import torch
from torch import Tensor, nn

from deepfsi.errors import InputError, closest

Light = Literal["column", "equal-dwell", "free-dwell", "two-arm"]
Rails = Literal["dual", "single"]

SLACK = 1e-5
"""Relative excess that float32 rounding may cause and `check` forgives."""


def check_light(light: str, rails: str) -> None:
    """Raise `InputError` unless the constraint exists and can be had with these rails."""
    if light not in get_args(Light):
        raise InputError(f"unknown light constraint {light!r}: {closest(light, get_args(Light))}")
    if rails not in get_args(Rails):
        raise InputError(f"unknown rails {rails!r}: {closest(rails, get_args(Rails))}")
    if light == "two-arm" and rails == "single":
        raise InputError(
            "two-arm with a single rail is not allowed: each arm is a rail; use dual rails, and "
            "not raster or s-matrix, which have one"
        )


def split(matrix: Tensor) -> Tensor:
    """Rails (..., 2, m, N) of a signed matrix (..., m, N): its positive and its negative part."""
    return torch.stack([matrix.clamp(min=0), (-matrix).clamp(min=0)], dim=-3)


def frames(rails: Tensor) -> Tensor:
    """Frames of a design (F, N): every rail of every mask that is not dark, mask by mask."""
    every = rails.transpose(0, 1).flatten(0, 1)
    return every[every.amax(dim=-1) > 0]


def arms(matrix: Tensor) -> Tensor:
    """Rails of a signed matrix shown on a two-arm camera, each mask for the time t_i of its peak.

    What one arm does not get, the other does: M⁺ = (t + M) / 2 and M⁻ = (t − M) / 2.
    """
    time = matrix.abs().amax(dim=-1, keepdim=True)
    return torch.stack([time + matrix, time - matrix], dim=-3) / 2


def fit(matrix: Tensor, light: Light, rails: Rails = "dual") -> Tensor:
    """Bring a matrix to a light constraint, using as much light as it allows.

    `column` and `free-dwell` take one common factor, `equal-dwell` each frame's own peak, and
    `two-arm` each mask's own peak.

    Parameters
    ----------
    matrix : tensor, shape (m, N)
        Any scale; non-negative if `rails` is "single".

    Returns
    -------
    tensor, shape (2 or 1, m, N)
        Rails that obey the constraint.
    """
    check_light(light, rails)
    if light == "two-arm":
        return arms(matrix / (_peak(matrix.abs()) * len(matrix)))
    parts = split(matrix) if rails == "dual" else matrix.unsqueeze(0)
    if light == "column":
        return parts / parts.sum(dim=(0, 1)).max()
    if light == "free-dwell":
        return parts / parts.amax(dim=-1).sum()
    return parts / (_peak(parts) * len(frames(parts)))


def equalise(rails: Tensor) -> Tensor:
    """Frames (..., m, N) of one rail with every mask at equal dwell: its peak at 1 / m."""
    return rails / (_peak(rails) * rails.shape[-2])


def quantise(rails: Tensor, light: Light, steps: int) -> Tensor:
    """Rails as a device shows them: each frame in steps of its own peak / `steps`.

    Where rounding breaks `column`, all frames are dimmed by the common factor that mends it. On two
    arms the positive rail is the pattern, and the other gets what is left of the time.

    Parameters
    ----------
    rails : tensor, shape (..., 2 or 1, m, N)
        Leading axes are replicas, each by itself.
    light : {"column", "equal-dwell", "free-dwell", "two-arm"}
    steps : int
        From dark to the peak, at least 1: one less than the grey levels, of which dark is one.

    Returns
    -------
    tensor
        Of the shape of `rails`.
    """
    if steps < 1:
        raise InputError(f"{steps} steps from dark to the peak are not allowed: give at least 1")
    if light == "two-arm":
        time = rails.sum(dim=-3).amax(dim=-1, keepdim=True)
        plus = (rails[..., 0, :, :] / _or_one(time) * steps).round() / steps * time
        return torch.stack([plus, time - plus], dim=-3)
    step = _peak(rails) / steps
    shown = (rails / step).round() * step
    if light != "column":
        return shown
    return shown / shown.sum(dim=(-3, -2), keepdim=True).amax(dim=-1, keepdim=True).clamp(min=1)


def excess(rails: Tensor, light: Light) -> float:
    """How far rails (2 or 1, m, N) break a constraint: 0 or less if they obey it."""
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


def used(rails: Tensor, light: Light) -> Tensor:
    """How much of a constraint the first masks use: by the first k of them, for every k.

    Shown alone for the whole exposure these k may be brighter by the inverse; shown at the
    beginning of all, on one device, they have taken this share of its time.

    Parameters
    ----------
    rails : tensor, shape (..., 2 or 1, m, N)
    light : {"column", "equal-dwell", "free-dwell", "two-arm"}

    Returns
    -------
    tensor, shape (..., m)
        Rising, at most 1; 0 while masks are dark.
    """
    if light == "column":
        return rails.sum(dim=-3).cumsum(dim=-2).amax(dim=-1)
    peaks = rails.amax(dim=-1)
    if light == "free-dwell":
        return peaks.sum(dim=-2).cumsum(dim=-1)
    if light == "two-arm":
        return rails.sum(dim=-3).amax(dim=-1).cumsum(dim=-1)
    shown = (peaks > 0).sum(dim=-2).cumsum(dim=-1)
    return shown / shown[..., -1:].clamp(min=1)


def check(rails: Tensor, light: Light) -> Tensor:
    """Return rails, or raise `InputError` if not finite, negative or beyond their constraint."""
    if not bool(torch.isfinite(rails).all()):
        raise InputError("the matrix holds NaN or infinity: give finite numbers")
    if float(rails.min()) < 0:
        raise InputError("the matrix has negative entries: use --rails dual, or give frames ≥ 0")
    over = excess(rails, light)
    if over > SLACK:
        raise InputError(
            f"the matrix breaks the {light} constraint by {over:.3g} of its limit: scale it down, "
            "or choose another constraint with --light"
        )
    return rails


class Fixed(nn.Module):
    """Masks that do not learn; `forward` gives difference and total, each (..., m, N)."""

    difference: Tensor
    total: Tensor | None

    def __init__(self, rails: Tensor) -> None:
        super().__init__()
        difference, total = combine(rails)
        self.register_buffer("difference", difference)
        self.register_buffer("total", None if total is difference else total)

    def forward(self) -> tuple[Tensor, Tensor]:
        """Difference M⁺ − M⁻ and total M⁺ + M⁻, one and the same tensor for a single rail."""
        return self.difference, self.difference if self.total is None else self.total


class Learned(nn.Module):
    """Masks as a differentiable function of free weights that cannot break their constraint.

    Parameters
    ----------
    start : tensor, shape (..., m, N)
        Matrix to start from, any scale; leading axes are replicas that learn side by side. For a
        single rail it must be non-negative.
    light : {"column", "equal-dwell", "free-dwell", "two-arm"}
    rails : {"dual", "single"}
    steps : int
        Of `quantise`, for masks as a device with grey levels shows them; 0 for continuous ones.

    Notes
    -----
    `column` divides each pixel's column by its sum where that exceeds 1. The others write a frame
    as its dwell (a share of the time) times a pattern in [0, 1]: dwells are equal or, for
    `free-dwell` and `two-arm`, a softmax. Weights are in units of the start's own rms, so that one
    learning rate serves any number of masks.

    Quantised masks have the gradient of the continuous ones that they are rounded from: it goes
    straight through the rounding, whose own is 0.
    """

    unit: Tensor

    def __init__(self, start: Tensor, light: Light, rails: Rails = "dual", steps: int = 0) -> None:
        super().__init__()
        check_light(light, rails)
        self.light, self.rails, self.steps = light, rails, steps
        *replicas, masks, _ = start.shape
        if light == "column":
            fitted = start / start.abs().sum(dim=-2, keepdim=True).amax(dim=-1, keepdim=True)
            unit = fitted.square().mean(dim=(-2, -1), keepdim=True).sqrt()
            self.weight = nn.Parameter(fitted / unit)
            self.register_buffer("unit", unit)
            return
        pattern = 0.9 * start / _peak(start.abs())
        self.weight = nn.Parameter(
            torch.atanh(pattern) if rails == "dual" else torch.logit(pattern.clamp(min=0.05))
        )
        if light != "equal-dwell":
            per_mask = 2 if (light, rails) == ("free-dwell", "dual") else 1
            self.dwell = nn.Parameter(start.new_zeros(*replicas, per_mask, masks))

    def forward(self) -> tuple[Tensor, Tensor]:
        """Difference M⁺ − M⁻ and total M⁺ + M⁻, each (..., m, N)."""
        matrix = self.matrix()
        if self.rails == "single":
            matrix = self._shown(matrix, matrix)[0]
            return matrix, matrix
        if self.light == "two-arm":
            return self._shown(matrix, self._dwell()[..., 0, :, None].expand_as(matrix))
        return self._shown(matrix, matrix.abs())

    def rails_to_measure(self) -> Tensor:
        """What `scanner.measure` needs: M alone, or difference and total (2, ..., m, N)."""
        if self.disjoint:
            return self.matrix()
        difference, total = self()
        return difference if self.rails == "single" else torch.stack([difference, total])

    def lit(self, difference: Tensor, total: Tensor) -> Tensor:
        """How many rails of each mask are not dark, (..., m)."""
        time = total[..., 0].detach() if self.light == "two-arm" else 0
        least, most = difference.detach().aminmax(dim=-1)
        return (most > -time).int() + (least < time).int()

    @property
    def disjoint(self) -> bool:
        """Whether the total is |M|, and its gradient that of |M|.

        So it is where there are two rails of which each pixel is on one, and no rounding.
        """
        return self.rails == "dual" and self.light != "two-arm" and not self.steps

    def matrix(self) -> Tensor:
        """Difference M⁺ − M⁻ before it is quantised, (..., m, N)."""
        if self.light == "column":
            sums = self.weight.abs().sum(dim=-2, keepdim=True)
            matrix = self.weight * (self.unit / (sums * self.unit).clamp(min=1))
            return matrix if self.rails == "dual" else matrix.abs()
        dwell = self._dwell()
        time = dwell[..., 0, :, None]
        if self.rails == "single":
            return torch.sigmoid(self.weight) * time
        pattern = torch.tanh(self.weight)
        if self.light == "free-dwell":
            time = torch.where(pattern > 0, time, dwell[..., 1, :, None])
        return pattern * time

    def _shown(self, difference: Tensor, total: Tensor) -> tuple[Tensor, Tensor]:
        if not self.steps:
            return difference, total
        with torch.no_grad():
            shown = combine(quantise(separate(difference, total), self.light, self.steps))
        return _Through.apply(difference, shown[0]), _Through.apply(total, shown[1])  # type: ignore[no-untyped-call]

    def _dwell(self) -> Tensor:
        if self.light == "equal-dwell":
            masks = self.weight.shape[-2]
            count = 2 * masks if self.rails == "dual" else masks
            return self.weight.new_full((1, masks), 1 / count)
        return self.dwell.flatten(-2).softmax(dim=-1).view_as(self.dwell)


class _Through(torch.autograd.Function):
    """The second tensor, exactly, with the gradient of the first."""

    @staticmethod
    def forward(ctx: Any, continuous: Tensor, shown: Tensor) -> Tensor:
        return shown

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        return gradient, None


def combine(rails: Tensor) -> tuple[Tensor, Tensor]:
    """Difference and total, each (..., m, N), of rails (..., 2 or 1, m, N)."""
    if rails.shape[-3] == 1:
        single = rails[..., 0, :, :]
        return single, single
    plus, minus = rails.unbind(dim=-3)
    return plus - minus, plus + minus


def separate(difference: Tensor, total: Tensor) -> Tensor:
    """Rails (..., 2 or 1, m, N) of a difference and a total; inverse of `combine`.

    A single rail is one tensor given as both.
    """
    if difference is total:
        return difference.unsqueeze(-3)
    return torch.stack([total + difference, total - difference], dim=-3) / 2


def _peak(parts: Tensor) -> Tensor:
    return _or_one(parts.amax(dim=-1, keepdim=True))


def _or_one(divisor: Tensor) -> Tensor:
    return torch.where(divisor > 0, divisor, 1.0)

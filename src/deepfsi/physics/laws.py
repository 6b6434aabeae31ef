"""Light laws: what a set of masks may do with a pixel's photons, and what realises it.

    column       max_j Σ_i |M_ij| ≤ 1            optics that split each pixel's light (paper)
    equal-dwell  M⁺_ij, M⁻_ij ≤ 1/F              one DMD, one detector, equal times for F frames
    free-dwell   Σ_frames max_j(frame) ≤ 1       one DMD, one detector, each frame its own time
    two-arm      M⁺_ij + M⁻_ij = t_i, Σ t_i ≤ 1  one DMD, a detector on each arm
    dose         mean_j Σ_i |M_ij| ≤ 1           a projector that lights the scene, one detector

A law is one of frames: here the rails of masks are the tensor (..., 2, m, N) of M⁺ and M⁻ for
signed masks, or (..., 1, m, N) where there is one rail, `Rails.stacked`. Masks that learn are made
of free weights, tensors by name, by a function that cannot break the law (`LearnedMasks`).
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from deepfsi.base.errors import InputError
from deepfsi.camera.names import LightLawName, RailsKind, check_light_law
from deepfsi.physics.detection import Rails

ROUNDING_SLACK = 1e-5
"""Relative excess that float32 rounding may cause and `LightLaw.check` forgives."""

BRIGHTEST = 1e30
"""Entry beyond which sums of float32 may be infinite."""

Weights = Mapping[str, Tensor]
"""Free numbers of learned masks, and the numbers that scale them, by their names."""


class LightLaw(ABC):
    """Limit of what masks may do with light, for their rails (..., 2 or 1, m, N)."""

    name: ClassVar[LightLawName]  # by which a camera names it
    disjoint: ClassVar[bool] = True  # no pixel is lit on both rails: learned masks' total is |M|

    def rails(self, matrix: Tensor, kind: RailsKind = "dual") -> Tensor:
        """Rails (..., 2 or 1, m, N) whose difference is a matrix (..., m, N).

        A single rail is the matrix itself. Two are its positive and its negative part.
        """
        if kind == "single":
            return matrix.unsqueeze(-3)
        return signed_parts(matrix)

    @abstractmethod
    def fit(self, matrix: Tensor, kind: RailsKind = "dual") -> Tensor:
        """Rails (2 or 1, m, N) of a matrix (m, N), with as much light as the law allows."""

    @abstractmethod
    def excess(self, rails: Tensor) -> float:
        """Relative excess of rails (2 or 1, m, N) over the law: 0 or less if they obey it."""

    @abstractmethod
    def used(self, rails: Tensor) -> Tensor:
        """Share (..., m) of the law that the first k masks use; 0 while they are dark.

        Shown alone for the whole exposure these k may be brighter by the inverse. Shown at the
        beginning of all, on one device, they have taken this share of its time.
        """

    def quantise(self, rails: Tensor, levels: int) -> Tensor:
        """Rails (..., 2 or 1, m, N) as a device shows them.

        Each frame has `levels` grey levels from dark to its own peak.
        """
        check_levels(levels)
        step = frame_peaks(rails) / (levels - 1)
        return (rails / step).round() * step

    def leak(self, rails: Tensor, contrast: float) -> Tensor:
        """Rails (..., 2 or 1, m, N) of a projector whose OFF pixels send 1 / contrast of the light.

        A frame is ON at its peak. The leak is part of the dose: beyond it all frames are dimmed.
        """
        lit = rails + (rails.amax(dim=-1, keepdim=True) - rails) / contrast
        return lit / lit.sum(dim=(-3, -2), keepdim=True).mean(dim=-1, keepdim=True).clamp(min=1)

    def weights(self, start: Tensor, kind: RailsKind) -> dict[str, Tensor]:
        """Free numbers of masks (..., m, N) that begin like a start: parameters, and their scale.

        They are in units of the start's own size, so that one learning rate serves any number of
        masks. Those of frames are patterns, at first at nine tenths of their peaks, and dwells,
        at first equal, both before the functions that bound them.
        """
        *replicas, masks, _ = start.shape
        pattern = 0.9 * start / frame_peaks(start.abs())
        free = torch.atanh(pattern) if kind == "dual" else torch.logit(pattern.clamp(min=0.05))
        weights: dict[str, Tensor] = {"weight": nn.Parameter(free)}
        if dwells := self.dwells_of_mask(kind):
            weights["dwell"] = nn.Parameter(start.new_zeros(*replicas, dwells, masks))
        return weights

    def dwells_of_mask(self, kind: RailsKind) -> int:
        """Dwells of each mask that masks learn."""
        return 0

    @abstractmethod
    def matrix(self, weights: Weights, kind: RailsKind, shortest: float = 0.0) -> Tensor:
        """Difference M⁺ − M⁻ (..., m, N) of the rails of free numbers, as `project` has them."""

    def project(self, weights: Weights, kind: RailsKind, shortest: float = 0.0) -> Rails:
        """Rails (..., m, N) of free numbers: differentiable, and whatever these are they obey.

        Frames last a share `shortest` of the exposure at least, or are dark.
        """
        matrix = self.matrix(weights, kind, shortest)
        return Rails(matrix, matrix.abs()) if kind == "dual" else Rails(matrix)

    def dim(self, weights: Weights, kind: RailsKind, factor: Tensor) -> None:
        """Pass a factor (R,) of the light, up to 1, by a change of the weights in place."""
        weight = weights["weight"]
        pattern = _pattern_of(weight, kind) * factor[:, None, None]
        weight.copy_(torch.atanh(pattern) if kind == "dual" else torch.logit(pattern, eps=1e-6))

    def check(self, rails: Tensor) -> Tensor:
        """Return rails (2 or 1, m, N), or raise `InputError` if they are no shares or too bright.

        Rails must be finite, not negative, of a kind that the law can have, and obey it.
        """
        check_light_law(self.name, "dual" if len(rails) == 2 else "single")
        if not bool(torch.isfinite(rails).all()):
            raise InputError("the matrix holds NaN or infinity: give finite numbers")
        if float(rails.min()) < 0:
            raise InputError(
                'the matrix has negative entries: use `rails="dual"`, or give frames of 0 or more'
            )
        if float(rails.max()) > BRIGHTEST:
            raise InputError(
                f"the matrix has entries above {BRIGHTEST:g}: give shares of each pixel's photons"
            )
        factor = 1 + self.excess(rails)
        if factor > 1 + ROUNDING_SLACK:
            step = 10.0 ** (math.floor(math.log10(factor)) - 3)
            above = math.ceil(factor / step) * step  # at least the factor, in four digits
            raise InputError(
                f"the matrix is {factor:.4g} times as bright as {self.name} allows, and breaks the "
                f"{self.name} constraint: divide it by {above:.4g}, or choose another with `light`"
            )
        return rails

    def rails_of(self, matrix: np.ndarray, kind: RailsKind) -> Tensor:
        """Rails (2 or 1, m, N) of a user's matrix (m, N), as it is; errors as of `check`."""
        signed = torch.from_numpy(np.asarray(matrix, dtype=np.float32))
        return self.check(self.rails(signed, kind))


class _Column(LightLaw):
    """Optics that split each pixel's light among all readouts: max_j Σ_i |M_ij| ≤ 1.

    The only law is that no photon is counted twice. Source: the paper, arXiv 2508.01981.
    """

    name: ClassVar[LightLawName] = "column"

    @staticmethod
    def most(sums: Tensor) -> Tensor:
        """What the law limits (..., 1), of the sums of columns (..., N): the largest."""
        return sums.amax(dim=-1, keepdim=True)

    def fit(self, matrix: Tensor, kind: RailsKind = "dual") -> Tensor:
        """One common factor, for 1 of what the law limits."""
        parts = self.rails(matrix, kind)
        return parts / self.most(parts.sum(dim=(0, 1)))

    def excess(self, rails: Tensor) -> float:
        """What the law limits, less 1."""
        return float(self.most(rails.sum(dim=(0, 1)))) - 1

    def used(self, rails: Tensor) -> Tensor:
        """max_j Σ_i |M_ij| over the first k masks i."""
        return rails.sum(dim=-3).cumsum(dim=-2).amax(dim=-1)

    def quantise(self, rails: Tensor, levels: int) -> Tensor:
        """Grey levels of each frame; where rounding breaks the law, all are dimmed to mend it."""
        shown = super().quantise(rails, levels)
        return shown / self.most(shown.sum(dim=(-3, -2), keepdim=True)).clamp(min=1)

    def weights(self, start: Tensor, kind: RailsKind) -> dict[str, Tensor]:
        """The fitted start in units of its own rms, and that unit."""
        light = self.most(start.abs().sum(dim=-2, keepdim=True))
        if not bool(light.all()):
            raise InputError("a start is 0 everywhere: give masks that pass light")
        fitted = start / light
        unit = fitted.square().mean(dim=(-2, -1), keepdim=True).sqrt()
        return {"weight": nn.Parameter(fitted / unit), "unit": unit}

    def matrix(self, weights: Weights, kind: RailsKind, shortest: float = 0.0) -> Tensor:
        """Each pixel's column, divided by its sum where that exceeds 1."""
        sums = weights["weight"].abs().sum(dim=-2, keepdim=True)
        return self.limited(weights, kind, sums)

    def limited(self, weights: Weights, kind: RailsKind, light: Tensor) -> Tensor:
        """Matrix of the weights, divided by the light (..., 1, N or 1) where that exceeds 1."""
        unit = weights["unit"]
        matrix = weights["weight"] * (unit / (light * unit).clamp(min=1))
        return matrix if kind == "dual" else matrix.abs()

    def dim(self, weights: Weights, kind: RailsKind, factor: Tensor) -> None:
        """Take a smaller unit."""
        weights["unit"].mul_(factor[:, None, None])


class _EqualDwell(LightLaw):
    """One DMD and one detector, equal times for F frames: M⁺_ij, M⁻_ij ≤ 1/F.

    A frame is a rail of a mask that is not dark; learned masks have as many frames as rails. Each
    is shown for 1/F of the exposure, and a mirror that is ON sends its light as long. Source:
    docs/understand/physics.md, as of the others of one device.
    """

    name = "equal-dwell"

    def fit(self, matrix: Tensor, kind: RailsKind = "dual") -> Tensor:
        """Each frame over its own peak and F."""
        parts = self.rails(matrix, kind)
        return parts / (frame_peaks(parts) * len(frames(parts)))

    def excess(self, rails: Tensor) -> float:
        """F max M± − 1."""
        return float(rails.max()) * max(len(frames(rails)), 1) - 1

    def used(self, rails: Tensor) -> Tensor:
        """Share of the frames that are of the first k masks."""
        lit = (rails.amax(dim=-1) > 0).sum(dim=-2).cumsum(dim=-1)
        return lit / lit[..., -1:].clamp(min=1)

    def matrix(self, weights: Weights, kind: RailsKind, shortest: float = 0.0) -> Tensor:
        """Patterns in [−1, 1] or [0, 1] for 1/F."""
        pattern = _pattern_of(weights["weight"], kind)
        count = pattern.shape[-2] * (2 if kind == "dual" else 1)
        return pattern * pattern.new_full((), 1 / count)


class _FreeDwell(LightLaw):
    """One DMD and one detector, each frame its own time: Σ_frames max_j(frame) ≤ 1.

    A mirror that is always ON sends its light for the whole dwell of its frame, so that the peak of
    a frame is the shortest dwell that it can have, and dwells sum to the exposure.
    """

    name = "free-dwell"

    def fit(self, matrix: Tensor, kind: RailsKind = "dual") -> Tensor:
        """One common factor, 1 / Σ peaks."""
        parts = self.rails(matrix, kind)
        return parts / parts.amax(dim=-1).sum()

    def excess(self, rails: Tensor) -> float:
        """Σ peaks − 1."""
        return float(rails.amax(dim=-1).sum()) - 1

    def used(self, rails: Tensor) -> Tensor:
        """Σ peaks of the first k masks."""
        return rails.amax(dim=-1).sum(dim=-2).cumsum(dim=-1)

    def dwells_of_mask(self, kind: RailsKind) -> int:
        """One of each rail."""
        return 2 if kind == "dual" else 1

    def matrix(self, weights: Weights, kind: RailsKind, shortest: float = 0.0) -> Tensor:
        """Patterns for the dwells of their frames, which are a softmax."""
        pattern = _pattern_of(weights["weight"], kind)
        dwells = _softmax_dwells(weights["dwell"], shortest, pattern)
        if kind == "single":
            return pattern * dwells[..., 0, :, None]
        plus, minus = dwells.unbind(dim=-2)
        return pattern * torch.where(pattern > 0, plus.unsqueeze(-1), minus.unsqueeze(-1))


class _TwoArm(LightLaw):
    """One DMD with a detector on each arm: M⁺_ij + M⁻_ij = t_i, Σ t_i ≤ 1.

    What one arm does not get, the other does: a mask that is shown for the time t has M± = (t ± M)
    / 2, and no light is lost.
    """

    name = "two-arm"
    disjoint = False

    def rails(self, matrix: Tensor, kind: RailsKind = "dual") -> Tensor:
        """M± = (t ± M) / 2, for the time t of the peak of each mask."""
        check_light_law(self.name, kind)
        return Rails(matrix, matrix.abs().amax(dim=-1, keepdim=True)).stacked

    def fit(self, matrix: Tensor, kind: RailsKind = "dual") -> Tensor:
        """Each mask over its own peak and m."""
        return self.rails(matrix / (frame_peaks(matrix.abs()) * len(matrix)), kind)

    def excess(self, rails: Tensor) -> float:
        """Σ t − 1, or by how much the sum of the arms differs among the pixels of a mask, times m.

        The larger of both.
        """
        dwell = rails.sum(dim=0)
        uneven = float((dwell.amax(dim=-1) - dwell.amin(dim=-1)).max()) * len(dwell)
        return max(float(dwell.amax(dim=-1).sum()) - 1, uneven)

    def used(self, rails: Tensor) -> Tensor:
        """Σ t of the first k masks."""
        return rails.sum(dim=-3).amax(dim=-1).cumsum(dim=-1)

    def quantise(self, rails: Tensor, levels: int) -> Tensor:
        """Grey levels of the positive rail; the other gets what is left of the time."""
        check_levels(levels)
        steps = levels - 1
        total = rails.sum(dim=-3)
        time = total.amax(dim=-1, keepdim=True)
        plus = (rails[..., 0, :, :] / frame_peaks(total) * steps).round() / steps * time
        return torch.stack([plus, time - plus], dim=-3)

    def dwells_of_mask(self, kind: RailsKind) -> int:
        """One, as both arms see the mask at once."""
        return 1

    def matrix(self, weights: Weights, kind: RailsKind, shortest: float = 0.0) -> Tensor:
        """Patterns for the times of their masks, which are a softmax."""
        pattern = _pattern_of(weights["weight"], kind)
        return pattern * _softmax_dwells(weights["dwell"], shortest)[..., 0, :, None]

    def project(self, weights: Weights, kind: RailsKind, shortest: float = 0.0) -> Rails:
        """Their total is the times of the masks."""
        matrix = self.matrix(weights, kind, shortest)
        # Taken again: the gradient of each use goes through the softmax by itself
        times = _softmax_dwells(weights["dwell"], shortest)[..., 0, :, None]
        return Rails(matrix, times.expand_as(matrix))


class _Dose(_Column):
    """A projector lights the scene with the masks, one after another: mean_j Σ_i |M_ij| ≤ 1.

    What is limited is the light that falls on the scene. A pixel may get more than its mean share,
    as what another does not get is not lost; so photons of a pixel may be counted more often than
    `column` allows. Source: docs/understand/physics.md.
    """

    name = "dose"

    @staticmethod
    def most(sums: Tensor) -> Tensor:
        """The mean of the sums of columns."""
        return sums.mean(dim=-1, keepdim=True)

    def used(self, rails: Tensor) -> Tensor:
        """mean_j Σ_i |M_ij| over the first k masks i."""
        return rails.sum(dim=-3).mean(dim=-1).cumsum(dim=-1)

    def matrix(self, weights: Weights, kind: RailsKind, shortest: float = 0.0) -> Tensor:
        """All masks, divided by the mean of their columns' sums where that exceeds 1."""
        sums = weights["weight"].abs().sum(dim=-2, keepdim=True)
        return self.limited(weights, kind, self.most(sums))


LAW_CLASSES: dict[str, type[LightLaw]] = {
    law.name: law for law in (_Column, _EqualDwell, _FreeDwell, _TwoArm, _Dose)
}
"""Class of each light law, by its name."""


def light_law(name: str) -> LightLaw:
    """Light law of a name; `InputError` if there is none."""
    check_light_law(name, "dual")
    return LAW_CLASSES[name]()


def signed_parts(matrix: Tensor) -> Tensor:
    """Positive and negative part (..., 2, m, N) of a matrix (..., m, N), both 0 or more."""
    return torch.stack([matrix.clamp(min=0), (-matrix).clamp(min=0)], dim=-3)


def frames(rails: Tensor) -> Tensor:
    """Frames (F, N) of rails (2 or 1, m, N): every rail that is not dark, mask by mask."""
    every = rails.transpose(0, 1).flatten(0, 1)
    return every[every.amax(dim=-1) > 0]


def frame_peaks(parts: Tensor) -> Tensor:
    """Largest entry of each frame (..., m, 1), 1 where it is dark."""
    largest = parts.amax(dim=-1, keepdim=True)
    return torch.where(largest > 0, largest, 1.0)


def check_levels(levels: int) -> None:
    """Raise `InputError` unless masks can have so many grey levels."""
    if levels < 2:
        raise InputError(f"{levels} grey levels are not allowed: give at least 2, dark included")


def _pattern_of(weight: Tensor, kind: RailsKind) -> Tensor:
    """Patterns (..., m, N) of free numbers, in [−1, 1] of two rails, in [0, 1] of one."""
    return torch.tanh(weight) if kind == "dual" else torch.sigmoid(weight)


def _softmax_dwells(dwell: Tensor, shortest: float, pattern: Tensor | None = None) -> Tensor:
    """Shares (..., 1 or 2, m) of the exposure of frames, of free numbers.

    A frame is read for its peak's share of its dwell: that is 0, or `shortest` at least. Dwells so
    rounded have the gradient of those before, so that a dark frame may come back.
    """
    # of frames without patterns (..., m, N) the peak is 1
    shares = dwell.flatten(-2).softmax(dim=-1)
    if not shortest:
        return shares.view_as(dwell)
    with torch.no_grad():
        peaks = torch.ones_like(shares)
        if pattern is not None:
            ends = [pattern.amax(dim=-1), -pattern.amin(dim=-1)][: dwell.shape[-2]]
            peaks = torch.cat(ends, dim=-1).clamp(min=0)
        shown = share_out(shares * peaks, shortest) / torch.where(peaks > 0, peaks, 1.0)
    return through(shares, shown).view_as(dwell)


def share_out(dwell: Tensor, shortest: float) -> Tensor:
    """Dwells (..., q) of frames without those that are too short, whose time the others get.

    The shortest frames are left out one after another, until the time, shared out among the others
    in proportion to their dwells, leaves none of them below the shortest dwell. So as many frames
    are shown as can be, and the longest one always is. It can be differentiated: the choice of the
    frames is fixed, their times are not.
    """
    order = dwell.argsort(dim=-1, descending=True, stable=True)
    longest_first = dwell.gather(-1, order)
    total = dwell.sum(-1)[..., None]
    enough = longest_first * total >= shortest * (1 - 1e-6) * longest_first.cumsum(-1)
    count = enough.sum(-1)[..., None].clip(min=1)
    shown = dwell * (order.argsort() < count)
    return shown * (total / shown.sum(-1)[..., None])


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


class FixedMasks(nn.Module):
    """Masks that do not learn; `forward` gives their rails (..., 2 or 1, m, N)."""

    difference: Tensor
    total: Tensor | None

    def __init__(self, rails: Tensor) -> None:
        super().__init__()
        _check_tensor(rails, "rails", 3, "(2 or 1, masks, pixels)")
        both = Rails.of(rails)
        self.register_buffer("difference", both.difference)
        self.register_buffer("total", both.total if both.count == 2 else None)

    def forward(self) -> Rails:
        """Rails of the masks, (..., m, N)."""
        return Rails(self.difference, self.total)


class LearnedMasks(nn.Module):
    """Masks as a differentiable function of free weights that cannot break their light law.

    Quantised masks have the gradient of the continuous ones that they are rounded from: it goes
    straight through the rounding, whose own is 0.

    Parameters
    ----------
    start : tensor, shape (..., m, N)
        Matrix that they begin like; leading axes are replicas.
    light : str
        A light law, one of `LIGHT_LAWS`.
    rails : {"dual", "single"}
        Signed masks, or frames of 0 or more.
    levels : int
        Grey levels, dark included; 0 for continuous masks.
    shortest : float
        Share of the exposure that a frame lasts at least, where masks have dwells.
    contrast : float, optional
        Of a projector, whose OFF pixels leak light; None for dark ones.

    Raises
    ------
    InputError
        For an unknown law, rails that it cannot have, or a start that is no such matrix.
    """

    def __init__(
        self,
        start: Tensor,
        light: LightLawName,
        rails: RailsKind = "dual",
        levels: int = 0,
        shortest: float = 0.0,
        contrast: float | None = None,
    ) -> None:
        super().__init__()
        check_light_law(light, rails)
        _check_tensor(start, "a start", 2, "(masks, pixels)")
        if rails == "single" and bool((start < 0).any()):
            raise InputError("a start of a single rail has negative entries: give 0 or more")
        self.law = light_law(light)
        self.rails = rails
        self.levels = levels
        self.shortest = shortest
        self.contrast = contrast
        for name, tensor in self.law.weights(start, rails).items():
            if isinstance(tensor, nn.Parameter):
                self.register_parameter(name, tensor)
            else:
                self.register_buffer(name, tensor)

    def forward(self) -> Rails:
        """Rails of the masks, (..., m, N)."""
        rails = self.law.project(self._weights, self.rails, self.shortest)
        if self.levels:
            with torch.no_grad():
                shown = Rails.of(self.law.quantise(rails.stacked, self.levels))
            rails = rails.map(through, shown)
        if self.contrast is None:
            return rails
        return Rails.of(self.law.leak(rails.stacked, self.contrast))

    def matrix(self) -> Tensor:
        """Their difference alone, (..., m, N), before it is rounded to grey levels or leaks."""
        return self.law.matrix(self._weights, self.rails, self.shortest)

    def dim(self, factor: Tensor) -> None:
        """Pass a factor (R,) of the light, up to 1."""
        with torch.no_grad():
            self.law.dim(self._weights, self.rails, factor)

    @property
    def disjoint(self) -> bool:
        """True if the total is |M|, and its gradient that of |M|."""
        # So it is where there are two rails of which each pixel is on one, and no rounding or leak
        changed = self.levels or self.contrast is not None
        return self.rails == "dual" and self.law.disjoint and not changed

    @property
    def _weights(self) -> dict[str, Tensor]:
        return {**dict(self.named_parameters()), **dict(self.named_buffers())}


def _check_tensor(given: Any, what: str, axes: int, shape: str) -> None:
    """Raise `InputError` unless a tensor of real numbers has so many axes or more."""
    if not isinstance(given, Tensor) or not given.is_floating_point() or given.ndim < axes:
        found = tuple(given.shape) if isinstance(given, Tensor) else type(given).__name__
        kind = f" and type {given.dtype}" if isinstance(given, Tensor) else ""
        raise InputError(
            f"{what} of {'shape ' * bool(kind)}{found}{kind} cannot be used: give a tensor of real "
            f"numbers {shape}"
        )

"""Light laws: what a set of masks may do with a pixel's photons, and what realises it.

    column       max_j Σ_i |M_ij| ≤ 1            optics that split each pixel's light (paper)
    equal-dwell  M⁺_ij, M⁻_ij ≤ 1/F              one DMD, one detector, equal times for F frames
    free-dwell   Σ_frames max_j(frame) ≤ 1       one DMD, one detector, each frame its own time
    two-arm      M⁺_ij + M⁻_ij = t_i, Σ t_i ≤ 1  one DMD, a detector on each arm
    dose         mean_j Σ_i |M_ij| ≤ 1           a projector that lights the scene, one detector

A law limits frames. Rails are one tensor, `Rails.stacked`: (..., 2, m, N) holds M⁺ and M⁻ of signed
masks, (..., 1, m, N) a single rail. `LearnedMasks` computes them from free weights by a function
that cannot break the law.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from deepfsi.base.errors import InputError
from deepfsi.camera.names import LightLawName, RailsKind, check_light_law
from deepfsi.physics.detection import Rails

ROUNDING_SLACK = 1e-5
"""Relative excess that float32 rounding may cause and `LightLaw.check` forgives."""

DARK = 1e-30
"""Light below which masks are dark, and stay so."""

Weights = Mapping[str, Tensor]
"""Weights of learned masks and their scale, by name."""


class LightLaw(ABC):
    """Limit on the light that rails (..., 2 or 1, m, N) may use."""

    name: ClassVar[LightLawName]  # the `light` of a camera
    disjoint: ClassVar[bool] = True  # no pixel is lit on both rails: learned masks' total is |M|
    dwells: ClassVar[dict[RailsKind, int]] = {"dual": 0, "single": 0}  # learned by each mask

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

    def excess(self, rails: Tensor) -> float:
        """Relative excess of rails (2 or 1, m, N) over the law: 0 or less if they obey it."""
        return float(self.used(rails)[-1]) - 1

    @abstractmethod
    def used(self, rails: Tensor) -> Tensor:
        """Share (..., m) of the law that the first k masks use; 0 while they are dark.

        If the exposure shows these k alone, they may be brighter by the inverse. If one device
        shows them first, they take this share of its time.
        """

    def quantise(self, rails: Tensor, levels: int) -> Tensor:
        """Rails (..., 2 or 1, m, N) as a device shows them.

        Each frame has `levels` grey levels from dark to its own peak.
        """
        check_levels(levels)
        step = frame_peaks(rails) / (levels - 1)
        return (rails / step).round() * step

    def weights(self, start: Tensor, kind: RailsKind) -> dict[str, Tensor]:
        """Weights that begin at a start (..., m, N): parameters, and their scale.

        The start sets their unit, so that one learning rate serves any number of masks. Frames
        have patterns, which begin at nine tenths of their peaks, and dwells, which begin equal.
        """
        *replicas, masks, _ = start.shape
        # at a peak atanh is infinite and tanh has no gradient; logit is infinite at 0
        pattern = 0.9 * start / frame_peaks(start.abs())
        free = torch.atanh(pattern) if kind == "dual" else torch.logit(pattern.clamp(min=0.05))
        weights: dict[str, Tensor] = {"weight": nn.Parameter(free)}
        if dwells := self.dwells[kind]:
            weights["dwell"] = nn.Parameter(start.new_zeros(*replicas, dwells, masks))
        return weights

    @abstractmethod
    def matrix(self, weights: Weights, kind: RailsKind, shortest: float = 0.0) -> Tensor:
        """Difference M⁺ − M⁻ (..., m, N) of the rails that `project` gives."""

    def project(self, weights: Weights, kind: RailsKind, shortest: float = 0.0) -> Rails:
        """Rails (..., m, N) of weights: differentiable, and within the law for any weights.

        A frame is dark or lasts at least the share `shortest` of the exposure.
        """
        matrix = self.matrix(weights, kind, shortest)
        return Rails(matrix, matrix.abs()) if kind == "dual" else Rails(matrix)

    def dim(self, weights: Weights, kind: RailsKind, factor: Tensor) -> None:
        """Dim the masks by factors (R,) up to 1: change the weights in place."""
        weight = weights["weight"]
        pattern = _pattern_of(weight, kind) * factor[:, None, None]
        weight.copy_(torch.atanh(pattern) if kind == "dual" else torch.logit(pattern, eps=1e-6))

    def check(self, rails: Tensor) -> Tensor:
        """Return rails (2 or 1, m, N), or raise `InputError` if they break the law.

        They must also be finite and 0 or more.
        """
        check_light_law(self.name, "dual" if len(rails) == 2 else "single")
        if not bool(((rails >= 0) & (rails <= 1e30)).all()):  # more has infinite sums in float32
            raise InputError(
                "the matrix has negative entries, or some that are not finite: give shares of "
                'photons, or `rails="dual"` for signed masks'
            )
        factor = 1 + self.excess(rails)
        if factor > 1 + ROUNDING_SLACK:
            above = 1.0006 * factor  # so that four digits of it are at least the factor
            raise InputError(
                f"the matrix is {factor:.4g} times as bright as {self.name} allows, and breaks the "
                f"{self.name} constraint: divide it by {above:.4g}, or choose another with `light`"
            )
        return rails

    def rails_of(self, matrix: np.ndarray, kind: RailsKind) -> Tensor:
        """Rails (2 or 1, m, N) of a user's matrix (m, N), which must pass `check`."""
        signed = torch.from_numpy(np.asarray(matrix, dtype=np.float32))
        return self.check(self.rails(signed, kind))


class _Column(LightLaw):
    """Optics that split each pixel's light among all readouts: max_j Σ_i |M_ij| ≤ 1.

    The only law is that no photon is counted twice. Source: the paper, arXiv 2508.01981.
    """

    name: ClassVar[LightLawName] = "column"

    @staticmethod
    def limited_light(sums: Tensor) -> Tensor:
        """Quantity (..., 1) that the law limits, from column sums (..., N): the largest."""
        return sums.amax(dim=-1, keepdim=True)

    def fit(self, matrix: Tensor, kind: RailsKind = "dual") -> Tensor:
        """Scale all masks by one factor, up to the limit."""
        rails = self.rails(matrix, kind)
        return rails / self.limited_light(rails.sum(dim=(0, 1))).clamp(min=DARK)

    def used(self, rails: Tensor) -> Tensor:
        """Limited quantity of the first k masks."""
        return self.limited_light(rails.sum(dim=-3).cumsum(dim=-2))[..., 0]

    def quantise(self, rails: Tensor, levels: int) -> Tensor:
        """Grey levels of each frame; all frames are dimmed if rounding breaks the law."""
        shown = super().quantise(rails, levels)
        return shown / self.limited_light(shown.sum(dim=(-3, -2), keepdim=True)).clamp(min=1)

    def weights(self, start: Tensor, kind: RailsKind) -> dict[str, Tensor]:
        """The fitted start in units of its rms, and this unit, a buffer that does not learn."""
        light = self.limited_light(start.abs().sum(dim=-2, keepdim=True))
        if not bool(light.all()):
            raise InputError("a start is 0 everywhere: give masks that pass light")
        fitted = start / light
        unit = fitted.square().mean(dim=(-2, -1), keepdim=True).sqrt()
        return {"weight": nn.Parameter(fitted / unit), "unit": unit}

    def matrix(self, weights: Weights, kind: RailsKind, shortest: float = 0.0) -> Tensor:
        """Each pixel's column, divided by its limited light where that exceeds 1."""
        unit = weights["unit"]
        light = self.light_by_pixel(weights["weight"].abs().sum(dim=-2, keepdim=True))
        matrix = weights["weight"] * (unit / (light * unit).clamp(min=1))
        return matrix if kind == "dual" else matrix.abs()

    @staticmethod
    def light_by_pixel(sums: Tensor) -> Tensor:
        """Light (..., N or 1) that may not exceed 1 at each pixel, from column sums (..., N)."""
        return sums

    def dim(self, weights: Weights, kind: RailsKind, factor: Tensor) -> None:
        """Make the unit smaller."""
        weights["unit"].mul_(factor[:, None, None])


class _EqualDwell(LightLaw):
    """One DMD and one detector, equal times for F frames: M⁺_ij, M⁻_ij ≤ 1/F.

    Each rail that is not dark is a frame; learned masks have a frame for each rail. The device
    shows each frame for 1/F of the exposure. Source, here and below: docs/understand/physics.md.
    """

    name = "equal-dwell"

    def fit(self, matrix: Tensor, kind: RailsKind = "dual") -> Tensor:
        """Divide each frame by its peak and by F."""
        rails = self.rails(matrix, kind)
        return rails / (frame_peaks(rails) * max(len(frames(rails)), 1))

    def excess(self, rails: Tensor) -> float:
        """F max M± − 1."""
        return float(rails.max()) * max(len(frames(rails)), 1) - 1

    def used(self, rails: Tensor) -> Tensor:
        """Share of the frames that belong to the first k masks."""
        lit = (rails.amax(dim=-1) > 0).sum(dim=-2).cumsum(dim=-1)
        return lit / lit[..., -1:].clamp(min=1)

    def matrix(self, weights: Weights, kind: RailsKind, shortest: float = 0.0) -> Tensor:
        """Patterns in [−1, 1] or [0, 1] for 1/F."""
        pattern = _pattern_of(weights["weight"], kind)
        count = pattern.shape[-2] * (2 if kind == "dual" else 1)
        return pattern * pattern.new_full((), 1 / count)


class _FreeDwell(LightLaw):
    """One DMD and one detector, each frame its own time: Σ_frames max_j(frame) ≤ 1.

    A mirror that is always ON sends light for the whole dwell of its frame. So the peak of a frame
    is its shortest possible dwell, and dwells sum to the exposure.
    """

    name = "free-dwell"
    dwells: ClassVar[dict[RailsKind, int]] = {"dual": 2, "single": 1}  # one for each rail

    def fit(self, matrix: Tensor, kind: RailsKind = "dual") -> Tensor:
        """Scale all masks by 1 / Σ peaks."""
        rails = self.rails(matrix, kind)
        return rails / rails.amax(dim=-1).sum().clamp(min=DARK)

    def used(self, rails: Tensor) -> Tensor:
        """Σ peaks of the first k masks."""
        return rails.amax(dim=-1).sum(dim=-2).cumsum(dim=-1)

    def matrix(self, weights: Weights, kind: RailsKind, shortest: float = 0.0) -> Tensor:
        """Patterns times the dwells of their frames, which are a softmax."""
        pattern = _pattern_of(weights["weight"], kind)
        dwells = _softmax_dwells(weights["dwell"], shortest, pattern)
        if kind == "single":
            return pattern * dwells[..., 0, :, None]
        plus, minus = dwells.unbind(dim=-2)
        return pattern * torch.where(pattern > 0, plus.unsqueeze(-1), minus.unsqueeze(-1))


class _TwoArm(LightLaw):
    """One DMD with a detector on each arm: M⁺_ij + M⁻_ij = t_i, Σ t_i ≤ 1.

    Light that misses one arm reaches the second: a mask shown for the time t has M± = (t ± M) / 2,
    and no light is lost.
    """

    name = "two-arm"
    disjoint = False
    dwells: ClassVar[dict[RailsKind, int]] = {"dual": 1}  # both arms see a mask at once

    def rails(self, matrix: Tensor, kind: RailsKind = "dual") -> Tensor:
        """M± = (t ± M) / 2, for the time t of the peak of each mask."""
        check_light_law(self.name, kind)
        return Rails(matrix, matrix.abs().amax(dim=-1, keepdim=True)).stacked

    def fit(self, matrix: Tensor, kind: RailsKind = "dual") -> Tensor:
        """Divide each mask by its peak and by m."""
        return self.rails(matrix / (frame_peaks(matrix.abs()) * len(matrix)), kind)

    def excess(self, rails: Tensor) -> float:
        """Larger of Σ t − 1 and m times the spread, among pixels of a mask, of the arms' sum."""
        dwell = rails.sum(dim=0)
        uneven = float((dwell.amax(dim=-1) - dwell.amin(dim=-1)).max()) * len(dwell)
        return max(super().excess(rails), uneven)

    def used(self, rails: Tensor) -> Tensor:
        """Σ t of the first k masks."""
        return rails.sum(dim=-3).amax(dim=-1).cumsum(dim=-1)

    def quantise(self, rails: Tensor, levels: int) -> Tensor:
        """Grey levels of the positive rail; the negative rail gets the rest of the time."""
        check_levels(levels)
        steps = levels - 1
        total = rails.sum(dim=-3)
        time = total.amax(dim=-1, keepdim=True)
        plus = (rails[..., 0, :, :] / frame_peaks(total) * steps).round() / steps * time
        return torch.stack([plus, time - plus], dim=-3)

    def matrix(self, weights: Weights, kind: RailsKind, shortest: float = 0.0) -> Tensor:
        """Patterns times the times of their masks, which are a softmax."""
        pattern = _pattern_of(weights["weight"], kind)
        return pattern * _softmax_dwells(weights["dwell"], shortest)[..., 0, :, None]

    def project(self, weights: Weights, kind: RailsKind, shortest: float = 0.0) -> Rails:
        """Rails whose total is the times of the masks."""
        matrix = self.matrix(weights, kind, shortest)
        # Computed again, not shared: one softmax would add both gradients first, and round
        # differently
        times = _softmax_dwells(weights["dwell"], shortest)[..., 0, :, None]
        return Rails(matrix, times.expand_as(matrix))


class _Dose(_Column):
    """A projector lights the scene with the masks, one after another: mean_j Σ_i |M_ij| ≤ 1.

    The law limits the light that falls on the scene. A pixel may get more than its mean share if
    others get less, and then gives more photons than `column` allows.
    """

    name = "dose"

    @staticmethod
    def limited_light(sums: Tensor) -> Tensor:
        """The mean of the sums of columns."""
        return sums.mean(dim=-1, keepdim=True)

    light_by_pixel = limited_light


def light_law(name: str) -> LightLaw:
    """Light law of a name; `InputError` if there is none."""
    check_light_law(name, "dual")
    classes = _Column, _EqualDwell, _FreeDwell, _TwoArm, _Dose
    laws: dict[str, type[LightLaw]] = {law.name: law for law in classes}
    return laws[name]()


def signed_parts(matrix: Tensor) -> Tensor:
    """Positive and negative part (..., 2, m, N) of a matrix (..., m, N), both 0 or more."""
    return torch.stack([matrix.clamp(min=0), (-matrix).clamp(min=0)], dim=-3)


def frames(rails: Tensor) -> Tensor:
    """Frames (F, N) of rails (2 or 1, m, N): every rail that is not dark, mask by mask."""
    by_mask = rails.transpose(0, 1).flatten(0, 1)
    return by_mask[by_mask.amax(dim=-1) > 0]


def frame_peaks(rails: Tensor) -> Tensor:
    """Largest entry (..., m, 1) of each frame (..., m, N), 1 where the frame is dark."""
    largest = rails.amax(dim=-1, keepdim=True)
    return torch.where(largest > 0, largest, 1.0)


def check_levels(levels: int) -> None:
    """Raise `InputError` for fewer than two grey levels."""
    if levels < 2:
        raise InputError(f"{levels} grey levels are not allowed: give at least 2, dark included")


def _pattern_of(weight: Tensor, kind: RailsKind) -> Tensor:
    """Patterns (..., m, N): two rails have them in [−1, 1], a single rail in [0, 1]."""
    return torch.tanh(weight) if kind == "dual" else torch.sigmoid(weight)


def _softmax_dwells(dwell: Tensor, shortest: float, pattern: Tensor | None = None) -> Tensor:
    """Share (..., 1 or 2, m) of the exposure that each frame gets.

    A mirror is ON for its frame's dwell times its peak: 0, or at least `shortest`. Dwells rounded
    to this have the gradient of the softmax, so that a dark frame can come back. Without patterns
    (..., m, N) each peak is 1.
    """
    shares = dwell.flatten(-2).softmax(dim=-1)
    if not shortest:
        return shares.view_as(dwell)
    with torch.no_grad():
        peaks = torch.ones_like(shares)
        if pattern is not None:
            ends = [pattern.amax(dim=-1), -pattern.amin(dim=-1)][: dwell.shape[-2]]
            peaks = torch.cat(ends, dim=-1).clamp(min=0)
        shown = share_out(shares * peaks, shortest) / torch.where(peaks > 0, peaks, 1.0)
    return straight_through(shares, shown).view_as(dwell)


def share_out(dwell: Tensor, shortest: float) -> Tensor:
    """Dwells (..., q) without frames that are too short; the rest share their time.

    The shortest frames leave one by one, until all that remain, scaled to the whole time, reach
    the shortest dwell. The longest frame always stays. Gradients flow through the times, not
    through the choice of frames.
    """
    order = dwell.argsort(dim=-1, descending=True, stable=True)
    longest_first = dwell.gather(-1, order)
    total = dwell.sum(-1)[..., None]
    # rounding must not turn off a frame of exactly the shortest dwell
    enough = longest_first * total >= shortest * (1 - 1e-6) * longest_first.cumsum(-1)
    count = enough.sum(-1)[..., None].clip(min=1)
    shown = dwell * (order.argsort() < count)
    return shown * (total / shown.sum(-1)[..., None])


def straight_through(continuous: Tensor, shown: Tensor) -> Tensor:
    """The second tensor, exactly, with the gradient of the first (straight through)."""
    # the bracket is exactly 0: it brings a gradient and no rounding
    return shown + (continuous - continuous.detach())


class FixedMasks(nn.Module):
    """Fixed masks; `forward` gives their `Rails` (..., m, N)."""

    difference: Tensor
    total: Tensor | None

    def __init__(self, rails: Tensor) -> None:
        super().__init__()
        both = Rails.of(rails)
        self.register_buffer("difference", both.difference)
        self.register_buffer("total", both.total if both.count == 2 else None)

    def forward(self) -> Rails:
        """Rails of the masks, (..., m, N)."""
        return Rails(self.difference, self.total)


class LearnedMasks(nn.Module):
    """Masks as a differentiable function of free weights that cannot break their light law.

    Rounding to grey levels has the gradient 0, so the gradient of the continuous masks goes
    straight through it.

    Parameters
    ----------
    start : tensor, shape (..., m, N)
        Matrix that the masks begin at; leading axes are replicas.
    light : str
        Name of a light law, from `LIGHT_LAWS`.
    rails : {"dual", "single"}
        Signed masks, or frames of 0 or more.
    levels : int
        Grey levels, dark included; 0 for continuous masks.
    shortest : float
        Shortest frame, as a share of the exposure, for laws with dwells.

    Raises
    ------
    InputError
        For an unknown law, rails that it cannot have, or a start of a wrong sign.
    """

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
        if rails == "single" and bool((start < 0).any()):
            raise InputError("a start of a single rail has negative entries: give 0 or more")
        self.law = light_law(light)
        self.rails_kind = rails
        self.levels = levels
        self.shortest = shortest
        for name, tensor in self.law.weights(start, rails).items():
            if isinstance(tensor, nn.Parameter):
                self.register_parameter(name, tensor)
            else:
                self.register_buffer(name, tensor)

    def forward(self) -> Rails:
        """Rails of the masks, (..., m, N)."""
        rails = self.law.project(self._weights, self.rails_kind, self.shortest)
        if not self.levels:
            return rails
        with torch.no_grad():
            shown = Rails.of(self.law.quantise(rails.stacked, self.levels))
        return rails.map(straight_through, shown)

    def matrix(self) -> Tensor:
        """Difference (..., m, N) of the rails, before rounding to grey levels."""
        return self.law.matrix(self._weights, self.rails_kind, self.shortest)

    def dim(self, factor: Tensor) -> None:
        """Dim the masks by factors (R,) up to 1."""
        with torch.no_grad():
            self.law.dim(self._weights, self.rails_kind, factor)

    @property
    def disjoint(self) -> bool:
        """True if the total is |M| and has its gradient."""
        # Each pixel is then lit on one of two rails alone, and no grey level rounds it
        return self.rails_kind == "dual" and self.law.disjoint and not self.levels

    @property
    def _weights(self) -> dict[str, Tensor]:
        return {**dict(self.named_parameters()), **dict(self.named_buffers())}

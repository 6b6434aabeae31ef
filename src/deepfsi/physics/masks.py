"""Masks as modules: fixed ones, and learned ones that cannot break their light law."""

from typing import Any

import torch
from torch import Tensor, nn

from deepfsi.base.errors import InputError
from deepfsi.camera.names import LightLawName, RailsKind, check_light_law
from deepfsi.physics.laws import light_law, through
from deepfsi.physics.rails import Rails


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

"""Rails of masks: M⁺ and M⁻ of signed masks, or the one rail of masks that are frames.

The physics needs two combinations of them, the difference M⁺ − M⁻ (which gives the mean of a
feature) and the total M⁺ + M⁻ (which gives its photon noise). Masks that learn know these, masks
that are given come as the rails themselves: `Rails` is made of either, and gives both.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from deepfsi.base.errors import InputError
from deepfsi.camera.names import RailsKind


@dataclass(frozen=True, eq=False)
class Rails:
    """Rails of masks (..., m, N), leading axes replicas, as their difference and total."""

    difference: Tensor  # (..., m, N)
    _total: Tensor | None = None
    # The rails that these are of: the two sums alone give M⁺ and M⁻ back but for rounding
    _stacked: Tensor | None = None

    @classmethod
    def of(cls, stacked: Tensor) -> Self:
        """Rails of a tensor (..., 2 or 1, m, N), the positive ones first."""
        if stacked.shape[-3] not in (1, 2):
            raise InputError(f"{stacked.shape[-3]} rails were given: give 2, or 1 of frames")
        if stacked.shape[-3] == 1:
            return cls(stacked[..., 0, :, :], None, stacked)
        plus, minus = stacked.unbind(dim=-3)
        return cls(plus - minus, plus + minus, stacked)

    @property
    def total(self) -> Tensor:
        """M⁺ + M⁻, (..., m, N): the difference itself for one rail."""
        return self.difference if self._total is None else self._total

    @property
    def count(self) -> int:
        """Number of rails, 2 or 1."""
        return 1 if self._total is None else 2

    @property
    def kind(self) -> RailsKind:
        """Kind of the rails, by their number."""
        return "single" if self._total is None else "dual"

    @property
    def masks(self) -> int:
        """m, number of masks."""
        return self.difference.shape[-2]

    @property
    def device(self) -> torch.device:
        """Where the numbers are."""
        return self.difference.device

    @property
    def stacked(self) -> Tensor:
        """M⁺ and M⁻ as one tensor (..., 2, m, N), or the one rail (..., 1, m, N)."""
        if self._stacked is not None:
            return self._stacked
        if self._total is None:
            return self.difference.unsqueeze(-3)
        sums = [self._total + self.difference, self._total - self.difference]
        return torch.stack(sums, dim=-3) / 2

    @property
    def plus(self) -> Tensor:
        """M⁺, (..., m, N), or the one rail."""
        return self.stacked[..., 0, :, :]

    @property
    def minus(self) -> Tensor | None:
        """M⁻, (..., m, N); None for one rail."""
        return None if self._total is None else self.stacked[..., 1, :, :]

    @property
    def combined(self) -> Tensor:
        """Difference and total as one tensor (2, ..., m, N), or the one rail (..., m, N)."""
        if self._total is None:
            return self.difference
        return torch.stack([self.difference, self._total])

    @property
    def apart(self) -> "Rails":
        """Each rail as a mask of its own, those of a mask one after the other: one of 2 m frames.

        One rail is itself.
        """
        if self._total is None:
            return self
        return Rails(self.stacked.transpose(-3, -2).flatten(-3, -2))

    def map(self, change: Callable[..., Tensor], *others: "Rails") -> "Rails":
        """Rails whose difference is `change` of the difference (and the others'), total alike."""
        difference = change(self.difference, *(other.difference for other in others))
        if self._total is None:
            return Rails(difference)
        return Rails(difference, change(self._total, *(other.total for other in others)))

    def to(self, device: str | torch.device) -> "Rails":
        """Rails on a device."""
        return Rails.of(self.stacked.to(device))

"""Rails of masks, detectors that share the device, and the features that a network reads.

D detectors divide the device and see each frame at once, so m masks give m · D readouts of each
rail. Each detector sees only its own pixels of a mask. Products are taken detector by detector,
which costs no more than one product of all pixels.

For this, scenes and masks are *arranged*: the pixels of a detector are neighbours, and dark pixels
fill each detector up to the size P of the largest.

A network reads the difference y⁺ − y⁻ of the rails, or `both`: each rail's counts, mask by mask.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.camera.detectors import DetectorMap
from deepfsi.camera.names import RailsKind, Readout


@dataclass(frozen=True, eq=False)
class Rails:
    """Rails of masks (..., m, N), as their difference and total; leading axes are replicas."""

    difference: Tensor  # (..., m, N)
    _total: Tensor | None = None
    # The rails as given: difference and total give them back only up to rounding
    _stacked: Tensor | None = None

    @classmethod
    def of(cls, stacked: Tensor) -> Self:
        """Rails of a tensor (..., 2 or 1, m, N), the positive ones first."""
        if stacked.shape[-3] == 1:
            return cls(stacked[..., 0, :, :], None, stacked)
        plus, minus = stacked.unbind(dim=-3)
        return cls(plus - minus, plus + minus, stacked)

    @property
    def total(self) -> Tensor:
        """M⁺ + M⁻, (..., m, N), which is the difference of a single rail."""
        return self.difference if self._total is None else self._total

    @property
    def count(self) -> int:
        """2 rails, or 1."""
        return 1 if self._total is None else 2

    @property
    def kind(self) -> RailsKind:
        """``"single"`` or ``"dual"``."""
        return "single" if self._total is None else "dual"

    @property
    def masks(self) -> int:
        """m, number of masks."""
        return self.difference.shape[-2]

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
    def combined(self) -> Tensor:
        """Difference and total as one tensor (2, ..., m, N), or the one rail (..., m, N)."""
        if self._total is None:
            return self.difference
        return torch.stack([self.difference, self._total])

    def map(self, change: Callable[..., Tensor], *others: "Rails") -> "Rails":
        """Rails with `change` applied to the difference, and to the total, of these and others."""
        difference = change(self.difference, *(other.difference for other in others))
        if self._total is None:
            return Rails(difference)
        return Rails(difference, change(self._total, *(other.total for other in others)))

    def to(self, device: str | torch.device) -> "Rails":
        """Rails on a device."""
        return Rails.of(self.stacked.to(device))


@dataclass(frozen=True, eq=False)
class Detection:
    """Which detector sees each pixel, and how two rails become features."""

    readout: Readout = "difference"
    count: int = 1  # D, number of detectors
    labels: Tensor | None = None  # (N,), detector of each pixel, 0 .. D-1

    @classmethod
    def by(cls, detectors: DetectorMap, readout: Readout = "difference") -> "Detection":
        """Detection by detectors that see these cells."""
        labels = detectors.labels
        return cls(readout, detectors.count, None if labels is None else torch.from_numpy(labels))

    @cached_property
    def key(self) -> bytes:
        """Bytes that are equal for equal detectors."""
        return b"" if self.labels is None else self.labels.numpy().tobytes()

    @cached_property
    def _order(self) -> Tensor:
        """Source (D · P,) of each arranged pixel; N for a filler."""
        assert self.labels is not None
        sizes = torch.bincount(self.labels, minlength=self.count)
        order = self.labels.new_full((self.count, int(sizes.max())), len(self.labels))
        for detector, size in enumerate(sizes.tolist()):
            order[detector, :size] = (self.labels == detector).nonzero().flatten()
        return order.flatten()

    @cached_property
    def _arranged(self) -> Tensor:
        """Index (N,) of each pixel in the arrangement."""
        assert self.labels is not None
        indices = torch.empty_like(self.labels)
        real = (self._order < len(indices)).nonzero().flatten()
        indices[self._order[real]] = real
        return indices

    def arrange(self, pixels: Tensor) -> Tensor:
        """Arrange the pixels (..., N) of scenes or masks by detector: (..., D · P)."""
        if self.count == 1:
            return pixels
        order = self._order.to(pixels.device)
        # fillers have the index N: a dark pixel
        if len(order) != pixels.shape[-1]:
            pixels = functional.pad(pixels, (0, 1))
        return pixels.index_select(-1, order)

    def restore(self, arranged: Tensor) -> Tensor:
        """Undo `arrange`: (..., D · P) becomes (..., N)."""
        if self.count == 1:
            return arranged
        return arranged.index_select(-1, self._arranged.to(arranged.device))

    def of_pixels(self, kept: Tensor) -> "Detection":
        """Detection of the pixels where `kept` (N,) is true."""
        if self.labels is None:
            return self
        return replace(self, labels=self.labels[kept.to(self.labels.device)])

    def width(self, rails: int) -> int:
        """Features of a mask with 1 or 2 rails."""
        return self.count * (rails if self.readout == "both" else 1)

    def read_of(self, rails: Rails) -> Rails:
        """Masks with one feature each: `both` has M⁺ and M⁻ of each mask in turn, on one rail."""
        if self.readout == "difference" or rails.count == 1:
            return rails
        return Rails(rails.stacked.transpose(-3, -2).flatten(-3, -2))

    def features(self, counts: Tensor) -> Tensor:
        """Features (..., k) from counts (..., 2 or 1, m · D); k is m times `width`."""
        if counts.shape[-2] == 1:
            return counts[..., 0, :]
        if self.readout == "difference":
            return counts[..., 0, :] - counts[..., 1, :]
        return self._mask_by_mask(counts)

    def totals(self, counts: Tensor) -> Tensor:
        """Counts (..., k) of the rails behind each feature, from (..., 2 or 1, m · D)."""
        return counts.sum(dim=-2) if self.readout == "difference" else self.features(counts)

    def _mask_by_mask(self, rails: Tensor) -> Tensor:
        """Rails (..., 2, m · D) as features (..., m · 2 · D)."""
        return rails.unflatten(-1, (-1, self.count)).transpose(-3, -2).flatten(-3)

    def readouts(self, rails: Rails) -> "Readouts":
        """Readouts of arranged rails (..., m, D · P)."""
        total = rails.total
        both = [total + rails.difference, total - rails.difference]
        frames = torch.stack(both) / 2  # a single rail has a dark M⁻
        # only two arms light a pixel on both rails: they see one frame at once
        arms = (frames > 0).all(dim=0).any(dim=-1)
        time = torch.where(arms, total.amax(dim=-1), frames.amax(dim=-1))
        active = (frames > 0).unflatten(-1, (self.count, -1)).any(dim=-1).flatten(-2)
        first = 2 * torch.arange(rails.masks, device=arms.device).expand(arms.shape)
        frame = torch.stack([first, torch.where(arms, first, first + 1)])
        time, frame = (tensor.repeat_interleave(self.count, dim=-1) for tensor in (time, frame))
        if self.readout == "difference" or rails.count == 1:
            return Readouts(active, time, frame)
        single = [self._mask_by_mask(tensor.movedim(0, -2)) for tensor in (active, time, frame)]
        # each feature is then one rail, and its second is not read out
        return Readouts(*(torch.stack([tensor, torch.zeros_like(tensor)]) for tensor in single))


class Readouts(NamedTuple):
    """Readouts of both rails, positive first, for each of k features."""

    active: Tensor  # (2, ..., k), whether it is read out: dark rails are not
    time: Tensor  # (2, ..., k), share of the exposure
    frame: Tensor  # (2, ..., k), index of its frame, below 2 k

    @property
    def lit(self) -> Tensor:
        """Number (..., k) of rails read out for each feature."""
        return self.active.sum(dim=0)

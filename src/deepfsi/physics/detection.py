"""Rails of masks, detectors on parts of the device, and what a network reads of their counts.

The device's area is divided among D detectors, and all see each frame at once: m masks give m · D
readouts of each rail. A detector sees the part of a mask that lies on its pixels and is dark
elsewhere, so that products are taken part by part and cost what the parts hold.

Scenes and masks are *arranged* for that: pixels of one detector follow one another, and those of
smaller parts are filled up with dark pixels to the size P of the largest.

A network reads the difference y⁺ − y⁻ of the rails, or `both`: each rail's counts, mask by mask.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.base.errors import InputError
from deepfsi.camera.camera import Camera
from deepfsi.camera.detectors import DetectorMap
from deepfsi.camera.names import RailsKind, Readout


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


@dataclass(frozen=True, eq=False)
class Detection:
    """Which detector sees each pixel, and what is read of two rails."""

    readout: Readout = "difference"
    count: int = 1  # D, number of detectors
    labels: Tensor | None = None  # (N,), detector of each pixel, 0 .. D-1

    @classmethod
    def of(cls, camera: Camera, image_shape: tuple[int, ...]) -> "Detection":
        """Detection of scenes of a shape by a camera."""
        return cls.by(camera.detector_map(image_shape), camera.readout)

    @classmethod
    def by(cls, detectors: DetectorMap, readout: Readout = "difference") -> "Detection":
        """Detection by detectors that see these cells."""
        labels = detectors.labels
        return cls(readout, detectors.count, None if labels is None else torch.from_numpy(labels))

    @cached_property
    def key(self) -> bytes:
        """Tells which pixels have the same detectors."""
        return b"" if self.labels is None else self.labels.numpy().tobytes()

    @cached_property
    def _order(self) -> Tensor:
        """Pixel of each arranged one, (D · P,); N for those that are filled up."""
        assert self.labels is not None
        sizes = torch.bincount(self.labels, minlength=self.count)
        order = self.labels.new_full((self.count, int(sizes.max())), len(self.labels))
        for detector, size in enumerate(sizes.tolist()):
            order[detector, :size] = (self.labels == detector).nonzero().flatten()
        return order.flatten()

    @cached_property
    def _places(self) -> Tensor:
        """Place of each pixel among the arranged ones, (N,)."""
        assert self.labels is not None
        places = torch.empty_like(self.labels)
        real = (self._order < len(places)).nonzero().flatten()
        places[self._order[real]] = real
        return places

    def arrange(self, pixels: Tensor) -> Tensor:
        """Scenes or masks (..., D · P), those of each detector together, of (..., N)."""
        if self.count == 1:
            return pixels
        order = self._order.to(pixels.device)
        if len(order) > pixels.shape[-1]:
            pixels = functional.pad(pixels, (0, 1))
        return pixels.index_select(-1, order)

    def restore(self, arranged: Tensor) -> Tensor:
        """Inverse of `arrange`: (..., N) of (..., D · P)."""
        if self.count == 1:
            return arranged
        return arranged.index_select(-1, self._places.to(arranged.device))

    def of_pixels(self, kept: Tensor) -> "Detection":
        """Detection of some of the pixels, those where (N,) is true."""
        if self.labels is None:
            return self
        return replace(self, labels=self.labels[kept.to(self.labels.device)])

    def width(self, rails: int) -> int:
        """Numbers that a network reads of each mask of so many rails."""
        return self.count * (rails if self.readout == "both" else 1)

    def read_of(self, rails: Rails) -> Rails:
        """Masks whose counts a network reads as one: for `both` each rail is one, of 2 m frames."""
        return rails if self.readout == "difference" else rails.apart

    def features(self, counts: Tensor) -> Tensor:
        """Features (..., k) of counts of rails (..., 2 or 1, m · D): k is `width` · m."""
        if counts.shape[-2] == 1:
            return counts[..., 0, :]
        if self.readout == "difference":
            return counts[..., 0, :] - counts[..., 1, :]
        return self._mask_by_mask(counts)

    def totals(self, counts: Tensor) -> Tensor:
        """Counts (..., k) in what is read of counts of rails (..., 2 or 1, m · D)."""
        return counts.sum(dim=-2) if self.readout == "difference" else self.features(counts)

    def _mask_by_mask(self, rails: Tensor) -> Tensor:
        """Numbers (..., m · 2 · D) of rails (..., 2, m · D)."""
        return rails.unflatten(-1, (-1, self.count)).transpose(-3, -2).flatten(-3)

    def frames(self, rails: Rails) -> Tensor:
        """Number of the frame (rails, ..., m · D) in which each rail of masks is counted."""
        apart = replace(self, readout="difference")
        return apart.readouts(rails).frame[: rails.count]

    def readouts(self, rails: Rails) -> "Readouts":
        """Readouts of rails of masks (..., m, D · P), arranged."""
        total = rails.total
        both = [total + rails.difference, total - rails.difference]
        frames = torch.stack(both) / 2  # M⁻ of one rail is dark
        arms = (frames > 0).all(dim=0).any(dim=-1)
        time = torch.where(arms, total.amax(dim=-1), frames.amax(dim=-1))
        active = (frames > 0).unflatten(-1, (self.count, -1)).any(dim=-1).flatten(-2)
        first = 2 * torch.arange(rails.masks, device=arms.device).expand(arms.shape)
        frame = torch.stack([first, torch.where(arms, first, first + 1)])
        time, frame = (tensor.repeat_interleave(self.count, dim=-1) for tensor in (time, frame))
        if self.readout == "difference" or rails.count == 1:
            return Readouts(active, time, frame)
        one = [self._mask_by_mask(tensor.movedim(0, -2)) for tensor in (active, time, frame)]
        return Readouts(*(torch.stack([tensor, torch.zeros_like(tensor)]) for tensor in one))


class Readouts(NamedTuple):
    """Rails of masks as detectors read them, the positive ones first."""

    active: Tensor  # (2, ..., k), which are not dark by construction, and are read out
    time: Tensor  # (2, ..., k)
    frame: Tensor  # (2, ..., k), number of the frame in which each is read, below 2 k

    @property
    def lit(self) -> Tensor:
        """Number of rails that are read out for each feature, (..., k)."""
        return self.active.sum(dim=0)

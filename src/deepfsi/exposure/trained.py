"""Exposures of trained designs, and the counts and dwells so far.

One class for each kind of `design.exposure`, and nobody but these asks which one a design has:
`FixedExposure` and `PatchExposure` here, `conditioned.ConditionedExposure`, `looks.LooksExposure`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import prod
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from deepfsi.base import InputError
from deepfsi.camera import LIGHT_LAWS, LightLawName
from deepfsi.designfile import ReadoutDistribution
from deepfsi.exposure.readout_fit import find_distribution
from deepfsi.jobs import ExposureEntry, FixedEntry, PatchesEntry, cut_patches
from deepfsi.networks.classifiers import Mlp
from deepfsi.physics import Detection, Rails, Scanner, light_law

Read = Callable[[Tensor, Tensor | float], Tensor]
"""From expected counts (..., rails, m · D), and dwells over the usual ones of the same shape, to
features (..., k) in counts."""

Show = Callable[[Tensor], tuple[Tensor, Tensor]]
"""From dwells (..., q) to features (..., k) over the budget, and the dwells really shown."""


@dataclass(frozen=True)
class Observation:
    """Counts and dwells of an exposure so far."""

    # (..., k): What is read of the first masks over the budget (`detection`), of all looks together
    features: Tensor
    # (..., q): Share of the whole exposure that each frame had, where dwells are chosen; sums to 1
    # after the last look
    dwell: Tensor | None = None

    def inputs(self, mean: Tensor, std: Tensor) -> Tensor:
        """Standardised features (..., k), and the dwells (..., k + q) where they are chosen."""
        # Mean and std (..., k) are those of the features: where dwells are chosen, of features
        # whose frames all have the same dwell, 1 / q
        count = self.features.shape[-1]
        if count < mean.shape[-1]:
            mean, std = mean[..., :count], std[..., :count]
        if self.dwell is None:
            return (self.features - mean) / std
        dwells = self.dwell.shape[-1]
        relative = self.dwell * dwells
        each = relative.repeat_interleave(count // dwells, dim=-1) if count > dwells else relative
        return torch.cat([(self.features - each * mean) / std, relative / 3], dim=-1)


class TrainedExposure:
    """Base of the kinds of exposure: every mask is shown once, for a dwell that is its own."""

    kind: str  # name in the design file
    chooses: ClassVar[bool] = False  # whether the counts so far choose dwells
    comparable: ClassVar[bool] = True  # whether counts can be held against those of the training
    width: int = 1  # features of each mask, for nested masks
    looks: int = 1  # K, number of looks
    used: float = 1.0  # share of the light law that the masks take within the whole sequence
    network: Mlp | None = None  # A network besides the classifier

    def entry(self) -> ExposureEntry:
        """Entry of the design file's header, of which `restored` makes the kind again."""
        raise NotImplementedError

    @classmethod
    def restored(
        cls,
        entry: ExposureEntry,
        weights: dict[str, Tensor],
        features: int,
        rails: Rails,
        light: LightLawName,
    ) -> "TrainedExposure":
        """The kind of an entry, with its tensors of a design file; an error where they differ."""
        return cls(**entry.model_dump(exclude={"kind"}))

    def to(self, device: str | torch.device) -> "TrainedExposure":
        """The kind on a device."""
        return self

    def check(self, rails: Rails, light: LightLawName, image_shape: tuple[int, ...]) -> None:
        """Raise `ValueError` unless rails can be exposed so; parameters as for `Design`."""

    @property
    def weights(self) -> dict[str, Tensor]:
        """Tensors of the design file besides rails, statistics and classifier."""
        return {} if self.network is None else self.network.state_dict()

    def quantised(
        self, rails: Tensor, light: LightLawName, levels: int
    ) -> tuple[Tensor, "TrainedExposure"]:
        """Rails (2 or 1, m, N) in grey levels, and the kind that shows them."""
        return light_law(light).quantise(rails, levels), self

    def front(self, rails: Tensor) -> Tensor:
        """Rails (2 or 1, m, N) of the scanner that reads scenes."""
        return rails

    def rates(self, scanner: Scanner, scenes: Tensor) -> Tensor:
        """Expected counts (..., rails, m · D) of photons (..., N)."""
        return scanner.rates(scenes)

    def placed(self, rates: Tensor, generator: torch.Generator) -> Tensor:
        """Expected counts (..., rails, m · D) of exposures of scenes with such `rates`."""
        return rates

    def drawing(
        self, matrix: Tensor, mask_shape: tuple[int, ...]
    ) -> tuple[Tensor, tuple[int, ...]]:
        """Picture of a sensing matrix (m, N): its masks, and the shape of one."""
        return matrix, mask_shape

    def input_count(self, features: int) -> int:
        """Number of the classifier's inputs for k features."""
        return features

    def tokens(self, image_shape: tuple[int, ...]) -> int:
        """Number of parts of an image that are exposed by themselves."""
        return prod(image_shape) // prod(self.mask_shape(image_shape))

    def patch_axis(self, image_shape: tuple[int, ...]) -> tuple[int, ...]:
        """Axis (P,) of counts that comes before those of a patch; none of whole images."""
        return ()

    def mask_shape(self, image_shape: tuple[int, ...]) -> tuple[int, ...]:
        """Shape of a mask for images of a shape."""
        return image_shape

    def cut(self, scenes: Tensor, image_shape: tuple[int, ...]) -> Tensor:
        """Scenes (..., N) as the masks see them."""
        return scenes

    def condition(self, inputs: Tensor, photons: Tensor | float) -> Tensor:
        """Inputs of the classifier, from those of `Observation.inputs` and the budget."""
        return inputs

    def expose(
        self, read: Read, rates: Tensor, photons: float, mean: Tensor, std: Tensor
    ) -> Iterator[Observation]:
        """Exposures at each stop: after each number of masks that do, or after each look."""
        # rates (..., rails, m · D); mean, std (k,)
        features = read(rates * photons, 1.0) / photons
        masks = features.shape[-1] // self.width
        for shown in range(self.fewest_masks(masks), masks + 1):
            yield Observation(features[..., : shown * self.width])

    def shown(self, rates: Tensor, seen: Observation) -> Tensor:
        """Expected counts (..., rails, m · D) of an exposure for a budget of one photon."""
        # rates (..., rails, m · D)
        return rates

    def expose_live(self, show: Show, mean: Tensor, std: Tensor) -> Iterator[Observation]:
        """Exposures after each look at a camera, or `InputError` if dwells are fixed."""
        # Parameters as for `expose`
        raise InputError(
            "the dwells of this design are fixed: show all masks and use `classify`, or learn a "
            "design with {looks}",
            setting="looks",
        )

    def compared(self, rails: int, readouts: int) -> tuple[tuple[int, int], int]:
        """Readouts (rails, m) that counts are compared in, and looks; 0 of fixed dwells."""
        return (rails, readouts), 0

    def distribution(
        self,
        rates: Tensor,
        lit: Tensor,
        labels: np.ndarray,
        classes: int,
        detection: Detection,
        mean: Tensor,
        std: Tensor,
    ) -> ReadoutDistribution | None:
        """Distribution of the readouts of scenes, None if there are too few of a class."""
        # rates (n, rails, m · D) as from `Design.rates`; lit (n,), the scenes' light for a budget
        # of one photon; mean, std (k,)
        return find_distribution(rates, labels, classes)

    def fewest_masks(self, masks: int) -> int:
        """Smallest number of first masks, of m, that can be classified alone."""
        return masks

    def count_stops(self, masks: int) -> int:
        """Numbers of masks, of m, or of looks, after which an exposure can be classified."""
        return masks - self.fewest_masks(masks) + 1

    def stop_place(self, seen: Observation) -> Tensor | int:
        """Place of an exposure so far among these numbers, from 0."""
        masks = seen.features.shape[-1] // self.width
        return masks - self.fewest_masks(masks)

    def budget(self, photons: Tensor) -> Tensor:
        """Budget (..., 1) of an exposure, of that of each of its parts."""
        return photons

    def using(self, used: float) -> "TrainedExposure":
        """The kind for masks that take another share of the light law, see `used`."""
        return self

    def stops(self, rails: Rails, light: LightLawName) -> tuple[tuple[int, ...], np.ndarray]:
        """Numbers of masks or looks after which an exposure may stop, and the share taken then."""
        # Raises `InputError` if it may stop nowhere before its end, or that saves nothing
        raise InputError(
            "this design needs all its masks for an answer: learn nested ones with {nested}, or "
            "several looks with {looks}",
            setting=("nested", "looks"),
        )

    @property
    def dwell_words(self) -> str:
        """Words on `mask_dwells`."""
        return "share of the exposure"

    def mask_dwells(
        self, rails: Rails, light: LightLawName, mean: Tensor, std: Tensor
    ) -> Tensor | None:
        """Share (m,) of the exposure that each mask is shown; None where the law has no dwells."""
        # Of several looks those of the first, which are the same for every scene
        if not LIGHT_LAWS[light].one_device:
            return None
        shares = light_law(light).used(rails.stacked)
        return torch.diff(shares, prepend=shares.new_zeros(1))

    def check_frames(self) -> None:
        """Raise `InputError` unless frames of one device, or one graph, can expose so."""

    def check_device(self) -> None:
        """Raise `InputError` unless frames of one device can expose so."""
        self.check_frames()

    def check_noise(self, noise: str) -> None:
        """Raise `InputError` unless the exposure can be tested under a noise."""

    def check_alone(self) -> None:
        """Raise `InputError` if counts of masks alone are not compared with the training."""

    def check_dwell(self, given: bool) -> None:
        """Raise `InputError` if dwells are given and not needed, or needed and not given."""
        if given:
            raise InputError(
                "dwells go with a design that chooses them, and only with it: leave dwell out"
            )


@dataclass(frozen=True)
class FixedExposure(TrainedExposure):
    """Exposure of which all masks are needed, each with its own dwell."""

    kind = "fixed"

    def entry(self) -> FixedEntry:
        """Entry of the design file's header."""
        return FixedEntry()


@dataclass(frozen=True)
class PatchExposure(TrainedExposure):
    """Exposure of fixed dwells, with a detector for each patch of an image.

    Features have the shape (..., P, m), and a budget is of the whole image.
    """

    side: int  # of a patch, pixels
    kind = "patches"
    comparable: ClassVar[bool] = False

    def entry(self) -> PatchesEntry:
        """Entry of the design file's header."""
        return PatchesEntry(side=self.side)

    def check(self, rails: Rails, light: LightLawName, image_shape: tuple[int, ...]) -> None:
        """Raise `ValueError` unless rails are of patches; parameters as for `Design`."""
        height, width = image_shape
        if rails.difference.shape[-1] != self.side**2 or height % self.side or width % self.side:
            raise ValueError("masks are not of a patch")

    def mask_shape(self, image_shape: tuple[int, ...]) -> tuple[int, ...]:
        """Shape of a mask, that of a patch."""
        return self.side, self.side

    def patch_axis(self, image_shape: tuple[int, ...]) -> tuple[int, ...]:
        """Axis (P,) of counts, in which patches follow row by row."""
        return (self.tokens(image_shape),)

    def cut(self, scenes: Tensor, image_shape: tuple[int, ...]) -> Tensor:
        """Patches (..., P, N) of images (..., H · W), as the masks see them."""
        return cut_patches(scenes, image_shape, self.side)

    def budget(self, photons: Tensor) -> Tensor:
        """Budget (..., 1) of an image: every patch has it."""
        return photons[..., 0, :] if photons.ndim > 1 else photons

    def check_frames(self) -> None:
        """Raise `InputError`: frames are for whole images."""
        raise InputError(
            "this design is of image patches, each with a detector of its own, which frames of "
            "one device or one graph cannot: use Design.classify"
        )

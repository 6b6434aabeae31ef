"""Exposures of images that are seen patch by patch, with a detector for each patch and mask."""

from dataclasses import dataclass
from math import prod
from typing import ClassVar

from torch import Tensor

from deepfsi.exposure.kind import MaskExposure, Use
from deepfsi.exposure.training import ExposureTraining, JobGroup, deviation
from deepfsi.physics.scanner import Scanner, project
from deepfsi.physics.training_noise import Draws
from deepfsi_paper.patches.settings import OF_PATCHES, Patches, PatchesEntry, cut_patches


@dataclass(frozen=True, eq=False, kw_only=True)
class PatchExposure(MaskExposure):
    """Exposure of fixed dwells, with a detector for each patch of an image.

    Features have the shape (..., P, m), and a budget is of the whole image.
    """

    entry: PatchesEntry
    comparable: ClassVar[bool] = False
    refusals: ClassVar[dict[Use, str]] = {
        "frames": OF_PATCHES,
        "graph": OF_PATCHES,
        "page": "this design is of image patches, each with a detector of its own, and a page "
        "shows one device: give a design of whole scenes",
    }

    def __post_init__(self) -> None:
        """Raise `ValueError` unless the masks are of patches."""
        height, width = self.image_shape
        side = self.entry.side
        if self.rails.difference.shape[-1] != side**2 or height % side or width % side:
            raise ValueError("masks are not of a patch")

    @property
    def part_axis(self) -> tuple[int, ...]:
        """Axis (P,) of counts, in which patches follow row by row."""
        return (prod(self.image_shape) // self.entry.side**2,)

    def rates(self, scanner: Scanner, scenes: Tensor) -> Tensor:
        """Expected counts (..., P, rails, m) of the patches of images (..., H · W)."""
        return super().rates(scanner, cut_patches(scenes, self.image_shape, self.entry.side))


class PatchTraining(ExposureTraining):
    """Masks of patches, and the features of every patch of images; one job alone trains on them."""

    def __init__(self, group: JobGroup) -> None:
        super().__init__(group)
        asked = self.job.exposure
        assert isinstance(asked, Patches)
        self.entries = [PatchesEntry(side=asked.patch)]
        self.masks = self.learned_masks() if self.learns else self.fixed_masks()

    def prepare(self) -> None:
        """Cut images (n, P, N) to patches of the pixels that the masks have."""
        lit = self.scenes.varying
        patches = self.scenes.full.view(-1, self.parts, self.scenes.data.pixels)
        self.x = patches[..., lit] if self.learns and not lit.all() else patches
        self.mean = self.x.mean(dim=(0, 1))
        self.scanner = Scanner(self.masks, self.noise.of_jobs(slice(1)).kind)
        self.photons = float(self.noise.gain)

    def inputs(self, draws: Draws) -> Tensor:
        """Features (B, 1, P, m), standardised in their batch."""
        [stream] = draws.streams
        counts = self.scanner(self.x[stream.rows] * self.photons, stream.generator)
        counts = counts / self.photons
        features = (counts - project(self.mean, self.masks().difference)).squeeze(2)
        over = (0, 1) if self.scale == "each" else (0, 1, 2)
        std = deviation(features.square().mean(dim=over), "each")
        return (features / std).unsqueeze(1)

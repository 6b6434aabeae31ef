"""Settings of images seen patch by patch, of their transformer, and entries of design files."""

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from deepfsi.base.errors import InputError
from deepfsi.base.models import Count, StrictModel
from deepfsi.camera.names import LIGHT_LAWS, find_noise
from deepfsi.datasets.dataset import Dataset
from deepfsi.jobs.exposures import Entry, Exposure
from deepfsi.jobs.training import MOST_LAYERS, ClassifierFacts

if TYPE_CHECKING:
    from deepfsi.jobs.job import Job

OF_PATCHES = (
    "this design is of image patches, each with a detector of its own, which frames of one device "
    "or one graph cannot: use Design.classify"
)
"""Why patches are not for frames, or a graph."""


class PatchesEntry(Entry):
    """Exposure of fixed dwells, with a detector for each patch of an image.

    Attributes
    ----------
    side : int
        Of a patch, pixels.
    """

    side: Count
    kind: Literal["patches"] = "patches"

    features: ClassVar[str] = "patches"
    no_frames: ClassVar[str] = OF_PATCHES
    restored_by: ClassVar[str] = "deepfsi_paper.patches.exposure:PatchExposure"

    def mask_shape(self, image_shape: tuple[int, ...]) -> tuple[int, ...]:
        """Shape of a mask, that of a patch."""
        return self.side, self.side


class Patches(Exposure):
    """An image seen patch by patch: the same masks for all patches, read by a transformer.

    A patch has a detector for each mask, and a budget is of the whole image, which the patches
    share as they share its light.

    Examples
    --------
    >>> import deepfsi
    >>> seen = Patches(patch=4)
    >>> deepfsi.Job(masks=8, photons=1e4, camera="paper", exposure=seen).training.classifier
    'vit'
    """

    training: ClassVar[dict[str, Any]] = {
        "start": "pca",
        "classifier": "vit",
        "epochs": 15,
        "batch": 100,
        "lr": 2e-3,
        "mask_lr": 2e-2,
        "decay": 0.05,
    }

    side_by_side: ClassVar[bool] = False
    features: ClassVar[str] = "patches"
    trained_by: ClassVar[str] = "deepfsi_paper.patches.exposure:PatchTraining"
    entry_type: ClassVar[type[Entry]] = PatchesEntry
    allow_bf16: ClassVar[bool] = False

    patch: int = Field(ge=2, description="side of a patch, pixels, of an image seen by patches")

    def view(self, data: Dataset) -> Dataset:
        """Every patch of the training images as a scene of its own; no test scenes."""
        if len(data.image_shape) != 2:
            raise InputError(f"{data.name} holds no images: patches need two sides")
        patches = cut_patches(np.asarray(data.x_train), data.image_shape, self.patch)
        return replace(
            data,
            x_train=patches.reshape(-1, self.patch**2),
            y_train=np.repeat(data.y_train, patches.shape[1], axis=0),
            x_test=np.zeros((0, self.patch**2), np.float32),
            y_test=data.y_test[:0],
            image_shape=(self.patch, self.patch),
        )

    def allow_bf16_networks(self, device: str, wide: bool) -> bool:
        """True on a GPU: a processor is slower with it at a transformer's size."""
        return device == "cuda"

    def faults(self, job: "Job") -> Iterator[str]:
        """Optics that no patch has, and noise that was not tried."""
        camera = job.optics
        if LIGHT_LAWS[camera.light].in_turn:
            yield "a patch has a detector for each readout: give the light law column"
        if job.facts.seeded or job.facts.learned_under or job.facts.is_custom:
            yield f"{job.design} is not for patches: give deepfsi or a named design"
        if not find_noise(job.noise).stands_for or camera.mask_levels((self.patch, self.patch)):
            yield "patches are trained under photon noise, with continuous masks"


def cut_patches(scenes: Any, image_shape: tuple[int, ...], side: int) -> Any:
    """Patches (..., P, side²) of images (..., H · W), row by row."""
    height, width = image_shape
    if height % side or width % side:
        raise InputError(
            f"images of {height}x{width} pixels cannot be cut in patches of {side}x{side}: give a "
            "side that divides both"
        )
    images = scenes.shape[:-1]
    blocks = scenes.reshape(*images, height // side, side, width // side, side)
    return blocks.swapaxes(-3, -2).reshape(*images, -1, side * side)


class VitEntry(StrictModel, strict=True):
    """Entry of the header for a `Vit`: its parameters of the same names.

    Attributes
    ----------
    patches : int
        Patches of an image.
    width : int
        Numbers that stand for a patch.
    depth : int
        Transformer blocks.
    heads : int
        Attention heads of a block.
    hidden : int
        Hidden units of a block's feed-forward network.
    """

    kind: Literal["vit"]
    patches: Count
    width: Count
    depth: int = Field(ge=1, le=MOST_LAYERS)
    heads: Count
    hidden: Count

    @property
    def parts(self) -> int:
        """P."""
        return self.patches


VIT = ClassifierFacts(
    sizes=("width", "depth", "heads", "hidden"),
    features=Patches.features,
    entry=VitEntry,
    network="deepfsi_paper.patches.transformer:Vit",
)
"""The transformer."""

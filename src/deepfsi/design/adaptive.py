"""A design of adaptive masks: what is known of scenes and how they are looked at, in one file."""

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepfsi.base import DESIGN_ENDINGS, InputError, check_ending, plain_keywords, write_atomically
from deepfsi.camera import Camera
from deepfsi.design.design import Design
from deepfsi.designfile import (
    AdaptiveHeader,
    DesignFile,
    SceneModel,
    TrainingScenes,
    damaged_design,
    find_design,
    trained_budgets,
    trained_camera,
)
from deepfsi.exposure import ScenePrior
from deepfsi.exposure.adaptive import AT_ONCE, UsualMisfit, look_at
from deepfsi.exposure.posterior import AdaptivePosterior, LookOptics
from deepfsi.jobs import AdaptiveMasks
from deepfsi.physics import Detection, library_defaults

MOST_EXPOSURES = 32
"""Exposures that are computed at a time, at most: a thousand of them take twice as long each."""


class Known(NamedTuple):
    """Masks of a look of exposures, and what is known after it."""

    masks: Tensor  # (b, N) of 0 and 1
    state: AdaptivePosterior


@dataclass(repr=False, eq=False)
class AdaptiveDesign:
    """Adaptive masks: what is known of scenes, and how the counts so far make the next mask.

    Attributes
    ----------
    prior : ScenePrior
        Of scenes: the training scenes, in components.
    settings : AdaptiveMasks
        Looks, and the share of the exposure that each takes.
    image_shape : tuple of int
    classes : tuple of str
    shares : tensor, shape (K,)
        Share of the budget that each look counts, in the mean over training scenes.
    usual_misfit : UsualMisfit or None
        How far counts of training scenes are from those expected; None of few training scenes.
    info : dict
        Provenance: how it was made, on which data, with which versions. JSON types only.
    training_scenes : TrainingScenes, optional
        Hashes of the scenes that it was made with; None of files of older versions.

    Examples
    --------
    >>> import deepfsi
    >>> design = deepfsi.learn("digits", camera="dmd", design="adaptive", masks=8, photons=1e4)
    >>> [result] = deepfsi.evaluate(design, "digits", 1e4, draws=1)
    >>> result.accuracy > 0.85
    True
    """

    prior: ScenePrior
    settings: AdaptiveMasks
    image_shape: tuple[int, ...]
    classes: tuple[str, ...]
    shares: Tensor
    usual_misfit: UsualMisfit | None = None
    info: dict[str, Any] = field(default_factory=dict)
    training_scenes: TrainingScenes | None = None

    name: ClassVar = "adaptive"
    temperatures: ClassVar[None] = None  # its probabilities are a posterior's, its prior's if any
    values: ClassVar[None] = None  # it answers classes

    def __repr__(self) -> str:
        return (
            f"<AdaptiveDesign: {self.masks} looks, {len(self.prior)} scenes known, "
            f"{len(self.classes)} classes>"
        )

    @property
    def masks(self) -> int:
        """Number of looks, K: each shows a mask of its own."""
        return self.settings.looks

    @property
    def camera(self) -> Camera:
        """The camera that it was made for."""
        camera = trained_camera(self.info)
        if camera is None:
            raise InputError("this design does not say which camera it is for: make it again")
        return camera

    @property
    def trained_budgets(self) -> tuple[float, float] | None:
        """Lowest and highest budget of the training: it has one."""
        return trained_budgets(self.info)

    @property
    def detection(self) -> Detection:
        """Detectors on parts of the device."""
        return Detection.of(self.camera, self.image_shape)

    @cached_property
    def scene_model(self) -> SceneModel | None:
        """Model of the prior's scenes, against which the view of a camera's runs is tested."""
        return self.prior.model

    def scanner(self) -> Camera:
        """The camera itself: its optics, and its dark counts."""
        return self.camera

    def looks(
        self, x: Tensor, photons: float, generator: torch.Generator, camera: Camera | None = None
    ) -> Iterator[Known]:
        """Looks at scenes, one after another, with counts drawn of a budget.

        Parameters
        ----------
        x : tensor, shape (b, N)
            Reflectance.
        photons : float
            Budget Φ.
        generator : torch.Generator
        camera : Camera, optional
            Whose dark counts are in force; its own unless given.

        Raises
        ------
        InputError
            If the camera shows no binary masks, or has read noise.
        """
        optics = LookOptics.of(camera or self.camera, self.image_shape, photons)
        state = AdaptivePosterior(self.prior, len(x), optics)
        for share in self.settings.shares:
            masks, counts, _ = look_at(state, x, share, generator)
            state.update(masks, counts, share)
            yield Known(masks, state)

    def at_once(self, x: Tensor) -> tuple[Tensor, ...]:
        """Scenes (n, N) in parts that the memory holds the likelihoods of, and the caches masks."""
        return x.split(max(1, min(MOST_EXPOSURES, AT_ONCE // len(self.prior))))

    @library_defaults()
    def looks_at(self, scene: np.ndarray, photons: float, seed: int = 0) -> tuple[np.ndarray, ...]:
        """One exposure of a scene (N,): masks and mean scenes (K, N), and chances (K, C).

        Parameters
        ----------
        scene : array, shape (N,)
            Reflectance.
        photons : float
            Budget Φ.
        seed : int
            Of the noise.
        """
        generator = torch.Generator().manual_seed(seed)
        with torch.no_grad():
            looks = self.looks(torch.from_numpy(scene)[None], photons, generator)
            each = [(look.masks[0], look.state.scene[0], look.state.chances[0]) for look in looks]
        return tuple(
            np.stack([part.numpy() for part in parts]) for parts in zip(*each, strict=True)
        )

    def quantised(self, levels: int) -> "AdaptiveDesign":
        """The design as it is: its masks are ON and OFF, which any device shows."""
        return self

    def to(self, device: str | torch.device) -> "AdaptiveDesign":
        """The design as it is: it is computed on the processor."""
        return self

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write one safetensors file, all or nothing; its name ends in ``.safetensors``."""
        check_ending(path, DESIGN_ENDINGS)
        return write_atomically(path, self.to_bytes())

    @library_defaults()
    def to_bytes(self) -> bytes:
        """Content of the design file."""
        header = AdaptiveHeader(
            deepfsi=version("deepfsi"),
            settings=self.settings,
            image_shape=self.image_shape,
            classes=self.classes,
            info=self.info,
        )
        arrays = self.prior.arrays | {"shares": self.shares.numpy()}
        for part in (self.usual_misfit, self.training_scenes):
            arrays |= {} if part is None else part.arrays
        return DesignFile(header, arrays).to_bytes()

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "AdaptiveDesign":
        """Read a design file, or raise `InputError` if it is no whole one of adaptive masks."""
        return cls.of_file(DesignFile.read(path))

    @classmethod
    @library_defaults()
    def of_file(cls, file: DesignFile) -> "AdaptiveDesign":
        """Design of a file, or `InputError` if it is not of adaptive masks."""
        header, arrays = file.header, file.arrays
        try:
            if not isinstance(header, AdaptiveHeader):
                raise TypeError(header)
            return cls(
                prior=ScenePrior.restored(arrays),
                settings=header.settings,
                image_shape=header.image_shape,
                classes=header.classes,
                shares=torch.from_numpy(arrays["shares"]),
                usual_misfit=UsualMisfit.restored(arrays, header.settings.looks),
                info=header.info,
                training_scenes=file.training_scenes,
            )
        except (KeyError, TypeError, ValueError, RuntimeError, IndexError) as error:
            raise damaged_design(file.path or "this", file.text or "") from error


AnyDesign = Design | AdaptiveDesign
"""A design whose masks are known before, or one that makes them while it looks."""


@plain_keywords()
def load_design(
    path: str | os.PathLike[str], device: str | torch.device = "cpu", *, trust: bool = False
) -> AnyDesign:
    """Open a design file: a `Design`, or an `AdaptiveDesign` if its masks are adaptive.

    Parameters
    ----------
    path : str or path
        Design file; or the name of a published design, such as ``"dmd-mnist"``, in the folder or at
        the address of the environment variable `DEEPFSI_DESIGNS` (`published.find_design`).
    device : str or torch.device
        Adaptive masks are computed on the processor.
    trust : bool
        As of `Design.load`: run the factory of a classifier of one's own, if there is one.

    Raises
    ------
    InputError
        If the file is missing, damaged, truncated, not a design, or of a newer schema; if a
        published design is unknown, out of reach, or has another hash than its index says.

    Examples
    --------
    >>> import deepfsi, tempfile
    >>> few = deepfsi.Training(epochs=1)
    >>> design = deepfsi.learn("digits", photons=1e4, masks=6, training=few)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     deepfsi.load_design(design.save(f"{folder}/d.safetensors")).masks
    6
    """
    file = DesignFile.read(find_design(path))
    if isinstance(file.header, AdaptiveHeader):
        return AdaptiveDesign.of_file(file)
    return Design.of_file(file, device, trust=trust)

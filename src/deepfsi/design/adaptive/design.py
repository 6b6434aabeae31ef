"""A design of adaptive masks: what is known of scenes and how they are looked at, in one file."""

import json
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field
from safetensors.numpy import save as to_bytes
from torch import Tensor

from deepfsi.base.errors import as_input_error
from deepfsi.base.files import DESIGNS, check_ending, write_atomically
from deepfsi.camera.camera import Camera
from deepfsi.design.adaptive.exposures import AT_ONCE, expose, look_at
from deepfsi.design.adaptive.misfit import UsualMisfit
from deepfsi.design.adaptive.posterior import LEAST_WEIGHT, AdaptivePosterior, LookOptics
from deepfsi.design.adaptive.prior import ScenePrior
from deepfsi.design.artifact import Design
from deepfsi.design.confidence import logits_at_stops, stops_of
from deepfsi.design.evaluation import Answering, Guess, answering
from deepfsi.design.file_content import SCHEMA, Info, damaged, is_adaptive, read_content
from deepfsi.design.published import find_design
from deepfsi.design.training_data import TrainingScenes
from deepfsi.design.view_test import SceneModel
from deepfsi.jobs.entries import AdaptiveMasks
from deepfsi.optics.detection import Detection
from deepfsi.optics.surroundings import library_defaults

MOST_EXPOSURES = 32
"""Exposures that are computed at a time, at most: a thousand of them take twice as long each."""

SLACK = 1e-3
"""What rounding may change of a reflectance, or of a sum of them, relative."""

MOST_REFLECTANCE, MOST_SPREAD = 1e3, 1e2
"""Bounds of what a file may hold: a sum of all components, and the spread of a prior."""


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
        with as_input_error("the design's camera", "make it again"):
            return Camera.restored(self.info["job"]["camera"])

    @property
    def detection(self) -> Detection:
        """Detectors on parts of the device."""
        return self.camera.detection(self.image_shape)

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
        check_ending(path, DESIGNS)
        return write_atomically(path, self.to_bytes())

    @library_defaults()
    def to_bytes(self) -> bytes:
        """Content of the design file."""
        header = _Header(
            settings=self.settings,
            image_shape=self.image_shape,
            classes=self.classes,
            info=self.info,
        )
        words = header.model_dump(mode="json", by_alias=True)
        arrays = self.prior.arrays | {"shares": self.shares.numpy()}
        if self.usual_misfit is not None:
            arrays |= self.usual_misfit.arrays
        if self.training_scenes is not None:
            arrays |= self.training_scenes.tensors
        whole = {name: np.ascontiguousarray(each) for name, each in arrays.items()}
        return to_bytes(whole, metadata={"deepfsi": json.dumps(words)})

    @classmethod
    @library_defaults()
    def load(cls, path: str | os.PathLike[str]) -> "AdaptiveDesign":
        """Read a design file, or raise `InputError` if it is no whole one of adaptive masks."""
        text, arrays = read_content(path)
        try:
            header = _Header.model_validate_json(text)
            _check(header, arrays)
            prior = ScenePrior.restored(arrays)
            shares = torch.from_numpy(arrays["shares"])
            usual = UsualMisfit.restored(arrays, header.settings.looks)
            trained = TrainingScenes.restored(arrays)
        except (KeyError, TypeError, ValueError, RuntimeError, IndexError) as error:
            raise damaged(path, text) from error
        known = header.settings, header.image_shape, header.classes
        return cls(prior, *known, shares, usual, header.info, trained)


AnyDesign = Design | AdaptiveDesign
"""A design whose masks are known before, or one that makes them while it looks."""


class _Header(BaseModel):
    """Header of a file of adaptive masks: all of the design but its arrays."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    schema_number: Literal[1] = Field(SCHEMA, alias="schema")
    deepfsi: str = version("deepfsi")
    name: Literal["adaptive"] = "adaptive"
    settings: AdaptiveMasks
    image_shape: tuple[Annotated[int, Field(ge=1)], ...]
    classes: tuple[str, ...]
    info: Info


def _check(header: _Header, arrays: Mapping[str, np.ndarray]) -> None:
    """Raise `ValueError` unless arrays are of a prior as `ScenePrior.arrays` gives it."""
    (scenes, parts), pixels = arrays["levels"].shape, math.prod(header.image_shape)
    shapes = {
        "mean": ((pixels,), np.float32),
        "components": ((parts, pixels), np.float32),
        "steps": ((parts,), np.float32),
        "levels": ((scenes, parts), np.int8),
        "members": ((scenes,), np.int32),
        "sizes": ((len(header.classes),), np.int64),
        "numbers": ((2,), np.float64),
        "shares": ((header.settings.looks,), np.float32),
    }
    for name, (shape, kind) in shapes.items():
        held = arrays[name]
        if held.shape != shape or held.dtype != kind or not np.isfinite(held).all():
            raise ValueError(f"{name} is not of this design")
    if len(arrays.get("temperature_logs", arrays["shares"])) != header.settings.looks:
        raise ValueError("temperatures are of other looks")
    if not isinstance(header.info.get("job", {}).get("camera"), dict):
        raise ValueError("no camera is known")
    mean, farthest = arrays["mean"], 127 * arrays["steps"] @ np.abs(arrays["components"])
    if mean.min() < 0 or mean.max() > 1 + SLACK or farthest.max() > MOST_REFLECTANCE:
        raise ValueError("the prior holds no reflectances")
    sizes, (light, spread) = arrays["sizes"], arrays["numbers"]
    whole = math.isclose(light, mean.sum(dtype=float), rel_tol=SLACK) and 0 <= spread <= MOST_SPREAD
    whole &= arrays["members"].min() > 0
    if sizes.min() < 0 or sizes.sum() != scenes or not whole:
        raise ValueError("the scenes of the prior are none")


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
    path = find_design(path)
    header, _ = read_content(path, ())
    if is_adaptive(header):
        return AdaptiveDesign.load(path)
    return Design.load(path, device, trust=trust)


@answering.register
def _(design: AdaptiveDesign, camera: Camera) -> Answering:
    def guess_of(x: Tensor) -> Guess:
        def guess(generator: torch.Generator, budget: float) -> tuple[Tensor, Tensor, float, float]:
            optics = LookOptics.of(camera, design.image_shape, budget)
            chances, counted = [], 0.0
            for some in design.at_once(x):
                state = AdaptivePosterior(design.prior, len(some), optics)
                found, counts = expose(state, some, design.settings, generator)
                chances.append(found)
                counted += float(counts.sum())
            every = torch.cat(chances)
            return every.argmax(dim=-1), every, counted, counted

        return guess

    return Answering(guess_of, design.shares)


@stops_of.register
def _(design: AdaptiveDesign) -> tuple[tuple[int, ...], np.ndarray]:
    return tuple(range(1, design.masks + 1)), np.cumsum(design.settings.shares)


@logits_at_stops.register
def _(
    design: AdaptiveDesign,
    camera: Camera,
    x: np.ndarray,
    photons: float,
    draws: int,
    seed: int,
    places: Any = None,
) -> np.ndarray:
    generator = torch.Generator().manual_seed(seed)
    kept = range(design.masks) if places is None else places
    chunks = []
    with torch.no_grad():
        for some in design.at_once(torch.from_numpy(x).repeat_interleave(draws, dim=0)):
            looks = design.looks(some, photons, generator, camera)
            logs = [
                look.state.chances.clamp(min=LEAST_WEIGHT).log()
                for place, look in enumerate(looks)
                if place in kept
            ]
            chunks.append(torch.stack(logs))
    return torch.cat(chunks, dim=1).numpy()

"""Kinds of exposure: what each shows of a scene, and how its counts are read.

Each kind is a class. `MaskExposure` has masks that are known before, each with a fixed dwell, and
is the base of most kinds. Adaptive masks have a prior of scenes and make each mask from the counts
so far; `makes_masks` says so.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import prod
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from deepfsi.base.errors import InputError
from deepfsi.camera.camera import Camera
from deepfsi.camera.names import LIGHT_LAWS, LightLawName
from deepfsi.designfile.design_file import Temperatures
from deepfsi.designfile.view_test import SceneReadouts
from deepfsi.jobs.exposures import ConditionedEntry, Entry
from deepfsi.physics.detection import Detection, Rails
from deepfsi.physics.laws import light_law
from deepfsi.physics.noise import NoiseFunction, click_rescaling, noise_of
from deepfsi.physics.scanner import Scanner

Use = Literal["masks", "frames", "graph", "page", "comparison", "ideal observer"]
"""Uses that some kinds refuse: known masks and their counts; frames for a device; an ONNX graph; a
page; the test of counts alone; the ideal observer."""

EXPOSED_AT_ONCE = 1024
"""Scenes in a batch."""


class Answer(NamedTuple):
    """Answer to exposures."""

    logits: Tensor  # (..., C)
    probabilities: Tensor  # (..., C)
    classes: Tensor  # (...); logits can tell classes apart whose probabilities round alike


class CountedLight(NamedTuple):
    """Light of all exposures of a test."""

    counts: float
    photons: float
    used: float | None = None  # light on the device, if exposures may end early


Exposures = Callable[[float, torch.Generator], tuple[Answer, CountedLight]]
"""Function of a budget: exposes scenes once each and returns answers and light."""

Network = Callable[[Tensor, Tensor | float], Answer]
"""Function of features (..., k) over the budget, and of budgets: returns answers."""


class ExposureKind(ABC):
    """What a trained design shows of a scene, and how it reads the counts."""

    image_shape: tuple[int, ...]  # of a scene
    summed_reflectance: float  # s, the training scenes' mean summed reflectance; λ = Φ x / s
    shares: Tensor  # (k,), share of the budget counted for each feature, in the training mean
    detection: Detection  # detectors on parts of the device, and what is read of two rails
    makes_masks: ClassVar[bool] = False  # whether counts so far make the next mask
    comparable: ClassVar[bool] = True  # whether counts can be tested against the training's
    refusals: ClassVar[dict[Use, str]] = {}  # uses that the kind refuses, with the reason

    def check(self, use: Use) -> None:
        """Raise `InputError` for a use that the kind refuses."""
        if use in self.refusals:
            raise InputError(self.refusals[use])

    @property
    def device(self) -> torch.device:
        """Torch device of the tensors."""
        return self.shares.device

    @property
    @abstractmethod
    def count(self) -> int:
        """Number of masks; adaptive masks have one for each look."""

    @property
    @abstractmethod
    def title(self) -> str:
        """Short description for a reader."""

    @property
    @abstractmethod
    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays that the kind keeps in a design file."""

    @abstractmethod
    def exposures(self, scenes: Tensor, camera: Camera, network: Network) -> Exposures:
        """Exposures of scenes (n, N) by a camera; a network answers counts of known masks."""

    def quantised(self, levels: int) -> "ExposureKind":
        """The kind as a device with these grey levels shows it."""
        return self

    def to(self, device: str | torch.device) -> "ExposureKind":
        """The kind on a device."""
        return self


class Clicks(NamedTuple):
    """Clicks of detectors that fire at most once a gate."""

    gates: int  # most clicks of a readout
    photons: float  # budget of the training, at which the network reads clicks

    @classmethod
    def of(cls, camera: Camera, photons: float) -> "Clicks | None":
        """Clicks of a camera, and of a training at a budget; None if it counts photons."""
        return None if camera.clicks is None else cls(camera.clicks, photons)


@dataclass(frozen=True, eq=False, kw_only=True)
class MaskExposure(ExposureKind):
    """Exposure with masks that are known before; each is shown once, for its dwell.

    Training and design file both make it from its entry: `Entry.restored_by` names the class.
    """

    entry: Entry  # of the design file's header
    rails: Rails  # (m, N), shares of each pixel's photons
    light: LightLawName  # light law that the rails obey
    image_shape: tuple[int, ...]
    detection: Detection
    summed_reflectance: float
    mean: Tensor  # (k,), of the features y / Φ over training scenes
    std: Tensor  # (k,)
    shares: Tensor
    clicks: Clicks | None = None
    weights: Mapping[str, Tensor] = field(default_factory=dict)  # further tensors of the file

    @property
    def count(self) -> int:
        """m, number of masks."""
        return self.rails.masks

    @property
    def title(self) -> str:
        """Number and shape of the masks, and their light law."""
        shape = "x".join(map(str, self.entry.mask_shape(self.image_shape)))
        return f"{self.count} masks of {shape}, {self.light}, {self.rails.kind} rails"

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays of a design file of the masks; others are `weights`."""
        tensors = {"mean": self.mean, "std": self.std, "shares": self.shares}
        tensors["rails"] = self.rails.stacked
        if self.detection.labels is not None:
            tensors["detectors"] = self.detection.labels
        return {
            name: tensor.detach().cpu().contiguous().numpy() for name, tensor in tensors.items()
        }

    def to(self, device: str | torch.device) -> Self:
        """The kind on a device."""
        return replace(
            self,
            rails=self.rails.to(device),
            mean=self.mean.to(device),
            std=self.std.to(device),
            shares=self.shares.to(device),
            weights={name: tensor.to(device) for name, tensor in self.weights.items()},
        )

    # What is shown

    @property
    def counts_shape(self) -> tuple[int, ...]:
        """Shape ([2,] m [, D]) of an exposure's counts."""
        detectors = (self.detection.count,) if self.detection.count > 1 else ()
        return ((2,) if self.rails.count == 2 else ()) + (self.count, *detectors)

    @property
    def part_axis(self) -> tuple[int, ...]:
        """Axis (P,) for parts of a scene, before the axes of masks; () for whole scenes."""
        return ()

    def quantised(self, levels: int) -> Self:
        """The kind as a device with these grey levels shows it."""
        rails = light_law(self.light).quantise(self.rails.stacked, levels)
        return replace(self, rails=Rails.of(rails))

    def as_shown(self, rails: Rails, dimmed: float) -> Self:
        """The kind as patterns realise it, on a device that passes the share `dimmed` of the light.

        Features are smaller by this share, and so are the statistics that scale them.
        """
        return replace(
            self,
            rails=rails,
            light=self.light if LIGHT_LAWS[self.light].one_device else "free-dwell",
            mean=self.mean * dimmed,
            std=self.std * dimmed,
            shares=self.shares * dimmed,
        )

    def drawing(self) -> tuple[Tensor, tuple[int, ...], Tensor | None]:
        """Picture (m, N) of what is shown, the shape of a row, and shares (m,) of the exposure.

        The shares are None where the law has no dwells.
        """
        dwells = None
        if LIGHT_LAWS[self.light].one_device:
            shares = light_law(self.light).used(self.rails.stacked)
            dwells = torch.diff(shares, prepend=shares.new_zeros(1))
        return self.rails.difference, self.entry.mask_shape(self.image_shape), dwells

    # Exposing

    def scanner(
        self, noise: str | NoiseFunction = "poisson", sigma: float = 1.0, dark: float = 0.0
    ) -> Scanner:
        """The optical front end, made as by `Scanner`."""
        return Scanner.from_rails(
            self.rails.stacked, noise, sigma=sigma, dark=dark, detection=self.detection
        )

    def rates(self, scanner: Scanner, scenes: Tensor) -> Tensor:
        """Expected counts (..., rails, m · D) of reflectances (..., N) at the budget 1."""
        return scanner.rates(scenes.to(self.device) / self.summed_reflectance)

    def placed(self, rates: Tensor, generator: torch.Generator | None) -> Tensor:
        """Expected counts (..., rails, m · D) of exposures, for scenes that move.

        The generator draws where each scene is; without one, the mean over its places is returned.
        """
        return rates

    def exposures(self, scenes: Tensor, camera: Camera, network: Network) -> Exposures:
        """Exposures of scenes (n, N) by a camera, answered by a network."""
        scanner = self.scanner(noise_of(camera))
        rates = self.rates(scanner, scenes)

        def expose(photons: float, generator: torch.Generator) -> tuple[Answer, CountedLight]:
            counts = scanner.read(self.placed(rates, generator) * photons, generator)
            if self.clicks is not None:
                # clicks are over the training's budget: the next line divides by this one
                counts = counts * (photons / self.clicks.photons)
            answer = network(self.detection.features(counts) / photons, photons)
            # the mean light of the exposures, without their noise
            arriving = photons * self.placed(rates, None)
            counted = float(scanner.noise.mean(arriving).sum())
            return answer, CountedLight(counted, float(arriving.sum()))

        return expose

    def scene_readouts(self, counts: np.ndarray, photons: float, noise: Any) -> SceneReadouts:
        """Counts (s, [2,] m [, D]) of scenes at a budget, for the tests of counts.

        `noise`, as the counts of one scene, is their variance beyond that of its photons.
        """
        rails = self.rails.stacked.cpu().numpy().astype(float)
        # rails of one arm are seen by one detector in turn, two arms have one each
        arms = np.arange(len(rails))[:, None] * (LIGHT_LAWS[self.light].arms == 2)
        labels = self.detection.labels
        cells = None if labels is None else labels.cpu().numpy()
        gain = photons / self.summed_reflectance
        return SceneReadouts.of(gain * rails, counts, noise, cells, arms)

    # Answering

    def features(self, counts: Tensor, photons: Tensor | float) -> Tensor:
        """Features (..., k) of counts (..., [2,] m [, D]), over the budget (..., 1).

        Clicks are not in proportion to the light: theirs are over the training's budget.
        """
        by_rail = counts.flatten(-2) if self.detection.count > 1 else counts
        by_rail = by_rail if self.rails.count == 2 else by_rail.unsqueeze(-2)
        scale = photons if self.clicks is None else self.clicks.photons
        return self.detection.features(by_rail) / scale

    @property
    def input_count(self) -> int:
        """Number of the classifier's inputs: k, its features."""
        return self.count * self.detection.width(self.rails.count)

    def inputs(self, features: Tensor, photons: Tensor | float) -> Tensor:
        """Inputs of the classifier from features (..., k) over the budget, and budgets (..., 1)."""
        if self.clicks is not None:
            trained = self.clicks.photons
            gain, offset = click_rescaling(
                photons / trained,
                self.mean * trained,
                self.shares * trained / prod(self.part_axis),
                self.clicks.gates,
            )
            features = features * gain + offset / trained
        return (features - self.mean) / self.std


@dataclass(frozen=True, eq=False, kw_only=True)
class ConditionedExposure(MaskExposure):
    """Exposure of fixed dwells for a range of budgets, which its classifier must know.

    It has two more inputs: the logarithm of the budget, -1 to 1 over a range of e² or more, and 1,
    which designs of earlier versions read as the share of masks shown.
    """

    entry: ConditionedEntry

    @property
    def input_count(self) -> int:
        """Number of the classifier's inputs: features of all masks, and two more."""
        return self.entry.masks * self.entry.width + 2

    def inputs(self, features: Tensor, photons: Tensor | float) -> Tensor:
        """Inputs of the classifier, of features over the budget, and the budget."""
        scaled = super().inputs(features, photons)
        ratio = torch.as_tensor(photons).to(scaled) / (self.entry.used * self.entry.photons)
        return with_budget(scaled, ratio, self.entry.span)

    def as_shown(self, rails: Rails, dimmed: float) -> Self:
        """The kind as patterns realise it."""
        entry = self.entry.model_copy(update={"used": self.entry.used / dimmed})
        return replace(super().as_shown(rails, dimmed), entry=entry)


def with_budget(scaled: Tensor, ratio: Tensor, span: float) -> Tensor:
    """Inputs (..., k + 2): standardised features, the budget over the lowest of a range, and 1."""
    middle = math.log(span) / 2
    level = (torch.log(ratio) - middle) / max(middle, 1.0)  # a narrow range is not stretched to ±1
    column = scaled[..., :1]
    return torch.cat([scaled, level.expand_as(column), torch.ones_like(column)], dim=-1)


def temperatures_at(fitted: Temperatures, stop: Tensor | int, photons: Tensor | float) -> Tensor:
    """Temperatures (..., 1) at stops (..., 1) or (), from 0, and at budgets (..., 1)."""
    if not isinstance(photons, Tensor):
        photons = torch.tensor([photons], dtype=torch.double)
    start = np.log(fitted.budgets[0])
    step = np.log(fitted.budgets[1] / fitted.budgets[0])
    level = (photons.log() - start) / step
    logs = torch.from_numpy(fitted.logs).to(level)
    rows = _hats(torch.as_tensor(stop).to(level), len(logs)) @ logs
    log = (rows * _hats(level, logs.shape[1])).sum(dim=-1, keepdim=True)
    # Features are divided by the budget: in less light their noise grows as 1 / Φ, and logits do
    return (log - level.clamp(max=0) * step).exp()


def _hats(position: Tensor, count: int) -> Tensor:
    """Weights (..., count) of linear interpolation at positions (..., 1) or () between 0, 1, 2, ….

    Beyond the ends the value of the end holds.
    """
    distance = position.clamp(0, count - 1) - torch.arange(count).to(position)
    return (1 - distance.abs()).relu()

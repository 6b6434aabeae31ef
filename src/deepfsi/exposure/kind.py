"""Base of all kinds of exposure: what each shows of a scene, and what its counts tell.

One class for each kind. Most hold masks that are known before (`MaskExposure`); adaptive masks hold
a prior of scenes, of which they make theirs. What needs one or the other asks `makes_masks`.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import prod
from typing import Any, ClassVar, Literal, NamedTuple, Protocol, Self

import numpy as np
import torch
from torch import Tensor

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.camera.camera import Camera
from deepfsi.camera.names import LIGHT_LAWS, LightLawName
from deepfsi.designfile.provenance import click_gates
from deepfsi.jobs.exposures import AdaptiveMasks, ExposureEntry
from deepfsi.physics.detection import Detection, Rails
from deepfsi.physics.laws import light_law
from deepfsi.physics.noise import NoiseFunction, noise_of, to_training_light
from deepfsi.physics.scanner import Scanner

Use = Literal["masks", "frames", "graph", "page", "comparison", "ideal observer"]
"""What not every kind can be used for: masks that are known before, with counts of them; frames of
a device; an ONNX graph; a page; the comparison of counts alone; the ideal observer."""

EXPOSED_AT_ONCE = 1024
"""Scenes that are exposed at a time."""


@dataclass(frozen=True)
class Observation:
    """Readouts of an exposure so far."""

    features: Tensor  # (..., k)

    def inputs(self, mean: Tensor, std: Tensor) -> Tensor:
        """Standardised features (..., k)."""
        return (self.features - mean) / std


class Answer(NamedTuple):
    """Answer to exposures."""

    logits: Tensor  # (..., C)
    chances: Tensor  # (..., C)
    classes: Tensor  # (...), that logits may tell apart where rounded chances do not


class CountedLight(NamedTuple):
    """Light of exposures together."""

    counts: float
    photons: float
    used: float | None = None  # light on the coding device, of exposures that stop


class ExposureKind(ABC):
    """One kind of exposure, of a design that was made: what it shows, reads and answers."""

    makes_masks: ClassVar[bool] = False
    """Whether masks are made of the counts so far."""

    comparable: ClassVar[bool] = True
    """Whether counts can be held against those of the training."""

    refusals: ClassVar[dict[Use, str]] = {}
    """Why the kind cannot be used for something."""

    exposed_at_once: ClassVar[int] = EXPOSED_AT_ONCE
    """Scenes of which a test holds the counts at a time, at most."""

    own_draws: ClassVar[bool] = False
    """Whether each draw of a scene is an exposure of its own from the first look on."""

    def check(self, use: Use, name: str | None = None) -> None:
        """Raise `InputError` where a design, of such a name, cannot be used for something."""
        text = self.refusals.get(use)
        if text is not None:
            raise InputError(text if name is None else text.replace("this design", name, 1))

    @property
    @abstractmethod
    def image_shape(self) -> tuple[int, ...]:
        """Shape of a scene."""

    @property
    @abstractmethod
    def count(self) -> int:
        """Number of masks, or of looks of adaptive masks."""

    @property
    @abstractmethod
    def shares(self) -> Tensor:
        """Share of the budget that is counted for each feature, in the training mean, (k,)."""

    @property
    @abstractmethod
    def summed_reflectance(self) -> float:
        """s, the training scenes' mean summed reflectance; λ = Φ x / s."""

    @property
    @abstractmethod
    def camera(self) -> Camera:
        """The camera of a design that does not say for which one it was trained."""

    @property
    @abstractmethod
    def detection(self) -> Detection:
        """Detectors on parts of the device, and what is read of two rails."""

    @property
    def device(self) -> torch.device:
        """Where exposures are computed."""
        return self.shares.device

    @property
    @abstractmethod
    def title(self) -> str:
        """The kind in a few words, for a reader."""

    @abstractmethod
    def entry(self) -> ExposureEntry | AdaptiveMasks:
        """Entry of a design file's header."""

    @property
    @abstractmethod
    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays of a design file that are the kind's own."""

    @abstractmethod
    def front_end(self, camera: Camera) -> Any:
        """Front end that exposes scenes, with the noise of a camera."""

    @abstractmethod
    def rates(self, front: Any, scenes: Tensor) -> Tensor:
        """Expected counts for a budget of one, as `observe` takes them, of reflectances (n, N)."""

    @abstractmethod
    def observe(
        self, front: Any, rates: Tensor, photons: float, generator: torch.Generator
    ) -> Iterator[Observation]:
        """Exposures at each stop: after each number of masks that do, or after each look."""

    def expose(
        self, front: Any, rates: Tensor, photons: float, generator: torch.Generator
    ) -> Observation:
        """Exposures at their end."""
        *_, seen = self.observe(front, rates, photons, generator)
        return seen

    @abstractmethod
    def light(self, front: Any, rates: Tensor, seen: Observation, photons: float) -> CountedLight:
        """Light of exposures together."""

    @abstractmethod
    def answer(self, seen: Observation, photons: Tensor | float, network: "ReadsCounts") -> Answer:
        """Answer to exposures so far, of a budget in all, by what reads their counts."""

    def test(
        self,
        front: Any,
        rates: Tensor,
        photons: float,
        generator: torch.Generator,
        network: "ReadsCounts",
    ) -> tuple[Answer, CountedLight]:
        """Answers to exposures at their end, and their light together."""
        seen = self.expose(front, rates, photons, generator)
        return self.answer(seen, photons, network), self.light(front, rates, seen, photons)

    def test_in_parts(
        self,
        front: Any,
        scenes: Tensor,
        photons: float,
        generator: torch.Generator,
        network: "ReadsCounts",
    ) -> Iterator[tuple[Answer, CountedLight]]:
        """Answers and light of scenes (n, N), some at a time."""
        for some in scenes.split(EXPOSED_AT_ONCE):
            yield self.test(front, self.rates(front, some), photons, generator, network=network)

    def quantised(self, levels: int) -> "ExposureKind":
        """The kind as a device of so many grey levels shows it."""
        return self

    def to(self, device: str | torch.device) -> "ExposureKind":
        """The kind on a device."""
        return self


class ReadsCounts(Protocol):
    """Reader of counts: a network, with its calibration."""

    def logits_of(self, seen: Observation, photons: Tensor | float) -> Tensor:
        """Logits (..., C) of exposures so far, of a budget in all."""

    def temperature(self, seen: Observation, photons: Tensor | float) -> Tensor | float:
        """Temperature (..., 1) of these logits."""


class Clicks(NamedTuple):
    """Clicks of detectors that fire at most once a gate."""

    gates: int  # clicks of a readout at most
    photons: float  # budget of the training, for which clicks are read

    @classmethod
    def of(cls, info: Mapping[str, Any]) -> "Clicks | None":
        """Clicks of a design of such a provenance; None where its detectors count."""
        gates = click_gates(info)
        return None if gates is None else cls(gates, info["job"]["photons"])


@dataclass(frozen=True, eq=False)
class TrainedMasks:
    """Masks after a training, and what is read of them in the mean over its scenes."""

    rails: Rails  # `plus` and `minus` (m, N), shares of each pixel's photons
    light: LightLawName  # light law that the rails obey
    image_shape: tuple[int, ...]
    detection: Detection  # detectors on parts of the device, and what is read of two rails
    summed_reflectance: float  # s, the training scenes' mean summed reflectance
    mean: Tensor  # (k,)
    std: Tensor  # (k,)
    shares: Tensor  # (k,), share of the budget that is counted for each feature
    clicks: Clicks | None = None

    def to(self, device: str | torch.device) -> "TrainedMasks":
        """Masks and statistics on a device."""
        return replace(
            self,
            rails=self.rails.to(device),
            mean=self.mean.to(device),
            std=self.std.to(device),
            shares=self.shares.to(device),
        )


UNTRAINED: Any = None
"""Masks before the end of a training."""


class MaskExposure(ExposureKind):
    """Base of the kinds whose masks are known before: each is shown once, for its own dwell."""

    optics: TrainedMasks
    kind: ClassVar[str]  # name in the design file

    @property
    def image_shape(self) -> tuple[int, ...]:
        """Shape of a scene."""
        return self.optics.image_shape

    @property
    def count(self) -> int:
        """m, number of masks."""
        return self.optics.rails.masks

    @property
    def shares(self) -> Tensor:
        """Share of the budget that is counted for each feature, in the training mean, (k,)."""
        return self.optics.shares

    @property
    def summed_reflectance(self) -> float:
        """s, the training scenes' mean summed reflectance; λ = Φ x / s."""
        return self.optics.summed_reflectance

    @property
    def detection(self) -> Detection:
        """Detectors on parts of the device, and what is read of two rails."""
        return self.optics.detection

    @property
    def camera(self) -> Camera:
        """The camera of a design that does not say for which one it was trained."""
        optics = self.optics
        fields: dict[str, Any] = {"light": optics.light, "rails": optics.rails.kind}
        fields["readout"] = optics.detection.readout
        if optics.detection.labels is not None and LIGHT_LAWS[optics.light].one_device:
            fields["detectors"] = optics.detection.labels.cpu()
        with as_input_error("the design's camera", "train it again"):
            return Camera.restored(fields)

    @property
    def title(self) -> str:
        """Number and shape of the masks, and their light law."""
        shape = "x".join(map(str, self.mask_shape))
        optics = self.optics
        return f"{self.count} masks of {shape}, {optics.light}, {optics.rails.kind} rails"

    # Files

    @abstractmethod
    def entry(self) -> ExposureEntry:
        """Entry of the design file's header, of which `restored` makes the kind again."""

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays of a design file of the masks; others are `weights`."""
        optics = self.optics
        tensors = {"mean": optics.mean, "std": optics.std, "shares": optics.shares}
        tensors["rails"] = optics.rails.stacked
        if optics.detection.labels is not None:
            tensors["detectors"] = optics.detection.labels
        return {
            name: tensor.detach().cpu().contiguous().numpy() for name, tensor in tensors.items()
        }

    @classmethod
    def restored(
        cls, entry: ExposureEntry, weights: dict[str, Tensor], optics: TrainedMasks
    ) -> "MaskExposure":
        """The kind of an entry, with its tensors of a design file; an error where they differ."""
        made = cls(**entry.model_dump(exclude={"kind", "nested"}), optics=optics)  # type: ignore[call-arg]
        made.check_masks()
        return made

    def check_masks(self) -> None:
        """Raise `ValueError` unless the masks can be exposed so."""

    @property
    def weights(self) -> dict[str, Tensor]:
        """Tensors of the design file besides rails, statistics and classifier."""
        return {}

    def to(self, device: str | torch.device) -> Self:
        """The kind on a device."""
        return replace(self, optics=self.optics.to(device))  # type: ignore[type-var]

    # What is shown

    def with_optics(self, **fields: Any) -> Self:
        """The kind with other fields of its `optics`."""
        return replace(self, optics=replace(self.optics, **fields))  # type: ignore[type-var]

    @property
    def mask_shape(self) -> tuple[int, ...]:
        """Shape of a mask."""
        return self.image_shape

    @property
    def part_axis(self) -> tuple[int, ...]:
        """Axis (P,) of counts of parts of a scene, before those of masks; none of whole scenes."""
        return ()

    def quantised(self, levels: int) -> Self:
        """The kind as a device of so many grey levels shows it."""
        rails = light_law(self.optics.light).quantise(self.optics.rails.stacked, levels)
        return self.with_optics(rails=Rails.of(rails))

    def as_shown(self, rails: Rails, dimmed: float) -> Self:
        """The kind as patterns realise it, of which one device gives so much less light.

        Features are as much smaller, and so are the statistics that scale them.
        """
        optics = self.optics
        return self.with_optics(
            rails=rails,
            light=optics.light if LIGHT_LAWS[optics.light].one_device else "free-dwell",
            mean=optics.mean * dimmed,
            std=optics.std * dimmed,
            shares=optics.shares * dimmed,
        )

    def mask_dwells(self) -> Tensor | None:
        """Share (m,) of the exposure that each mask is shown; None where the law has no dwells."""
        if not LIGHT_LAWS[self.optics.light].one_device:
            return None
        shares = light_law(self.optics.light).used(self.optics.rails.stacked)
        return torch.diff(shares, prepend=shares.new_zeros(1))

    def drawing(self) -> tuple[Tensor, tuple[int, ...]]:
        """Picture (m, N) of what is shown, and the shape of a row."""
        return self.optics.rails.difference, self.mask_shape

    # Exposing

    def scanner(
        self, noise: str | NoiseFunction = "poisson", sigma: float = 1.0, dark: float = 0.0
    ) -> Scanner:
        """The optical front end; parameters as for `Scanner`."""
        return Scanner.from_rails(
            self.optics.rails.stacked, noise, sigma=sigma, dark=dark, detection=self.detection
        )

    def front_end(self, camera: Camera) -> Scanner:
        """The scanner with the noise of a camera."""
        return self.scanner(noise_of(camera))

    def rates(self, front: Scanner, scenes: Tensor) -> Tensor:
        """Expected counts (..., rails, m · D) of reflectances (..., N), for a budget of one."""
        return front.rates(scenes.to(self.device) / self.summed_reflectance)

    def scale(self, photons: Tensor | float) -> Tensor | float:
        """Divisor of features in counts: the budget; of clicks that of the training, always."""
        clicks = self.optics.clicks
        return photons if clicks is None else 0 * photons + clicks.photons

    def read(
        self, front: Scanner, expected: Tensor, generator: torch.Generator | None, photons: float
    ) -> Tensor:
        """Features (..., k) over the budget of expected counts (..., rails, m · D)."""
        counts = front.read(expected, generator) * (photons / self.scale(photons))
        return self.detection.features(counts) / photons

    def observe(
        self, front: Scanner, rates: Tensor, photons: float, generator: torch.Generator
    ) -> Iterator[Observation]:
        """Exposures of all masks, the one stop."""
        rates = self.placed(rates, generator)
        yield Observation(self.read(front, rates * photons, generator, photons))

    def placed(self, rates: Tensor, generator: torch.Generator | None) -> Tensor:
        """Expected counts (..., rails, m · D) of exposures of `rates`, each where its scene is."""
        return rates

    def expected(self, rates: Tensor, seen: Observation) -> Tensor:
        """Photons (..., rails, m · D) of an exposure that are expected, for a budget of one."""
        return rates

    def light(
        self, front: Scanner, rates: Tensor, seen: Observation, photons: float
    ) -> CountedLight:
        """Light of exposures together."""
        arriving = photons * self.expected(rates, seen)
        return CountedLight(float(front.noise.mean(arriving).sum()), float(arriving.sum()))

    # Answering

    def input_count(self, features: int) -> int:
        """Number of the classifier's inputs for k features."""
        return features

    def network_inputs(self, seen: Observation, photons: Tensor | float) -> Tensor:
        """Inputs of the classifier of an exposure so far, of a budget in all."""
        optics = self.optics
        if optics.clicks is not None:
            trained = optics.clicks.photons
            gain, offset = to_training_light(
                photons / trained,
                optics.mean * trained,
                optics.shares * trained / prod(self.part_axis),
                optics.clicks.gates,
            )
            seen = replace(seen, features=seen.features * gain + offset / trained)
        return self.condition(seen.inputs(optics.mean, optics.std), photons)

    def condition(self, inputs: Tensor, photons: Tensor | float) -> Tensor:
        """Inputs of the classifier, from those of `Observation.inputs` and the budget."""
        return inputs

    def budget(self, photons: Tensor) -> Tensor:
        """Budget (..., 1) of an exposure, of that of each of its parts."""
        return photons

    def answer(self, seen: Observation, photons: Tensor | float, network: ReadsCounts) -> Answer:
        """Answer to exposures so far, of a budget in all, by what reads their counts."""
        logits = network.logits_of(seen, photons)
        chances = (logits / network.temperature(seen, photons)).softmax(dim=-1)
        return Answer(logits, chances, logits.argmax(dim=-1))

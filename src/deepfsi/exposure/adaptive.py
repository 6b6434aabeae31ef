"""Exposures with adaptive masks: each mask is made of the counts so far.

What is known before is a prior of scenes, here the training scenes. A look shows the mask that
tells most of the class, as far as it is known; its counts are taken in by the posterior, whose
probabilities of the classes are the answer.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepfsi.base import InputError, as_input_error
from deepfsi.base.numeric import check_memory, free_memory
from deepfsi.camera import Camera
from deepfsi.datasets import Dataset
from deepfsi.designfile import AdaptiveHeader
from deepfsi.exposure.choice import look_at
from deepfsi.exposure.misfit import UsualMisfit
from deepfsi.exposure.posterior import LEAST_WEIGHT, AdaptivePosterior, LookOptics
from deepfsi.exposure.prior import ScenePrior
from deepfsi.exposure.trained import (
    Answer,
    ExposureKind,
    Light,
    Observation,
    ReadsCounts,
    Stops,
    Use,
)
from deepfsi.jobs import AdaptiveMasks
from deepfsi.physics import Detection

AT_ONCE = 2**22
"""Log-likelihoods that are held at a time."""

MOST_EXPOSURES = 32
"""Exposures that are computed at a time, at most: a thousand of them take twice as long each."""

COPIES = 6
"""Arrays as large as the log-likelihoods, or as the scenes of the prior, held at a time."""

MASKS_ARE_MADE = (
    "{name} makes its masks while the camera looks, and this takes masks that are known before: "
    "`deepfsi evaluate`, `stop`, `show`, `page`, `dmd export` and `camera live` take it"
)
"""Why adaptive masks are not for what needs masks."""

POSTERIOR_ANSWERS = (
    "adaptive masks are answered by the posterior of the ideal observer, after all looks: leave "
    "{ideal} and {first} out"
)
"""Why adaptive masks have no ideal observer beside them."""


@dataclass(frozen=True)
class PosteriorObservation(Observation):
    """Knowledge of the class after a look with adaptive masks.

    Attributes
    ----------
    features : tensor, shape (b, Q)
        Counts of the look over the budget; 0 of exposures that stopped before.
    chances : tensor, shape (b, C)
        Probabilities of the classes.
    counts : float
        Counts of all looks so far, of all exposures, that are expected without dark ones.
    """

    chances: Tensor = None  # type: ignore[assignment]
    counts: float = 0.0


class LookedAt(NamedTuple):
    """One exposure look by look: masks and mean scenes (K, N) of the posterior, chances (K, C)."""

    masks: np.ndarray
    scenes: np.ndarray
    chances: np.ndarray


@dataclass(frozen=True, eq=False)
class AdaptiveExposure(ExposureKind):
    """Exposure of which each mask is made of the counts so far.

    Attributes
    ----------
    prior : ScenePrior
        Of scenes: the training scenes, in components.
    settings : AdaptiveMasks
        Looks, and the share of the exposure that each takes.
    shape : tuple of int
        Of a scene.
    counted : tensor, shape (K,)
        Share of the budget that each look counts, in the mean over training scenes.
    usual_misfit : UsualMisfit or None
        How far counts of training scenes are from those expected; None of few training scenes.
    optics : mapping or None
        Fields of the camera that it was made for.
    """

    prior: ScenePrior
    settings: AdaptiveMasks
    shape: tuple[int, ...]
    counted: Tensor
    usual_misfit: UsualMisfit | None = None
    optics: Mapping[str, Any] | None = None

    makes_masks: ClassVar[bool] = True
    comparable: ClassVar[bool] = False
    own_draws: ClassVar[bool] = True
    refusals: ClassVar[dict[Use, str]] = {
        "masks": MASKS_ARE_MADE,
        "frames": MASKS_ARE_MADE,
        "graph": MASKS_ARE_MADE,
        "comparison": MASKS_ARE_MADE,
        "first": POSTERIOR_ANSWERS,
        "ideal observer": POSTERIOR_ANSWERS,
    }

    @classmethod
    def restored(
        cls, header: AdaptiveHeader, arrays: Mapping[str, np.ndarray]
    ) -> "AdaptiveExposure":
        """The kind of a design file, or an error where its arrays do not fit the header."""
        return cls(
            prior=ScenePrior.restored(arrays),
            settings=header.settings,
            shape=header.image_shape,
            counted=torch.from_numpy(arrays["shares"]),
            usual_misfit=UsualMisfit.restored(arrays, header.settings.looks),
            optics=header.info.get("job", {}).get("camera"),
        )

    def entry(self) -> AdaptiveMasks:
        """Settings of the looks."""
        return self.settings

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays of a design file: prior, shares and misfit."""
        arrays = self.prior.arrays | {"shares": self.counted.numpy()}
        return arrays if self.usual_misfit is None else arrays | self.usual_misfit.arrays

    @property
    def image_shape(self) -> tuple[int, ...]:
        """Shape of a scene."""
        return self.shape

    @property
    def count(self) -> int:
        """K, number of looks: each shows a mask of its own."""
        return self.settings.looks

    @property
    def shares(self) -> Tensor:
        """Share of the budget that each look counts, in the training mean, (K,)."""
        return self.counted

    @property
    def summed_reflectance(self) -> float:
        """s, the training scenes' mean summed reflectance; λ = Φ x / s."""
        return self.prior.summed_reflectance

    @property
    def camera(self) -> Camera:
        """The camera that it was made for."""
        if self.optics is None:
            raise InputError("this design does not say which camera it is for: make it again")
        with as_input_error("the design's camera", "train it again"):
            return Camera.restored(dict(self.optics))

    @property
    def detection(self) -> Detection:
        """Detectors on parts of the device."""
        return Detection.of(self.camera, self.shape)

    @property
    def title(self) -> str:
        """Number of looks, and of scenes that are known."""
        return f"{self.count} looks, {len(self.prior)} scenes known"

    @property
    def exposed_at_once(self) -> int:  # type: ignore[override]
        """Exposures of which the memory holds the likelihoods, and the caches the masks."""
        return max(1, min(MOST_EXPOSURES, AT_ONCE // len(self.prior)))

    def optics_at(self, photons: float, camera: Camera | None = None) -> LookOptics:
        """Optics of a look at a budget of a whole exposure, of another camera if one is given.

        Raises
        ------
        InputError
            If the camera shows no binary masks, or has read noise.
        """
        return LookOptics.of(self.camera if camera is None else camera, self.shape, photons)

    def front_end(self, camera: Camera | None) -> Camera:
        """The camera itself: its optics, and its dark counts."""
        return self.camera if camera is None else camera

    def rates(self, front: Camera, scenes: Tensor) -> Tensor:
        """The reflectances (n, N) themselves: what is counted follows from masks to come."""
        return scenes

    def observe(
        self, front: Camera, rates: Tensor, photons: float, generator: torch.Generator
    ) -> Iterator[PosteriorObservation]:
        """Exposures after each of all looks, of at most `exposed_at_once` scenes."""
        state = AdaptivePosterior(self.prior, len(rates), self.optics_at(photons, front))
        counts = 0.0
        for share in self.settings.shares:
            look = look_at(state, rates, share, generator)
            state.update(look.masks, look.counts, share)
            counts += float(look.light.double().sum())
            yield PosteriorObservation(look.counts / photons, chances=state.chances, counts=counts)

    def expose(
        self, front: Camera, rates: Tensor, photons: float, generator: torch.Generator
    ) -> PosteriorObservation:
        """Exposures at their end, each of which stops where it is sure enough."""
        optics = self.optics_at(photons, front)
        parts = []
        counted = 0.0
        for some in rates.split(self.exposed_at_once):
            state = AdaptivePosterior(self.prior, len(some), optics)
            chances, counts = self._run(state, some, generator)
            parts.append(chances)
            counted += float(counts.sum())
        every = torch.cat(parts)
        return PosteriorObservation(every[:, :0], chances=every, counts=counted)

    def _run(
        self, state: AdaptivePosterior, x: Tensor, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Expose scenes (b, N) from the state before all looks: chances (b, C) and counts (K,)."""
        settings = self.settings
        chances = torch.empty(len(x), state.prior.classes)
        counts = torch.zeros(settings.looks, dtype=torch.double)
        running = torch.arange(len(x))
        for index, share in enumerate(settings.shares):
            look = look_at(state, x[running], share, generator)
            state.update(look.masks, look.counts, share)
            counts[index] = look.light.double().sum()
            last = index == settings.looks - 1
            if settings.until < 1 or last:
                chances[running] = state.chances
                going = chances[running].amax(dim=1) <= settings.until
                if not last and not bool(going.all()):
                    state, running = state.part(going), running[going]
            if not len(running):
                break
        return chances, counts

    def light(self, front: Camera, rates: Tensor, seen: Observation, photons: float) -> Light:
        """Light of exposures together, which do not click; parameters of `observe`."""
        assert isinstance(seen, PosteriorObservation)
        return Light(seen.counts, seen.counts)

    def answer(self, seen: Observation, photons: Tensor | float, network: ReadsCounts) -> Answer:
        """Answer of the posterior: nothing else reads the counts."""
        assert isinstance(seen, PosteriorObservation)
        chances = seen.chances
        return Answer(chances.clamp(min=LEAST_WEIGHT).log(), chances, chances.argmax(dim=-1))

    @property
    def stops(self) -> Stops:
        """Numbers of looks after which an exposure may stop, and the share taken then."""
        return Stops(tuple(range(1, self.count + 1)), np.cumsum(self.settings.shares))

    def stopping_at(self, threshold: float) -> "AdaptiveExposure":
        """The kind whose exposures stop at a probability of a class."""
        return replace(self, settings=self.settings.model_copy(update={"until": threshold}))

    def few(self, coefficients: int, seed: int) -> "AdaptiveExposure":
        """The kind that knows some of the scenes, with so many coefficients, and stops nowhere."""
        prior = self.prior.few(coefficients // len(self.prior.components), seed)
        whole = self.settings.model_copy(update={"until": 1.0})
        return replace(self, prior=prior, settings=whole)

    def look_by_look(self, scene: Tensor, photons: float, generator: torch.Generator) -> LookedAt:
        """One exposure of a scene (N,), look by look."""
        state = AdaptivePosterior(self.prior, 1, self.optics_at(photons))
        masks, scenes, chances = [], [], []
        for share in self.settings.shares:
            look = look_at(state, scene[None], share, generator)
            state.update(look.masks, look.counts, share)
            masks.append(look.masks[0])
            scenes.append(state.scene[0])
            chances.append(state.chances[0])
        return LookedAt(*(torch.stack(each).numpy() for each in (masks, scenes, chances)))


def prior_of(data: Dataset, settings: AdaptiveMasks) -> ScenePrior:
    """Prior of the training scenes of a data set, or `InputError` if it does not fit the memory."""
    scenes = len(data.x_train)
    needed = 4 * (scenes * (3 * data.pixels + settings.components) + COPIES * AT_ONCE)
    check_memory(needed, free_memory(), "the prior of these scenes", "give fewer scenes")
    return ScenePrior(
        data.x_train,
        data.y_train,
        len(data.classes),
        settings.components,
        settings.spread,
        clusters=settings.clusters,
    )

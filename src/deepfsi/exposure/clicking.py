"""Adaptive masks before a detector that clicks at most once a look, where a click has a price.

A look that stays dark costs no count, and tells something as well. So that look is chosen, mask and
dwell together, whose outcome, click or none, is expected to tell most of the class for each click:
information over the probability of a click, to which the share of a click is added that a look
costs, as looks are not endless. An exposure ends where no look tells as much for a click as the
price asks, after all looks, or where the next has no light left.

Scenes of the prior are known to within one mirror or so: they are blurred, a mask is never dark,
and its light varies from scene to scene by a tenth of its mean (gamma distributed, so that the
probability of no click is a closed form). Sources: sequential design by expected information
(Lindley 1956), with a cost of the observation (DeGroot, *Optimal Statistical Decisions*, 1970).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import log
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from deepfsi.base import InputError, Progress
from deepfsi.camera import Camera, summed_reflectance
from deepfsi.datasets import Dataset
from deepfsi.designfile import LOG_BOUNDS, Temperatures
from deepfsi.exposure.adaptive import (
    POSTERIOR_ANSWERS,
    AdaptiveExposure,
    AdaptiveTraining,
    LookedAt,
    PosteriorObservation,
    exposures_at_once,
    prior_of,
)
from deepfsi.exposure.choice import LIKELIEST, difference_masks, draw_places, groups_of
from deepfsi.exposure.kind import CountedLight, Observation, Use
from deepfsi.exposure.posterior import LEAST_WEIGHT, AdaptivePosterior, LookOptics, ScenePrior
from deepfsi.jobs import AdaptiveMasks, Job

BLUR = 0.5
"""Standard deviation of the blur of the scenes of the prior, pixels."""

COMPONENTS = 300
"""Components of blurred scenes: strokes are to be dark beside them."""

FLOOR = 0.01
"""Reflectance that a mirror of a mask is taken to add where a scene is dark."""

VARIATION = 0.1
"""Standard deviation of a mask's light between scenes that are alike, over its mean light."""

DWELLS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Dwells that a look may have, over the exposure's equal parts."""

STRICT = 0.6
"""Of the largest difference over light, above which a mirror of the strictest masks is ON."""

DARKEST_PIXEL = 1e-2
"""Least reflectance that the mean scene is taken to have, in choosing mirrors: it may be black."""

LOOK_COST = 0.1
"""Clicks that a look is taken to cost, were it dark for certain.

Chosen on validation images of MNIST on black. With 0 the first looks are dark and tell little;
where information less price times clicks is largest, the first looks nearly always click.
"""

COMPARED_SCENES = 256
"""Scenes drawn of the posterior by which looks are compared."""

PRICING_SCENES = 256
"""Training scenes by which the price is found: their mean clicks are known to some 3 %."""

PRICES = (1e-3, 1.0)
"""Lowest and highest price that is tried, nats a click."""

PRICE_STEP = 0.05
"""Relative precision of the price."""

NOT_AT_A_CAMERA = (
    "adaptive masks of detectors that click are tested in simulation alone: give a design of "
    "photon counts"
)
"""Why live runs and pages do not take these designs."""


class ClickLook(NamedTuple):
    """A look at exposures, each for its own time.

    Attributes
    ----------
    masks : tensor, shape (b, N)
        Of 0 and 1.
    dwells : tensor, shape (b,)
        Share of the whole exposure.
    worth : tensor, shape (b,)
        Nats that it is expected to tell of the class for each click that it costs.
    """

    masks: Tensor
    dwells: Tensor
    worth: Tensor


class ClickPosterior(AdaptivePosterior):
    """Posterior of the scene of exposures (b,) in each of whose looks a detector clicks or not.

    Parameters
    ----------
    prior : ScenePrior
        Of blurred scenes.
    exposures : int
        b.
    optics : LookOptics
        With the budget of a whole exposure.
    """

    def __init__(self, prior: ScenePrior, exposures: int, optics: LookOptics) -> None:
        super().__init__(prior, exposures, optics)
        self.left = torch.ones(exposures)
        """Share (b,) of the exposure that is left."""

    def rows_of(self, rows: Tensor) -> Self:
        """Posterior of some of the exposures, (b,) true."""
        some = super().rows_of(rows)
        some.left = self.left[rows]
        return some

    def take(self, look: ClickLook, clicks: Tensor) -> None:
        """Take in whether the detector clicked (b,) in a look."""
        mean, parts = self.prior.light(look.masks)
        light = mean[:, None] + parts @ self.prior.coefficients.T + FLOOR * _on(look.masks)
        none = log_no_click(light, mean[:, None], self.gain * look.dwells[:, None])
        some = torch.expm1(none).neg_().clamp_(min=LEAST_WEIGHT).log_()
        self.logs += torch.where(clicks[:, None] > 0, some, none)
        self.left = self.left - look.dwells
        self.end_look()

    def next_look(self, dwells: Tensor, generator: torch.Generator) -> ClickLook:
        """The look that is worth most, of all masks and dwells that are compared.

        Parameters
        ----------
        dwells : tensor, shape (L,)
            Shares of the exposure that a look may have.
        generator : torch.Generator
            Of the scenes by which looks are compared.
        """
        masks = click_candidates(self)  # (b, P, N)
        places, drawn = draw_places(self.weights, generator, COMPARED_SCENES)
        mean, parts = self.prior.light(masks)  # (b, P), (b, P, d)
        scenes = self.prior.coefficients[places].transpose(1, 2)  # (b, d, S)
        light = mean[..., None] + parts @ scenes + FLOOR * _on(masks)  # (b, P, S)
        none = log_no_click(light[:, :, None], mean[..., None, None], (self.gain * dwells)[:, None])
        chances = -torch.expm1(none.flatten(1, 2))  # (b, P · L, S) of a click
        members = torch.nn.functional.one_hot(self.prior.labels[places], self.prior.classes)
        told, clicks = click_information(chances, members * drawn[..., None])
        worth = (told / (clicks + LOOK_COST)).unflatten(1, (-1, len(dwells)))
        too_long = dwells > self.left[:, None] + 1e-6
        worth = worth.masked_fill(too_long[:, None], -torch.inf).flatten(1)
        best = worth.argmax(dim=1)
        rows = torch.arange(len(self))
        place = best.div(len(dwells), rounding_mode="floor")
        return ClickLook(masks[rows, place], dwells[best % len(dwells)], worth[rows, best])


def _on(masks: Tensor) -> Tensor:
    """Number (..., 1) of mirrors that are ON."""
    return masks.sum(dim=-1, keepdim=True)


def log_no_click(light: Tensor, mean: Tensor, gain: Tensor) -> Tensor:
    """Logarithm of the probability that a detector stays dark.

    The light is gamma distributed about its mean, with a standard deviation of `VARIATION` times
    the mean light of the mask.

    Parameters
    ----------
    light : tensor, shape (...)
        Summed reflectance behind a mask.
    mean : tensor, broadcastable to light
        Of the mean scene.
    gain : tensor, broadcastable to light
        Photons of a unit of summed reflectance.
    """
    light = light.clamp(min=1e-4)
    ratio = light / (VARIATION * mean.clamp(min=1e-4))
    size = ratio * ratio
    return -(size * (light * gain / size).log1p())


def click_information(chances: Tensor, members: Tensor) -> tuple[Tensor, Tensor]:
    """Nats (b, E) that a click or none tells of the class, and the probability (b, E) of a click.

    Parameters
    ----------
    chances : tensor, shape (b, E, S)
        Of a click in E looks at S scenes.
    members : tensor, shape (b, S, C)
        Weights of scenes in each class, all of them together 1.
    """
    joint = chances @ members.to(chances.dtype)  # (b, E, C)
    clicks = joint.sum(dim=-1)
    classes = members.sum(dim=1)[:, None]  # (b, 1, C)
    within = classes * _binary_entropy(joint / classes.clamp(min=1e-12))
    return _binary_entropy(clicks) - within.sum(dim=-1), clicks


def _binary_entropy(chance: Tensor) -> Tensor:
    """Nats of an event of such a probability."""
    chance = chance.clamp(0, 1)
    return torch.special.entr(chance) + torch.special.entr(1 - chance)


def click_candidates(state: AdaptivePosterior) -> Tensor:
    """Masks (b, P, N) that separate the likeliest classes in two groups, brightly or strictly."""
    weights = state.class_weights
    sums = state.class_sums
    count = min(LIKELIEST, weights.shape[1])
    likely, top = weights.topk(count, dim=1)
    own = sums.gather(1, top[..., None].expand(-1, -1, sums.shape[-1]))
    groups = groups_of(count).to(sums.dtype)
    means = [
        (group @ own) / (likely @ group.T).clamp(min=1e-9)[..., None]
        for group in (groups, 1 - groups)
    ]
    differ = (means[0] - means[1]) @ state.prior.components
    differ = torch.cat([differ, -differ], dim=1)
    scene = state.scene.clamp(min=DARKEST_PIXEL)[:, None].expand_as(differ)
    bright = difference_masks(differ, scene, state.optics.areas(scene))
    ratio = differ / scene
    strict = (ratio > STRICT * ratio.amax(dim=-1, keepdim=True)).to(differ.dtype)
    return torch.cat([bright, strict], dim=1)


class ClickRun(NamedTuple):
    """Exposures at their end.

    Attributes
    ----------
    chances : tensor, shape (b, C)
    clicks, arriving, used : tensor, shape (b,)
        Clicks and photons that are expected, and share of the budget that was used.
    """

    chances: Tensor
    clicks: Tensor
    arriving: Tensor
    used: Tensor


class ClickLooks(NamedTuple):
    """What exposes scenes, look after look, to their end.

    Attributes
    ----------
    prior : ScenePrior
        Of blurred scenes.
    settings : AdaptiveMasks
        With a price.
    photons : float
        Budget Φ.
    """

    prior: ScenePrior
    settings: AdaptiveMasks
    photons: float

    @torch.no_grad()
    def run(
        self,
        x: Tensor,
        generator: torch.Generator,
        *,
        log: list[tuple[Tensor, Tensor, Tensor]] | None = None,
        left_out: Tensor | None = None,
    ) -> ClickRun:
        """Expose scenes to their end.

        Parameters
        ----------
        x : tensor, shape (b, N)
            Reflectance.
        generator : torch.Generator
        log : list, optional
            Takes masks and mean scenes (b, N) and chances (b, C) of each look.
        left_out : tensor, shape (b,), optional
            Places in the prior of scenes that are not known.
        """
        looks = self.settings.looks
        state = ClickPosterior(self.prior, len(x), LookOptics(self.photons))
        if left_out is not None:
            state.leave_out(left_out)
        dwells = torch.tensor(DWELLS) / looks
        chances = torch.empty(len(x), self.prior.classes)
        clicks, arriving, used = torch.zeros(3, len(x))
        running = torch.arange(len(x))
        for _ in range(looks):
            look = state.next_look(dwells, generator)
            going = look.worth > (self.settings.price or -1.0)  # −∞ where no light is left
            chances[running] = state.chances
            if not bool(going.all()):
                state = state.rows_of(going)
                look = ClickLook(*(part[going] for part in look))
                running = running[going]
            if not len(running):
                break
            light = (look.masks * x[running]).sum(dim=1) * look.dwells * state.gain
            chance = -torch.expm1(-light)
            state.take(look, torch.rand(len(light), generator=generator) < chance)
            clicks[running] += chance
            arriving[running] += light
            used[running] += look.dwells
            chances[running] = state.chances
            if log is not None:
                log.append((look.masks, state.scene, state.chances))
        return ClickRun(chances, clicks, arriving, used)


@dataclass(frozen=True, eq=False)
class ClickingExposure(AdaptiveExposure):
    """Exposure with adaptive masks, whose looks are chosen for few clicks.

    Its fields are those of `AdaptiveExposure`; the prior is of blurred scenes.
    """

    refusals: ClassVar[dict[Use, str]] = AdaptiveExposure.refusals | {"page": NOT_AT_A_CAMERA}

    @property
    def title(self) -> str:
        """Number of looks, and of scenes that are known."""
        return f"at most {self.count} looks, {len(self.prior)} scenes known"

    def optics_at(self, photons: float, camera: Camera | None = None) -> LookOptics:
        """Raise `InputError`: no camera's run is computed by these."""
        raise InputError(NOT_AT_A_CAMERA)

    def front_end(self, camera: Camera | None) -> Camera:
        """The camera, or `InputError` where its detector does not click at most once a look."""
        front = super().front_end(camera)
        if front.clicks is None:
            raise InputError(
                "this design is for a detector that clicks, and {given} noise has none: give "
                "{noise:click}, or learn a design for it",
                setting="noise",
                given=front.noise_name,
            )
        AdaptiveMasks.check_camera(front)
        return front

    def observe(
        self, front: Camera, rates: Tensor, photons: float, generator: torch.Generator
    ) -> Iterator[PosteriorObservation]:
        """Raise `InputError`: exposures end by themselves, so that their looks are not compared."""
        raise InputError(POSTERIOR_ANSWERS)

    def expose(
        self, front: Camera, rates: Tensor, photons: float, generator: torch.Generator
    ) -> PosteriorObservation:
        """Exposures at their end; parameters of `observe`."""
        looks = ClickLooks(self.prior, self.settings, photons)
        parts = [looks.run(some, generator) for some in rates.split(self.exposed_at_once)]
        chances = torch.cat([part.chances for part in parts])
        return PosteriorObservation(
            chances[:, :0],
            chances=chances,
            counts=sum(float(part.clicks.sum()) for part in parts),
            arriving=sum(float(part.arriving.sum()) for part in parts),
            used=sum(float(part.used.sum()) for part in parts),
        )

    def light(
        self, front: Camera, rates: Tensor, seen: Observation, photons: float
    ) -> CountedLight:
        """Clicks of exposures together, photons that arrive, and light that was used."""
        assert isinstance(seen, PosteriorObservation)
        assert seen.used is not None
        assert seen.arriving is not None
        return CountedLight(seen.counts, seen.arriving, seen.used * photons)

    def stopping_at(self, threshold: float) -> "ClickingExposure":
        """Raise `InputError`: exposures end where no look is worth its price."""
        raise InputError(
            "exposures of this design end where no look is worth its clicks: give fewer {counts} "
            "to its training",
            setting="counts",
        )

    def look_by_look(self, scene: Tensor, photons: float, generator: torch.Generator) -> LookedAt:
        """One exposure of a scene (N,), look by look, up to its end."""
        log: list[tuple[Tensor, Tensor, Tensor]] = []
        ClickLooks(self.prior, self.settings, photons).run(scene[None], generator, log=log)
        return LookedAt(*(torch.cat(parts).numpy() for parts in zip(*log, strict=True)))


def blurred(data: Dataset) -> Dataset:
    """The data with training images that are blurred; other scenes along their only axis."""
    from scipy.ndimage import gaussian_filter

    x = np.asarray(data.x_train)
    scenes = x.reshape(len(x), *data.image_shape)
    smooth = gaussian_filter(scenes, (0, *(BLUR for _ in data.image_shape)))
    return replace(data, x_train=smooth.reshape(x.shape).astype(np.float32, copy=False))


class ClickTraining(AdaptiveTraining):
    """Adaptive masks of detectors that click: a prior of blurred scenes, and the price of a click.

    Parameters
    ----------
    data : Dataset
    settings : AdaptiveMasks
    """

    def __init__(self, data: Dataset, settings: AdaptiveMasks) -> None:
        self.data = data
        self.settings = settings.model_copy(
            update={"components": COMPONENTS, "spread": 0.0, "price": 0.0}
        )
        self.prior = prior_of(blurred(data), self.settings)
        self.prior.summed_reflectance = summed_reflectance(data.x_train)  # not of the blurred

    def make(self, job: Job, optics: Mapping[str, Any], report: Progress) -> ClickingExposure:
        """The exposure of a job, with its price and a temperature, found with training scenes.

        Each of them is left out of the prior.

        Parameters
        ----------
        job : Job
        optics : mapping
            Fields of the camera.
        report : Progress
        """
        generator = torch.Generator().manual_seed(job.seed)
        places, scenes = self._some(PRICING_SCENES, generator)
        tried = 0

        def run(price: float) -> ClickRun:
            nonlocal tried
            settings = self.settings.model_copy(update={"price": price})
            some = torch.Generator().manual_seed(job.seed)
            looks = ClickLooks(self.prior, settings, job.photons)
            parts = [
                looks.run(scenes[rows], some, left_out=places[rows])
                for rows in torch.arange(len(scenes)).split(exposures_at_once(self.prior))
            ]
            tried += 1
            report(tried / (tried + 2))
            return ClickRun(*(torch.cat(parts) for parts in zip(*parts, strict=True)))

        price, end = self._price(run, job.training.counts)
        settings = self.settings.model_copy(update={"price": price})
        labels = self.prior.labels[places]
        temperature = best_temperature(end.chances, labels, self.prior.class_shares)
        logs = np.full((settings.looks, 2), log(temperature))
        prior = self.prior.with_temperatures(
            Temperatures(logs, np.array([1e-3, 1e3]) * job.photons)
        )
        counted = torch.full((settings.looks,), float(end.arriving.mean()) / job.photons)
        return ClickingExposure(
            prior,
            settings,
            shape=self.data.image_shape,
            counted=counted / settings.looks,
            optics=optics,
        )

    @staticmethod
    def _price(run: Any, counts: float | None) -> tuple[float, ClickRun]:
        """Price at which exposures click so often in the mean, and these exposures."""
        from scipy.optimize import brentq

        runs = {0.0: run(0.0)}
        if counts is None or float(runs[0.0].clicks.mean()) <= counts:
            return 0.0, runs[0.0]

        def excess(level: float) -> float:
            runs[level] = run(float(np.exp(level)))
            return float(runs[level].clicks.mean()) - counts

        low, high = np.log(PRICES)
        level = brentq(excess, low, high, xtol=PRICE_STEP, rtol=1e-3, maxiter=12)
        nearest = min(runs, key=lambda tried: abs(tried - level))
        return float(np.exp(nearest)), runs[nearest]


def best_temperature(chances: Tensor, labels: Tensor, shares: Tensor) -> float:
    """Temperature of the odds of classes to their shares at which labels have the least log loss.

    Parameters
    ----------
    chances : tensor, shape (n, C)
    labels : tensor, shape (n,)
    shares : tensor, shape (C,)
        Of the classes before any look.
    """
    from scipy.optimize import minimize_scalar

    base = shares.log().double()
    odds = chances.double().clamp(min=LEAST_WEIGHT).log() - base

    def loss(level: float) -> float:
        return float(torch.nn.functional.cross_entropy(odds / np.exp(level) + base, labels))

    bounds = (LOG_BOUNDS[0], 3.0)
    return float(np.exp(minimize_scalar(loss, bounds=bounds, method="bounded").x))

"""Adaptive masks before a detector that clicks at most once a look, where a click has a price.

A look that stays dark costs no count, and tells something, too. Each look, mask and dwell together,
is chosen for its expected information on the class over its cost: the probability of a click, and a
small price of the look and of its light. An exposure ends when no look gives as much information
for a click as the price asks, after all looks, or when no light is left for the next look. If it
ends without a click, it takes a look with all mirrors ON; if the detector stays dark again, it has
told nothing.

Sources: sequential design by expected information (Lindley 1956), with a cost of the observation
(DeGroot, *Optimal Statistical Decisions*, 1970).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from deepfsi.adaptive.choice import difference_masks, draw_scenes
from deepfsi.adaptive.exposure import (
    AdaptiveExposure,
    AdaptiveTraining,
    LeftOutAnswers,
    answer_of,
    prior_of,
)
from deepfsi.adaptive.posterior import LEAST_WEIGHT, AdaptivePosterior, LookOptics, ScenePrior
from deepfsi.base.errors import InputError
from deepfsi.base.progress import Progress
from deepfsi.camera.camera import Camera
from deepfsi.camera.light import summed_reflectance
from deepfsi.datasets.dataset import Dataset
from deepfsi.exposure.kind import Answer, CountedLight, Exposures, Network, Use
from deepfsi.jobs.exposures import AdaptiveMasks
from deepfsi.jobs.job import Job

FLOOR = 0.01
"""Reflectance of each mirror of a mask where a scene is dark: no mask is taken to be dark."""

VARIATION = 0.05
"""Standard deviation of the light of a mask among scenes that are alike, over its mean."""

PRICING_SCENES = 512
"""Training scenes that set the price: their mean clicks are known to about 3 %."""

NOT_AT_A_CAMERA = (
    "adaptive masks of detectors that click are tested in simulation alone: give a design of "
    "photon counts"
)
"""Why live runs and pages refuse these designs."""


class ClickLook(NamedTuple):
    """A look at exposures, each for its own time."""

    masks: Tensor  # (b, N), of 0 and 1
    dwells: Tensor  # (b,), share of the whole exposure
    worth: Tensor  # (b,)


class ClickPosterior(AdaptivePosterior):
    """Posterior of the scene of exposures (b,) in each of whose looks a detector clicks or not."""

    def __init__(self, prior: ScenePrior, exposures: int, optics: LookOptics) -> None:
        super().__init__(prior, exposures, optics)
        self.left = torch.ones(exposures)  # share of the exposure that is left

    def rows_of(self, rows: Tensor) -> Self:
        """Posterior of the exposures where `rows` (b,) is true."""
        kept = super().rows_of(rows)
        kept.left = self.left[rows]
        return kept

    def take(self, look: ClickLook, clicks: Tensor) -> None:
        """Take in whether the detector clicked (b,) in a look."""
        mean, responses = self.prior.light(look.masks)
        light = mean[:, None] + responses @ self.prior.coefficients.T + FLOOR * _on(look.masks)
        variance = _light_variance(mean, responses)[:, None]
        dark = log_no_click(light, variance, self.gain * look.dwells[:, None])
        # a click in the dark would have the logarithm −∞
        click = torch.expm1(dark).neg_().clamp_(min=LEAST_WEIGHT).log_()
        self.log_weights += torch.where(clicks[:, None] > 0, click, dark)
        self.left = self.left - look.dwells
        self._end_look()

    def candidates(self) -> Tensor:
        """Masks (b, P, N) that separate the likeliest classes, brightly or strictly."""
        differ = self.group_differences()
        scene = self.scene.clamp(min=1e-2)[:, None].expand_as(differ)  # it may be black
        bright = difference_masks(differ, scene, self.optics.areas(scene))
        ratio = differ / scene
        largest = ratio.amax(dim=-1, keepdim=True)
        # mirrors ON where the ratio is near its largest: dimmer masks, which click less often
        strict = [(ratio > share * largest).to(differ.dtype) for share in (0.4, 0.6, 0.8)]
        return torch.cat([bright, *strict], dim=1)

    def next_look(self, dwells: Tensor, costs: Tensor, generator: torch.Generator) -> ClickLook:
        """The look worth most: one of all masks, dwells (L,) and their costs (L,) in clicks."""
        masks = self.candidates()  # (b, P, N)
        indices, drawn = draw_scenes(self.weights, generator, 256)
        mean, responses = self.prior.light(masks)  # (b, P), (b, P, d)
        scenes = self.prior.coefficients[indices].transpose(1, 2)  # (b, d, S)
        light = mean[..., None] + responses @ scenes + FLOOR * _on(masks)  # (b, P, S)
        variance = _light_variance(mean, responses)[..., None, None]
        dark = log_no_click(light[:, :, None], variance, (self.gain * dwells)[:, None])
        probabilities = -torch.expm1(dark.flatten(1, 2))  # (b, P · L, S) of a click
        members = torch.nn.functional.one_hot(self.prior.labels[indices], self.prior.classes)
        outcomes = click_information(probabilities, members * drawn[..., None])
        # both (b, P, L)
        nats, clicks = (outcome.unflatten(1, (-1, len(dwells))) for outcome in outcomes)
        worth = nats / (clicks + costs)
        too_long = dwells > self.left[:, None] + 1e-6
        worth = worth.masked_fill(too_long[:, None], -torch.inf).flatten(1)
        best = worth.argmax(dim=1)
        rows = torch.arange(len(self))
        mask = best.div(len(dwells), rounding_mode="floor")
        return ClickLook(masks[rows, mask], dwells[best % len(dwells)], worth[rows, best])


def _on(masks: Tensor) -> Tensor:
    """Number (..., 1) of mirrors that are ON."""
    return masks.sum(dim=-1, keepdim=True)


def _light_variance(mean: Tensor, responses: Tensor) -> Tensor:
    """Variance (...) of light among scenes that are alike, from light (...) and (..., d)."""
    # as among neighbours of the prior: a mask of few mirrors varies more, over its mean
    return (VARIATION * mean.clamp(min=1e-4)).square() + responses.square().sum(dim=-1)


def log_no_click(light: Tensor, variance: Tensor, gain: Tensor) -> Tensor:
    """Log-probability (...) that a detector stays dark before light that varies.

    `gain` is the photons of a unit of summed reflectance.
    """
    # a gamma distribution of this mean and variance has a closed form
    light = light.clamp(min=1e-4)
    size = light * light / variance
    return -(size * (light * gain / size).log1p())


def click_information(probabilities: Tensor, members: Tensor) -> tuple[Tensor, Tensor]:
    """Nats (b, E) that a click or none tells of the class, and the probability (b, E) of a click.

    Shapes: probabilities (b, E, S) of a click in E looks at S scenes; weights (b, S, C) of the
    scenes in classes, with the sum 1.
    """
    joint = probabilities @ members.to(probabilities.dtype)  # (b, E, C)
    clicks = joint.sum(dim=-1)
    classes = members.sum(dim=1)[:, None]  # (b, 1, C)
    within = classes * _binary_entropy(joint / classes.clamp(min=1e-12))
    return _binary_entropy(clicks) - within.sum(dim=-1), clicks


def _binary_entropy(probability: Tensor) -> Tensor:
    """Nats of an event with a probability (...)."""
    p = probability.clamp(0, 1)  # sums of weights may round to more than 1
    return torch.special.entr(p) + torch.special.entr(1 - p)


class _ClickRun(NamedTuple):
    """Exposures at their end."""

    probabilities: Tensor  # (b, C)
    clicks: Tensor  # (b,)
    arriving: Tensor  # (b,)
    used: Tensor  # (b,)


class _ClickStep(NamedTuple):
    """A look at those exposures that still go on."""

    rows: Tensor  # (r,), which of the exposures
    look: ClickLook
    probabilities: Tensor  # (r, C)
    odds: Tensor  # (r, C)
    clicked: Tensor  # (r,)
    clicks: Tensor  # (r,)
    arriving: Tensor  # (r,)


class ClickLooks(NamedTuple):
    """Looks at scenes, one after another, to the end of their exposures."""

    prior: ScenePrior
    settings: AdaptiveMasks
    photons: float  # budget Φ

    def posterior(self, exposures: int) -> ClickPosterior:
        """Posterior of exposures before the first look."""
        return ClickPosterior(self.prior, exposures, LookOptics(self.photons))

    @torch.no_grad()
    def steps(
        self, state: ClickPosterior, x: Tensor, generator: torch.Generator
    ) -> Iterator[_ClickStep]:
        """Looks at scenes (b, N), from the state before all looks."""
        dwells = torch.tensor((0.25, 0.5, 1.0, 2.0, 4.0, 8.0)) / self.settings.looks
        # A look that is dark for certain costs 0.1 clicks, chosen on validation images of MNIST on
        # black. With 0 the first looks are dark and tell little; where information less price
        # times clicks is largest, they nearly always click
        costs = 0.1 + self.settings.light_price * self.photons * dwells
        running = torch.arange(len(x))
        for _ in range(self.settings.looks):
            look = state.next_look(dwells, costs, generator)
            going = look.worth > (self.settings.price or -1.0)  # −∞ where no light is left
            if not bool(going.all()):
                state = state.rows_of(going)
                look = ClickLook(*(tensor[going] for tensor in look))
                running = running[going]
            if not len(running):
                return
            light = (look.masks * x[running]).sum(dim=1) * look.dwells * state.gain
            expected = -torch.expm1(-light)
            clicked = torch.rand(len(light), generator=generator) < expected
            state.take(look, clicked)
            yield _ClickStep(
                running,
                look,
                probabilities=state.probabilities,
                odds=state.odds,
                clicked=clicked,
                clicks=expected,
                arriving=light,
            )

    def run(self, x: Tensor, generator: torch.Generator) -> _ClickRun:
        """Exposures of scenes (b, N) at their end."""
        state = self.posterior(len(x))
        probabilities = state.probabilities
        clicks, arriving, used = torch.zeros(3, len(x))
        clicked = torch.zeros(len(x), dtype=torch.bool)
        for step in self.steps(state, x, generator):
            clicks[step.rows] += step.clicks
            arriving[step.rows] += step.arriving
            used[step.rows] += step.look.dwells
            probabilities[step.rows] = step.probabilities
            clicked[step.rows] |= step.clicked
        dark = ~clicked & (used > 0)
        # 20 photons: the detector clicks all but surely
        dwells = dark * (1 - used).clamp(min=0.0, max=20.0 / self.photons)
        light = x.sum(dim=1) * dwells * state.gain
        # the look with all mirrors ON
        seen = -torch.expm1(-light)
        silent = dark & (torch.rand(len(x), generator=generator) >= seen)
        # dark with all mirrors ON: the detector told nothing
        probabilities[silent] = self.prior.class_shares
        return _ClickRun(probabilities, clicks + seen, arriving + light, used + dwells)


@dataclass(frozen=True, eq=False)
class _ClickingExposure(AdaptiveExposure):
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

    def exposures(self, scenes: Tensor, camera: Camera, network: Network) -> Exposures:
        """Exposures of scenes (n, N) up to their end, by a camera that clicks once a look."""
        if camera.clicks is None:
            raise InputError(
                f"this design is for a detector that clicks, and {camera.noise_name} noise has "
                'none: give `noise="click"`, or learn a design for it'
            )
        AdaptiveMasks.check_camera(camera)

        def expose(photons: float, generator: torch.Generator) -> tuple[Answer, CountedLight]:
            looks = ClickLooks(self.prior, self.settings, photons)
            runs = [looks.run(x, generator) for x in scenes.split(self.prior.exposed_at_once)]
            probabilities = torch.cat([run.probabilities for run in runs])
            counts, arriving, used = (
                sum(float(batch.sum()) for batch in batches)
                for batches in zip(*(run[1:] for run in runs), strict=True)
            )
            return answer_of(probabilities), CountedLight(counts, arriving, used * photons)

        return expose


def blurred(data: Dataset) -> Dataset:
    """The data with blurred training scenes: images in both axes, spectra in their only one."""
    from scipy.ndimage import gaussian_filter

    x = np.asarray(data.x_train)
    scenes = x.reshape(len(x), *data.image_shape)
    # scenes of the prior are known to about a mirror: a blur of half a pixel
    smooth = gaussian_filter(scenes, (0, *(0.5 for _ in data.image_shape)))
    return replace(data, x_train=smooth.reshape(x.shape).astype(np.float32, copy=False))


class ClickTraining(AdaptiveTraining):
    """Adaptive masks of detectors that click: a prior of blurred scenes, and a click's price."""

    kind = _ClickingExposure

    def __init__(self, data: Dataset, settings: AdaptiveMasks) -> None:
        self.data = data
        self.settings = settings.model_copy(update={"components": 300, "spread": 0.3, "price": 0.0})
        self.prior = prior_of(blurred(data), self.settings)
        self.prior.summed_reflectance = summed_reflectance(data.x_train)  # not of the blurred

    def make(self, job: Job, report: Progress) -> tuple[_ClickingExposure, LeftOutAnswers]:
        """The exposure of a job with its price, found with training scenes; answers to these.

        Each of them is left out of the prior.
        """
        generator = torch.Generator().manual_seed(job.seed)
        left_out = self.left_out(PRICING_SCENES, generator)
        asked = job.training.counts
        # All light costs 15 clicks, or those asked for if they are fewer, so that light and clicks
        # end together. If light costs nothing, dark looks use it up after five clicks of MNIST on
        # black; if it costs three times the clicks, a sixth of it is used, and clicks tell less
        light_price = min(15.0, asked or 15.0) / job.photons
        settings = self.settings.model_copy(update={"light_price": light_price})
        looks = ClickLooks(self.prior, settings, job.photons)  # no price: they end without light
        runs = []
        at_once = self.prior.exposed_at_once
        for rows, scenes, state in left_out.states(looks.posterior, at_once, report):
            steps = looks.steps(state, scenes, generator)
            size = len(rows), settings.looks
            runs.append(PricedLooks.of(steps, size, self.prior.classes))
        priced = PricedLooks(*(torch.cat(tensors) for tensors in zip(*runs, strict=True)))
        price = 1e-3  # nats for a click below which a look tells nothing
        if asked is not None:
            price = max(price, priced.price(asked))
        if not bool((priced.least_worth > price).any()):
            raise InputError(
                f"no exposure of these masks costs as few clicks as {asked}: give more `counts`"
            )
        odds, arriving = priced.ends(price)
        exposure = _ClickingExposure(
            self.prior,
            settings.model_copy(update={"price": price}),
            image_shape=self.data.image_shape,
            shares=arriving.mean(dim=0) / job.photons,
            camera=job.camera,
        )
        answers = LeftOutAnswers(np.array([job.photons]), odds[None, None], left_out.labels)
        return exposure, answers


class PricedLooks(NamedTuple):
    """All looks of exposures; a price only says after which look each exposure ends."""

    worth: Tensor  # (n, K)
    clicks: Tensor  # (n, K)
    arriving: Tensor  # (n, K)
    odds: Tensor  # (n, 1 + K, C), log odds of the classes before all looks, and after each
    dark: Tensor  # (n, 1 + K), whether no look has clicked so far

    @classmethod
    def of(cls, steps: Iterable[_ClickStep], size: tuple[int, int], classes: int) -> Self:
        """Looks of a run of n exposures with at most K looks."""
        worth = torch.full(size, -torch.inf)
        clicks, arriving = torch.zeros(2, *size)
        odds = torch.zeros(size[0], 1 + size[1], classes)
        dark = torch.ones(size[0], 1 + size[1], dtype=torch.bool)
        dark[:, 0] = False
        for look, step in enumerate(steps):
            worth[step.rows, look] = step.look.worth
            clicks[step.rows, look] = step.clicks
            arriving[step.rows, look] = step.arriving
            odds[step.rows, look + 1 :] = step.odds[:, None]
            dark[step.rows, look + 1 :] &= ~step.clicked[:, None]
        return cls(worth, clicks, arriving, odds, dark)

    @property
    def least_worth(self) -> Tensor:
        """Least worth (n, K) of all looks so far: an exposure goes on while it is above the price.

        A later look is taken only if all before it were.
        """
        return self.worth.cummin(dim=1).values

    def price(self, clicks: float) -> float:
        """Lowest price at which exposures cost no more clicks in the mean; 0 if they never do.

        An exposure that ends dark costs one more, of the look with all mirrors ON.
        """
        worth, order = self.least_worth.flatten().sort(descending=True)
        bright = self.dark.double()
        added = self.clicks.double() + bright[:, 1:] - bright[:, :-1]
        total = added.flatten()[order].cumsum(dim=0) / len(self.clicks)
        affordable = int((total <= clicks).double().cumprod(dim=0).sum())
        if affordable == len(worth):
            return 0.0
        return max(float(worth[affordable]), 0.0)

    def ends(self, price: float) -> tuple[Tensor, Tensor]:
        """Log odds (n, C) where exposures end at a price, and photons (n, K) that arrive before."""
        going = self.least_worth > price
        rows = torch.arange(len(going))
        return self.odds[rows, going.sum(dim=1)], self.arriving * going

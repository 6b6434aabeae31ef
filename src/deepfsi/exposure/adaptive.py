"""Exposures with adaptive masks: their looks, their misfit, and their training, which has no steps.

Before a look the posterior says which counts are to be expected, and how they vary. Were scenes
just as the prior has them, the squared distance of counts from that, in the metric of their
covariance, would be 1 a readout in the mean, whatever was shown before. How large the sum of all
looks is, is measured with training scenes, each of which is left out of the prior; centres of
clusters stay, as each stands for many scenes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepfsi.base.numeric import check_memory, free_memory
from deepfsi.datasets import Dataset
from deepfsi.exposure.choice import next_masks
from deepfsi.exposure.posterior import AdaptivePosterior, LookOptics
from deepfsi.exposure.prior import ScenePrior
from deepfsi.jobs import AdaptiveMasks, Job
from deepfsi.physics import Poisson

AT_ONCE = 2**22
"""Log-likelihoods that are held at a time."""

COPIES = 6
"""Arrays as large as the log-likelihoods, or as the scenes of the prior, held at a time."""


class Look(NamedTuple):
    """One look of exposures."""

    masks: Tensor  # (b, N) of 0 and 1
    counts: Tensor  # (b, Q)
    light: Tensor  # (b, Q), counts that are expected without dark ones


def look_at(state: AdaptivePosterior, x: Tensor, share: float, generator: torch.Generator) -> Look:
    """Next look at scenes (b, N) for a share of the exposure, which the state does not know yet."""
    masks = next_masks(state, share, generator)
    expected = state.expected(masks, x, share)
    return Look(masks, Poisson().draw(expected, generator), expected - state.optics.dark * share)


def expose(
    state: AdaptivePosterior, x: Tensor, settings: AdaptiveMasks, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Expose scenes (b, N) look after look until each stops, from the state before all looks.

    Probabilities (b, C) of the classes, and the sum (looks,) of the expected counts of all
    exposures without dark counts.
    """
    chances = torch.empty(len(x), state.prior.classes)
    counts, running = torch.zeros(settings.looks, dtype=torch.double), torch.arange(len(x))
    for look, share in enumerate(settings.shares):
        masks, found, light = look_at(state, x[running], share, generator)
        state.update(masks, found, share)
        counts[look] = light.double().sum()
        last = look == settings.looks - 1
        if settings.until < 1 or last:
            chances[running] = state.chances
            going = chances[running].amax(dim=1) <= settings.until
            if not last and not bool(going.all()):
                state, running = state.part(going), running[going]
        if not len(running):
            break
    return chances, counts


def prior_of(data: Dataset, settings: AdaptiveMasks) -> ScenePrior:
    """Prior of the training scenes of a data set, or `InputError` if it does not fit the memory.

    Parameters
    ----------
    data : Dataset
    settings : AdaptiveMasks
    """
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


MISFIT_BUDGETS = (0.1, 1.0, 10.0)
"""Budgets of the measurement, over that of the training."""

SMALLEST_MISFIT = 1e-6
"""Misfit below which it is taken for this."""

FEWEST_MISFIT_SCENES = 50
"""Training scenes below which nothing is measured."""

MISFIT_SCENES = 128
"""Training scenes that are exposed at each budget, at most."""


def squared_distance(
    state: AdaptivePosterior, masks: Tensor, counts: Tensor, share: float
) -> Tensor:
    """Squared distance (b,) of counts (b, Q) behind the next masks (b, N) from those expected."""
    mean, parts = state.prior.light(state.optics.readouts(masks))
    gain, dark = state.gain * share, torch.as_tensor(state.optics.dark * share)
    left, weights = state.unknown(parts), state.weights[..., None]
    scenes = left @ state.prior.coefficients.T  # (b, Q, n)
    usual = scenes @ weights
    apart = scenes - usual
    light = (mean + state.seen(parts) + usual[..., 0]).clamp(min=0)
    expected = light * gain + dark
    covariance = (apart * weights[:, None, :, 0]) @ apart.transpose(1, 2)
    if state.prior.spread:
        covariance = covariance + left @ parts.transpose(1, 2)
    noise = torch.diag_embed(expected.clamp(min=1e-6))
    away = (counts - expected)[..., None]
    solved = torch.linalg.solve(covariance * gain**2 + noise, away)
    return (away * solved)[..., 0].sum(dim=1)


@dataclass(frozen=True, eq=False)
class UsualMisfit:
    """Misfit of training scenes after each look, at several budgets."""

    budgets: np.ndarray  # (B,)
    logarithms: np.ndarray  # (2, B, K): mean and standard deviation of its logarithm

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays as a design file takes them."""
        return {"misfit_budgets": self.budgets, "misfit_logarithms": self.logarithms}

    @classmethod
    def restored(cls, arrays: Mapping[str, np.ndarray], looks: int) -> "UsualMisfit | None":
        """Misfit from a file, None if it has none, or `ValueError` if it is damaged."""
        if "misfit_budgets" not in arrays:
            return None
        made = cls(arrays["misfit_budgets"], arrays["misfit_logarithms"])
        for held, shape in (
            (made.budgets, (len(MISFIT_BUDGETS),)),
            (made.logarithms, (2, len(MISFIT_BUDGETS), looks)),
        ):
            if held.shape != shape or held.dtype != np.float64:
                raise ValueError("the misfit is of another design")
            if not np.isfinite(held).all():
                raise ValueError("the misfit is none")
        positive = made.budgets[0] > 0 and made.logarithms[1].min() > 0
        if not (positive and (np.diff(made.budgets) > 0).all()):
            raise ValueError("the misfit is none")
        return made

    def chance(self, total: float, look: int, photons: float) -> float:
        """Share of sound exposures with so large a misfit after a look, from 0, at a budget."""
        from scipy.special import ndtr

        at = np.log(np.clip(photons, self.budgets[0], self.budgets[-1]))
        mean, deviation = (
            np.interp(at, np.log(self.budgets), each[:, look]) for each in self.logarithms
        )
        return float(ndtr((mean - np.log(max(total, SMALLEST_MISFIT))) / deviation))


@torch.no_grad()
def measure(
    prior: ScenePrior,
    settings: AdaptiveMasks,
    optics: Sequence[LookOptics],
    scenes: Tensor,
    places: Tensor | None,
    generator: torch.Generator,
) -> tuple[np.ndarray, Tensor]:
    """Misfit and counts of scenes (S, N) in looks at several budgets, without their own places.

    Mean and standard deviation (2, B, K) of the logarithm of the misfit after each look, which is
    nearly normal; mean counts (B, K) of each look.
    """
    totals = torch.zeros(len(optics), settings.looks, len(scenes), dtype=torch.double)
    counted = torch.zeros(len(optics), settings.looks, dtype=torch.double)
    for row, each in enumerate(optics):
        state = AdaptivePosterior(prior, len(scenes), each)
        if places is not None:
            state.logs[torch.arange(len(scenes)), places] = -torch.inf
        for look, share in enumerate(settings.shares):
            masks, counts, light = look_at(state, scenes, share, generator)
            totals[row, look] = squared_distance(state, masks, counts, share)
            counted[row, look] = light.double().sum() / len(scenes)
            state.update(masks, counts, share)
    logs = totals.cumsum(dim=1).clamp(min=SMALLEST_MISFIT).log()
    return torch.stack([logs.mean(dim=-1), logs.std(dim=-1)]).numpy(), counted


class AdaptiveTraining:
    """Adaptive masks of jobs that differ in budget and seed: one prior of scenes, and no steps.

    Parameters
    ----------
    data : Dataset
    settings : AdaptiveMasks
    """

    def __init__(self, data: Dataset, settings: AdaptiveMasks) -> None:
        self.data = data
        self.settings = settings
        self.prior = prior_of(data, settings)

    def finish(self, job: Job) -> tuple[Tensor, UsualMisfit | None]:
        """Share of the budget (K,) that each look counts of training scenes, and their misfit."""
        prior = self.prior
        settings = self.settings
        shape = self.data.image_shape
        generator = torch.Generator().manual_seed(job.seed)
        places = torch.randperm(len(prior.order), generator=generator)[:MISFIT_SCENES]
        scenes = torch.from_numpy(self.data.x_train[prior.order[places.numpy()]])
        budgets = np.array(MISFIT_BUDGETS) * job.photons
        optics = [LookOptics.of(job.optics, shape, each) for each in budgets.tolist()]
        left_out = places if settings.clusters is None else None
        logarithms, counts = measure(
            prior, settings, optics, scenes, places=left_out, generator=generator
        )
        shares = (counts[MISFIT_BUDGETS.index(1.0)] / job.photons).float()
        few = len(scenes) < FEWEST_MISFIT_SCENES
        return shares, None if few else UsualMisfit(budgets, logarithms)

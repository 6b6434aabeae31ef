"""Misfit of an exposure: how far its counts are from those that were expected, look after look.

Before a look the posterior says which counts are to be expected, and how they vary. Were scenes
just as the prior has them, the squared distance of counts from that, in the metric of their
covariance, would be 1 a readout in the mean, whatever was shown before. How large the sum of all
looks is, is measured with training scenes, each of which is left out of the prior; centres of
clusters stay, as each stands for many scenes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.special import ndtr
from torch import Tensor

from deepfsi.exposure.choice import look_at
from deepfsi.exposure.posterior import AdaptivePosterior, LookOptics
from deepfsi.exposure.prior import ScenePrior
from deepfsi.jobs import AdaptiveMasks

BUDGETS = (0.1, 1.0, 10.0)
"""Budgets of the measurement, over that of the training."""

SMALLEST = 1e-6
"""Misfit below which it is taken for this."""

LEAST_SCENES = 50
"""Training scenes below which nothing is measured."""

MOST_SCENES = 128
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
            (made.budgets, (len(BUDGETS),)),
            (made.logarithms, (2, len(BUDGETS), looks)),
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
        at = np.log(np.clip(photons, self.budgets[0], self.budgets[-1]))
        mean, deviation = (
            np.interp(at, np.log(self.budgets), each[:, look]) for each in self.logarithms
        )
        return float(ndtr((mean - np.log(max(total, SMALLEST))) / deviation))


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
    logs = totals.cumsum(dim=1).clamp(min=SMALLEST).log()
    return torch.stack([logs.mean(dim=-1), logs.std(dim=-1)]).numpy(), counted

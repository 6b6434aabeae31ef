"""Test of an exposure: whether its counts look like those of the training's scenes.

Two statistics compare them. The *misfit* is a squared distance of the counts from those that scenes
of the training would give: from those of the nearest class for masks that are known before, from
the posterior's prediction before each look for adaptive masks. The *light* is all counts over those
of the mean scene: those behind all masks, or of an all-ON frame for adaptive ones. Both are
compared with training scenes that were left out, so that 1 sound scene in 200 is unlike.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

FALSE_ALARM = 0.005
"""Chance, at most, that a sound scene is unlike the training, or that a sound run is refused."""

MISFIT_BUDGETS = (0.1, 1.0, 10.0)
"""Budgets at which the misfit is measured, as multiples of the training's."""

FEWEST_LEFT_OUT = 40
"""Training scenes that tell the standard deviation of the misfit well enough."""

SMALLEST = 1e-6
"""Misfit or share of the light below which it is taken for this."""


class SceneLight(NamedTuple):
    """Light of exposures, over that of the training's mean scene."""

    share: np.ndarray  # (...)
    spread: float  # relative standard deviation of scenes
    noise: float  # standard deviation of the share, by photons


@dataclass(frozen=True, eq=False)
class UsualMisfit:
    """Misfit after each look, at B budgets, and light of training scenes."""

    budgets: np.ndarray  # (B,)
    logarithms: np.ndarray  # (2, B, K): mean and standard deviation of the misfit's logarithm
    light: np.ndarray  # (2,), of the dimmest and the brightest scene over that of the mean one

    @classmethod
    def of(cls, budgets: np.ndarray, misfits: np.ndarray, light: np.ndarray) -> "UsualMisfit":
        """Usual misfit (B, K, S) of scenes after each look: its logarithm is near normal."""
        logs = np.log(misfits.clip(min=SMALLEST))
        moments = np.stack([logs.mean(axis=-1), logs.std(axis=-1, ddof=1)])
        return cls(budgets, moments, np.array([light.min(), light.max()]) / light.mean())

    @classmethod
    def restored(cls, arrays: Mapping[str, np.ndarray], looks: int) -> "UsualMisfit":
        """Misfit from a file, or `ValueError` if it is damaged."""
        # files of earlier versions have no light: no scene is too bright or too dim for them
        misfit = cls(**{"light": np.array([0, np.inf]), **arrays})
        budgets = len(MISFIT_BUDGETS)
        shapes = [array.shape for array in vars(misfit).values()]
        numbers = np.append(misfit.budgets, misfit.logarithms)
        fits = shapes == [(budgets,), (2, budgets, looks), (2,)] and numbers.dtype == np.float64
        rises = fits and np.diff(misfit.budgets, prepend=0).min() > 0
        if not (rises and misfit.logarithms[1].min() > 0 and np.isfinite(numbers).all()):
            raise ValueError("the misfit is of another design")
        return misfit

    def p_values(
        self, misfit: np.ndarray, looks: np.ndarray | int, photons: float, light: SceneLight
    ) -> np.ndarray:
        """Share of sound exposures (s,) of a larger misfit, or of light further from usual."""
        from scipy.special import ndtr

        # beyond the measured budgets the misfit of the nearest one holds
        row = np.interp(np.log(photons), np.log(self.budgets), np.arange(len(self.budgets)))
        below = min(int(row), len(self.budgets) - 2)
        moments = self.logarithms[:, below] * (below + 1 - row)
        mean, deviation = (moments + self.logarithms[:, below + 1] * (row - below))[:, looks - 1]
        by_misfit = ndtr((mean - np.log(np.maximum(misfit, SMALLEST))) / deviation)
        spread = np.sqrt(np.log1p(light.spread**2 + light.noise**2))
        by_light = 2 * ndtr(-np.abs(np.log(np.maximum(light.share, SMALLEST))) / spread)
        # few scenes tell no tail, and many have one that is not normal: both must be passed
        dimmest, brightest = self.light + 3 * light.noise * np.array([-1, 1])
        usual = (dimmest <= light.share) & (light.share <= brightest)
        # the smaller of two p-values, doubled (Bonferroni)
        return np.minimum(1.0, 2 * np.minimum(by_misfit, np.where(usual, 1.0, by_light)))

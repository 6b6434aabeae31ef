"""Test of an exposure: whether its counts look like those of the training's scenes.

Two statistics compare them. The *misfit* is a squared distance of the counts from those that scenes
of the training would give: from those of the nearest class for masks that are known before, from
the posterior's prediction before each look for adaptive masks. The *light* is all counts over those
of the mean scene, of an all-ON frame or behind all masks. They are compared with those of training
scenes, left out of what the misfit is measured by, so that 1 sound scene in 200 is unlike.
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
    usual: np.ndarray  # (2,), shares of the dimmest and the brightest scene of the training


@dataclass(frozen=True, eq=False)
class UsualMisfit:
    """Misfit after each look, at B budgets, and light of training scenes."""

    budgets: np.ndarray  # (B,)
    logarithms: np.ndarray  # (2, B, K): mean and standard deviation of the misfit's logarithm
    # (L, 2): light of the dimmest and the brightest scene over that of the mean one, in an all-ON
    # frame, and behind all masks that are known before
    light: np.ndarray

    @classmethod
    def of(cls, budgets: np.ndarray, misfits: np.ndarray, *lights: np.ndarray) -> "UsualMisfit":
        """Usual misfit (B, K, S) after each look, its logarithm near normal, and lights (n,)."""
        logs = np.log(misfits.clip(min=SMALLEST))
        moments = np.stack([logs.mean(axis=-1), logs.std(axis=-1, ddof=1)])
        light = np.array([[light.min(), light.max()] / light.mean() for light in lights])
        return cls(budgets, moments, light)

    @classmethod
    def restored(cls, arrays: Mapping[str, np.ndarray], looks: int) -> "UsualMisfit":
        """Misfit from a file, or `ValueError` if it is damaged."""
        # files of earlier versions have no light: no scene is too bright or too dim for them
        misfit = cls(**{"light": np.array([[0.0, 1e300]]), **arrays})
        budgets = len(MISFIT_BUDGETS)
        shapes = [array.shape for array in vars(misfit).values()]
        numbers = np.append(misfit.budgets, misfit.logarithms)
        known = shapes[:2] == [(budgets,), (2, budgets, looks)] and shapes[2][1:] == (2,)
        fits = known and numbers.dtype == np.float64
        rises = fits and np.diff(misfit.budgets, prepend=0).min() > 0
        if not (rises and misfit.logarithms[1].min() > 0 and np.isfinite(numbers).all()):
            raise ValueError("the misfit is of another design")
        return misfit

    def p_values(
        self, misfit: np.ndarray, looks: np.ndarray | int, photons: float, *lights: SceneLight
    ) -> np.ndarray:
        """Share of sound exposures (s,) of a larger misfit, or of a light further from usual."""
        from scipy.special import ndtr

        # beyond the measured budgets the misfit of the nearest one holds
        row = np.interp(np.log(photons), np.log(self.budgets), np.arange(len(self.budgets)))
        below = min(int(row), len(self.budgets) - 2)
        moments = self.logarithms[:, below] * (below + 1 - row)
        mean, deviation = (moments + self.logarithms[:, below + 1] * (row - below))[:, looks - 1]
        p_values = [ndtr((mean - np.log(np.maximum(misfit, SMALLEST))) / deviation)]
        for light in lights:
            spread = np.sqrt(np.log1p(light.spread**2 + light.noise**2))
            p_value = 2 * ndtr(-np.abs(np.log(np.maximum(light.share, SMALLEST))) / spread)
            # few scenes tell no tail, and many have one that is not normal: both must be passed
            dimmest, brightest = light.usual + 3 * light.noise * np.array([-1, 1])
            usual = (dimmest <= light.share) & (light.share <= brightest)
            p_values.append(np.where(usual, 1.0, p_value))
        # the smallest of all, times their number (Bonferroni)
        return np.minimum(1.0, len(p_values) * np.minimum.reduce(p_values))

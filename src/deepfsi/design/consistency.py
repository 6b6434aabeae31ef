"""Consistency of counts with the scenes that a design was trained for.

The file of a design holds how the readouts of its training scenes are distributed. Two statistics
compare an exposure with them: its brightness, all counts over those of the mean scene, and its
pattern, the readouts less their shares of all counts, as the distance from 0 in the metric of the
scenes' covariance and the photon noise together. Each has a p-value, calibrated on simulated counts
of scenes that were left out of the covariance, at budgets from hardly a count to far more than any
camera has. The calibration is of the class that fits worst, so that the rate of false alarms holds
whatever classes are shown.

Scenes whose patterns do not differ by more than photon noise, where those of two of one class
would, are *alike*: then they count as one.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc

from deepfsi.design.readout_model import SMALLEST, ReadoutModel

if TYPE_CHECKING:  # live runs do without torch
    from torch import Tensor

UNSURE = 0.01
"""Rate of false alarms of a single scene: below this p-value it is unsure."""

REFUSED = 0.001
"""Rate of false alarms of a whole acquisition: below this p-value it is refused."""

COUNTS = tuple(10.0 ** np.arange(-2, 6))
"""Mean counts of a readout at which tails are calibrated."""

CHANCES = (1.0, 0.7, 0.5, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01, 1e-3, 1e-4)
"""p-values whose statistics are stored; smaller ones are not told apart."""

OVER_DISPERSED = 3.1
"""Standard deviations of photon noise beyond which scenes differ: one in 1000 that do not."""

SHARES = ("mean", "directions", "rest")
"""Fields of a distribution that are of shares, which are at most 1."""

LARGEST_SHARE = 1.001
"""The same with what rounding may add."""

ROUNDING = 1e-5
"""Error of a logarithm in the file: what is equal is no further out."""


@dataclass(frozen=True)
class Consistency:
    """Consistency of exposures with the training of a design."""

    exposures: np.ndarray  # (...): p-value of each exposure
    whole: float  # p-value of all of them together
    # p-value of how little they differ from each other; 1 for one exposure, and where their
    # patterns differ by more than photon noise
    alike: float
    brightness: float  # all counts over those that the mean scene has at these budgets

    @property
    def unsure(self) -> np.ndarray:
        """True for exposures (...) that are less consistent than all but a share `UNSURE`."""
        return self.exposures < UNSURE

    @property
    def refused(self) -> bool:
        """True if all together are less consistent than all but a share `REFUSED` of sound ones."""
        return self.whole < REFUSED

    @property
    def refusal(self) -> str:
        """Words on what to look at where all together are refused."""
        return (
            "these counts do not look like what this design was trained for (p = "
            f"{self.whole:.1g}; {self.brightness:.2f} times the counts of its mean scene at this "
            "budget): check the design, the order of frames, the scenes and their scale, and "
            "`photons`"
        )

    @property
    def remarks(self) -> Iterator[str]:
        """Lines for a reader on what is not as in the training."""
        if self.refused:
            yield self.refusal
        if unsure := int(self.unsure.sum()):
            yield (
                f"unsure: {unsure} of {self.unsure.size} scenes do not look like those of the "
                f"training, where about {UNSURE * 100:.0f} in 100 is expected"
            )
        if self.alike < REFUSED:
            yield "the scenes are alike: but for brightness, only photon noise differs between them"

    def as_dict(self) -> dict[str, float]:
        """Results for all together, and the rates of false alarms; JSON types only."""
        return {
            "whole": self.whole,
            "alike": self.alike,
            "brightness": self.brightness,
            "false_alarms": REFUSED,
            "false_alarms_unsure": UNSURE,
        }


@dataclass(frozen=True)
class ReadoutDistribution:
    """Distribution of the readouts of training scenes, and the tails of the two statistics."""

    # (rails, m): Share of the budget that each readout counts, in the mean over scenes. Where
    # dwells are chosen, (1, R): those of equal dwells, and at the end of all mirrors ON
    mean: np.ndarray
    spread: np.ndarray  # (): Standard deviation of the brightness
    # (k, rails, m): Patterns of one standard deviation each, along the principal axes of their
    # covariance
    directions: np.ndarray
    rest: np.ndarray  # (rails, m): Variance of the patterns beyond these
    # ([K,] 2, 2, counts, chances): After each look; of all scenes and of the class that fits worst;
    # of brightness and pattern; at each of `COUNTS`: logarithm of the value that is exceeded with
    # each of `CHANCES`
    tails: np.ndarray
    # (counts, chances): The same of the likeness of two scenes, in the class whose scenes are most
    # alike; (0, chances) where dwells are chosen, and it is not tested
    pairs: np.ndarray

    @property
    def tensors(self) -> "dict[str, Tensor]":
        """Fields by name, as a design file takes them."""
        from torch import from_numpy

        return {name: from_numpy(np.asarray(held)) for name, held in self.arrays.items()}

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Fields by name."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    @classmethod
    def restored(
        cls, arrays: dict[str, np.ndarray], readouts: tuple[int, int], looks: int
    ) -> "ReadoutDistribution":
        """Distribution from a file, or `ValueError` if it holds none; 0 looks of fixed dwells."""
        axes, levels = len(arrays["directions"]), (len(COUNTS), len(CHANCES))
        shapes = {
            "mean": readouts,
            "spread": (),
            "directions": (axes, *readouts),
            "rest": readouts,
            "tails": (*([looks] if looks else []), 2, 2, *levels),
            "pairs": (0 if looks else len(COUNTS), len(CHANCES)),
        }
        if {name: held.shape for name, held in arrays.items()} != shapes:
            raise ValueError("the distribution of the readouts is not of these masks")
        if not all(np.isfinite(held).all() for held in arrays.values()):
            raise ValueError("the distribution of the readouts is not finite")
        least = min(float(arrays[name].min()) for name in ("mean", "spread", "rest"))
        most = max(float(np.abs(arrays[name]).max()) for name in SHARES if arrays[name].size)
        falling = any((np.diff(arrays[name]) < 0).any() for name in ("tails", "pairs"))
        if least < 0 or most > LARGEST_SHARE or falling or not (arrays["mean"] > 0).any():
            raise ValueError("the distribution of the readouts is none")
        return cls(**arrays)

    @property
    def _model(self) -> ReadoutModel:
        """Model of the readouts that are lit."""
        parts = {name: part.astype(float) for name, part in self.arrays.items()}
        lit, total = parts["mean"] > 0, float(parts["mean"].sum())
        return ReadoutModel(
            total=total,
            share=parts["mean"][lit] / total,
            spread=float(parts["spread"]),
            directions=parts["directions"][:, lit],
            rest=parts["rest"][lit],
        )

    def dimmed(self, factor: float) -> "ReadoutDistribution":
        """Distribution of readouts that all have so much less light."""
        return replace(self, mean=self.mean * np.float32(factor))

    def after(self, look: int) -> "ReadoutDistribution":
        """Distribution of exposures that end with a look, from 0."""
        return replace(self, tails=self.tails[look])

    def test(
        self,
        counts: ArrayLike,
        photons: ArrayLike,
        background: ArrayLike,
        weights: ArrayLike = 1.0,
    ) -> Consistency:
        """Consistency of exposures of different scenes."""
        # counts (..., rails, m); photons (...). Weights are how long each readout was counted, over
        # the time that the mean has it for
        model = self._model
        read = np.asarray(counts, dtype=float)
        lead = read.shape[:-2]
        dark = np.broadcast_to(np.asarray(background, dtype=float), read.shape)
        budget = np.broadcast_to(np.asarray(photons, dtype=float), lead).reshape(-1)
        often = np.broadcast_to(np.asarray(weights, dtype=float), read.shape)
        lit = (self.mean > 0).ravel()
        read, dark, often = (each.reshape(len(budget), -1)[:, lit] for each in (read, dark, often))
        chances, careful = self._chances(model, read, budget, dark, often)
        one, sums, rest = (each.sum(axis=0)[None] for each in (read, budget, dark))
        _, together = self._chances(model, one, sums, rest, (budget @ often / sums)[None])
        alike = self._alike(model, read, budget, dark)
        apart = 1.0 if alike < REFUSED else _fisher(careful)
        whole = min(1.0, 2 * min(apart, float(together[0])))
        brightness = float(read.sum() / (budget @ often @ model.share * model.total))
        return Consistency(chances.reshape(lead), whole, alike, brightness)

    def _chances(
        self,
        model: ReadoutModel,
        read: np.ndarray,
        budget: np.ndarray,
        dark: np.ndarray,
        weights: np.ndarray,
    ) -> np.ndarray:
        """p-values (2, n) of counts (n, R) of lit readouts, among all and in the worst class."""
        expected = budget * model.total
        statistics = model.statistics(read, expected, dark, weights)
        noise = _mean_counts(expected, dark / (weights @ model.share)[:, None])
        brightness, pattern = (
            [_survival(statistic, noise, tail) for tail in self.tails[:, k].astype(float)]
            for k, statistic in enumerate(statistics)
        )
        return np.minimum(1.0, 2 * np.minimum(brightness, pattern))

    def _alike(
        self, model: ReadoutModel, read: np.ndarray, budget: np.ndarray, dark: np.ndarray
    ) -> float:
        """p-value of the likeness of exposures, taken two by two; parameters as of `_chances`."""
        if not len(self.pairs) or _dispersion(read, dark) > OVER_DISPERSED:
            return 1.0
        expected = budget * model.total
        pairs = len(read) // 2
        one, other = slice(0, pairs), slice(pairs, 2 * pairs)
        likeness = model.likeness(
            *((read[each], expected[each], dark[each]) for each in (one, other))
        )
        noise = _mean_counts(expected, dark)
        fewer = np.minimum(noise[one], noise[other])
        return _fisher(_survival(likeness, fewer, self.pairs.astype(float)))


def _mean_counts(expected: np.ndarray, dark: np.ndarray) -> np.ndarray:
    """Mean counts (n,) of a readout that have as much noise without background."""
    return expected**2 / (expected + dark.sum(axis=1)) / dark.shape[1]


def _dispersion(read: np.ndarray, dark: np.ndarray) -> float:
    """Squared differences of exposures' patterns beyond photon noise, in standard deviations."""
    # Parameters are those of `ReadoutModel.statistics`. The patterns are compared with their mean
    every = max(float(read.sum()), SMALLEST)
    share, part = read.sum(axis=0) / every, read.sum(axis=1, keepdims=True) / every
    mean = every * part * share
    power = mean.clip(min=0) + dark
    beyond = np.square(read - mean) - power * (1 - share) * (1 - part)
    weight = np.maximum(power, 1)
    error = np.sqrt(((2 * np.square(power) + power) / np.square(weight)).sum())
    return float((beyond / weight).sum() / max(error, SMALLEST))


def _fisher(chances: np.ndarray) -> float:
    """p-value of independent ones (n,) together; 1 for none."""
    return float(chdtrc(2 * len(chances), -2 * np.log(chances).sum())) if len(chances) else 1.0


def _survival(statistic: np.ndarray, noise: np.ndarray, tail: np.ndarray) -> np.ndarray:
    """p-values (n,) of a statistic at mean counts of a readout, from the tail (counts, chances)."""
    place = np.interp(np.log(noise), np.log(COUNTS), np.arange(len(COUNTS)))
    below = np.minimum(place.astype(int), len(COUNTS) - 2)
    weight = (place - below)[:, None]
    levels = (1 - weight) * tail[below] + weight * tail[below + 1]
    seen = np.log(np.maximum(statistic, SMALLEST)) - ROUNDING
    logs = [np.interp(*each, np.log(CHANCES)) for each in zip(seen, levels, strict=True)]
    return np.exp(logs)

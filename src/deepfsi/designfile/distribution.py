"""Distribution of the readouts of training scenes, and the consistency of counts with it.

The file of a design holds the mean and the covariance of the readouts of its training scenes. Two
statistics compare an exposure with them. Its *brightness* is all its counts over those of the mean
scene. Its *pattern* is the readouts less their mean shares of all counts, as the distance from 0 in
the metric of the scenes' covariance and the photon noise together. Each has a p-value, calibrated
on simulated counts of scenes that were left out of the covariance, at budgets from hardly a count
to far more than any camera has. The calibration is of the class that fits worst, so that the rate
of false alarms holds whatever classes are shown.

Scenes whose patterns do not differ by more than photon noise, where those of two of one class
would, are *alike*: then they count as one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

UNSURE = 0.01
"""Rate of false alarms of a single scene: below this p-value it is unsure."""

REFUSED = 0.001
"""Rate of false alarms of a whole acquisition: below this p-value it is refused."""

TAIL_COUNTS = tuple(10.0 ** np.arange(-2, 6))
"""Mean counts of a readout at which tails are calibrated."""

TAIL_CHANCES = (1.0, 0.7, 0.5, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01, 1e-3, 1e-4)
"""p-values whose statistics are stored; smaller ones are not told apart."""

OVER_DISPERSED = 3.1
"""Standard deviations of photon noise beyond which scenes differ: one in 1000 that do not."""

LARGEST_SHARE = 1.001
"""Largest share in a file: 1, and what rounding may add."""

LOG_ERROR = 1e-5
"""Error of a logarithm in the file: what is equal is no further out."""

DIRECTIONS = 32
"""Directions of the scenes' covariance that are kept, at most; the rest is a diagonal."""

FEW_READOUTS = 128
"""Readouts whose whole covariance is decomposed faster than its main directions are drawn."""

READOUT_ERROR = 0.02
"""Relative error of a readout that a sound device may have: rounded masks, dead time."""

BRIGHTNESS_ERROR = 0.1
"""Relative error of a budget that is estimated well: dead time in the all-ON frame."""

EXPOSURES_AT_ONCE = 256
"""Exposures with noise of their own that are in memory at a time."""

SMALLEST_STATISTIC = 1e-12
"""Smallest value of a statistic that is told from 0."""


@dataclass(frozen=True)
class ConsistencyResult:
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
class ReadoutModel:
    """Mean and covariance of the R readouts of scenes."""

    total: float  # all counts of the mean scene over the budget
    share: np.ndarray  # (R,): What each readout has of them; above 0
    spread: float  # standard deviation of the brightness
    # (k, R): Patterns of one standard deviation each, along the principal axes of their covariance
    directions: np.ndarray
    rest: np.ndarray  # (R,): Variance of the patterns beyond these

    @classmethod
    def fit(cls, rates: np.ndarray) -> "ReadoutModel":
        """Model of the expected readouts (n, R) of scenes for a budget of one photon."""
        mean = rates.mean(axis=0)
        total = float(mean.sum())
        share = mean / total
        sums = rates.sum(axis=1, keepdims=True) / total
        patterns = (rates / total - sums * share) / np.sqrt(share)
        axes = _principal(patterns)
        rest = (np.square(patterns).mean(axis=0) - np.square(axes).sum(axis=0)).clip(min=0)
        return cls(total, share, float(sums.std()), axes * np.sqrt(share), rest * share)

    def statistics(
        self, read: np.ndarray, expected: np.ndarray, dark: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Brightness and pattern of counts (n, R), each a squared distance (n,) from the mean."""
        # read, dark (n, R); expected (n,), of the mean scene at weights of 1; weights (n, R), how
        # long each readout was counted over its usual time: one of 0 was not
        whole = expected * (weights @ self.share)
        power = (1 + dark.sum(axis=1) / whole) / whole
        power += self.spread**2 + BRIGHTNESS_ERROR**2
        bright = read.sum(axis=1) / whole
        brightness = np.square(bright - 1) / power
        shown = weights > 0
        scale = np.where(shown, weights, 1.0) * expected[:, None]
        off = np.where(shown, read / scale - bright[:, None] * self.share, 0.0)
        floor = self.rest + np.square(READOUT_ERROR * self.share)
        noise = np.where(shown, (self.share + dark / scale) / scale + floor, np.inf)
        if (noise == noise[0]).all():  # most often of fixed dwells: one matrix serves them all
            return brightness, _distance(off, noise[0], self.directions)
        parts = [
            _distance(
                off[a : a + EXPOSURES_AT_ONCE, None],
                noise[a : a + EXPOSURES_AT_ONCE],
                self.directions,
            )[:, 0]
            for a in range(0, len(off), EXPOSURES_AT_ONCE)
        ]
        return brightness, np.concatenate(parts)

    def likeness(self, one: Sequence[np.ndarray], other: Sequence[np.ndarray]) -> np.ndarray:
        """Inverse (n,) of the mean squared distance of patterns in units of their noise."""
        power, off = np.zeros(self.share.shape), 0.0
        for sign, (read, expected, dark) in ((1, one), (-1, other)):
            scale, mean = expected[:, None], read.sum(axis=1, keepdims=True) * self.share
            off = off + sign * (read - mean) / scale
            power = power + (np.maximum(mean, self.share) + dark) / np.square(scale)
        return 1 / np.maximum((np.square(off) / power).mean(axis=1), SMALLEST_STATISTIC)


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
    # of brightness and pattern; at each of `TAIL_COUNTS`: logarithm of the value that is exceeded
    # with each of `TAIL_CHANCES`
    tails: np.ndarray
    # (counts, chances): The same of the likeness of two scenes, in the class whose scenes are most
    # alike; (0, chances) where dwells are chosen, and it is not tested
    pairs: np.ndarray

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Fields by name, as a design file takes them."""
        return {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}

    @classmethod
    def restored(
        cls, arrays: dict[str, np.ndarray], readouts: tuple[int, int], looks: int
    ) -> "ReadoutDistribution":
        """Distribution from the arrays of a file.

        Parameters
        ----------
        arrays : dict of str to array
            Fields by name.
        readouts : tuple of int
            (rails, m) of the masks; (1, R) where dwells are chosen.
        looks : int
            K of several looks, 0 of fixed dwells.

        Raises
        ------
        ValueError
            If the arrays are no distribution of such readouts.
        """
        axes, levels = len(arrays["directions"]), (len(TAIL_COUNTS), len(TAIL_CHANCES))
        shapes = {
            "mean": readouts,
            "spread": (),
            "directions": (axes, *readouts),
            "rest": readouts,
            "tails": (*([looks] if looks else []), 2, 2, *levels),
            "pairs": (0 if looks else len(TAIL_COUNTS), len(TAIL_CHANCES)),
        }
        if {name: held.shape for name, held in arrays.items()} != shapes:
            raise ValueError("the distribution of the readouts is not of these masks")
        if not all(np.isfinite(held).all() for held in arrays.values()):
            raise ValueError("the distribution of the readouts is not finite")
        least = min(float(arrays[name].min()) for name in ("mean", "spread", "rest"))
        shares = [arrays[name] for name in ("mean", "directions", "rest") if arrays[name].size]
        most = max(float(np.abs(share).max()) for share in shares)
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
    ) -> ConsistencyResult:
        """Test exposures of different scenes.

        Parameters
        ----------
        counts : array, shape (..., rails, m)
            Photons of each readout, less what is no scene's.
        photons : array, shape (...)
            Budget of each exposure.
        background : array, broadcastable to counts
            Counts that were subtracted from each readout.
        weights : array, broadcastable to counts
            How long each readout was counted, over the time that the mean has it for.
        """
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
        return ConsistencyResult(chances.reshape(lead), whole, alike, brightness)

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


def _principal(patterns: np.ndarray) -> np.ndarray:
    """Principal axes (k, R) of patterns (n, R), each as long as their standard deviation."""
    count = min(DIRECTIONS, *patterns.shape)
    if patterns.shape[1] <= FEW_READOUTS:
        variances, axes = np.linalg.eigh(patterns.T @ patterns / len(patterns))
        return (axes * np.sqrt(variances.clip(min=0))).T[: -count - 1 : -1]
    from sklearn.utils.extmath import randomized_svd

    _, sizes, axes = randomized_svd(patterns, count, random_state=0)
    return axes * (sizes[:, None] / np.sqrt(len(patterns)))


def _distance(off: np.ndarray, noise: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Squared Mahalanobis distance (..., n) of (..., n, R) for a diagonal (..., R) and (k, R)."""
    scaled = directions / noise[..., None, :]
    inner = np.eye(len(directions)) + scaled @ directions.T
    along = off @ scaled.swapaxes(-1, -2)
    solved = np.linalg.solve(inner, along.swapaxes(-1, -2)).swapaxes(-1, -2)
    return (np.square(off) / noise[..., None, :]).sum(axis=-1) - (along * solved).sum(axis=-1)


def _mean_counts(expected: np.ndarray, dark: np.ndarray) -> np.ndarray:
    """Mean counts (n,) of a readout that have as much noise without background."""
    return expected**2 / (expected + dark.sum(axis=1)) / dark.shape[1]


def _dispersion(read: np.ndarray, dark: np.ndarray) -> float:
    """Squared differences of exposures' patterns beyond photon noise, in standard deviations."""
    # Parameters are those of `ReadoutModel.statistics`. The patterns are compared with their mean
    every = max(float(read.sum()), SMALLEST_STATISTIC)
    share, part = read.sum(axis=0) / every, read.sum(axis=1, keepdims=True) / every
    mean = every * part * share
    power = mean.clip(min=0) + dark
    beyond = np.square(read - mean) - power * (1 - share) * (1 - part)
    weight = np.maximum(power, 1)
    error = np.sqrt(((2 * np.square(power) + power) / np.square(weight)).sum())
    return float((beyond / weight).sum() / max(error, SMALLEST_STATISTIC))


def _fisher(chances: np.ndarray) -> float:
    """p-value of independent ones (n,) together; 1 for none."""
    from scipy.special import chdtrc

    return float(chdtrc(2 * len(chances), -2 * np.log(chances).sum())) if len(chances) else 1.0


def _survival(statistic: np.ndarray, noise: np.ndarray, tail: np.ndarray) -> np.ndarray:
    """p-values (n,) of a statistic at mean counts of a readout, from the tail (counts, chances)."""
    place = np.interp(np.log(noise), np.log(TAIL_COUNTS), np.arange(len(TAIL_COUNTS)))
    below = np.minimum(place.astype(int), len(TAIL_COUNTS) - 2)
    weight = (place - below)[:, None]
    levels = (1 - weight) * tail[below] + weight * tail[below + 1]
    seen = np.log(np.maximum(statistic, SMALLEST_STATISTIC)) - LOG_ERROR
    logs = [np.interp(*each, np.log(TAIL_CHANCES)) for each in zip(seen, levels, strict=True)]
    return np.exp(logs)

"""Distribution of the readouts of training scenes, and the consistency of counts with it.

The file of a design holds the mean and the covariance of the readouts of its training scenes. Two
statistics compare an exposure with them. Its *brightness* is all its counts over those of the mean
scene. Its *pattern* is the readouts less their mean shares of all counts, as the distance from 0 in
the metric of the scenes' covariance and the photon noise together. Each has a p-value, calibrated
on simulated counts of scenes that were left out of the covariance, at budgets from hardly a count
to far more than any camera has. A single exposure is tested by the tails of all scenes, a whole
acquisition by those of the class that fits worst, whatever classes are shown.

Scenes are *alike* if their patterns differ by photon noise alone. Two scenes of one class differ by
more, so that alike scenes count as one.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

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

EXPOSURES_AT_ONCE = 256
"""Exposures with noise of their own that are in memory at a time."""

SMALLEST_STATISTIC = 1e-12
"""Smallest value of a statistic: smaller ones are raised to it."""


@dataclass(frozen=True)
class ConsistencyResult:
    """Consistency of exposures with the training of a design."""

    exposures: np.ndarray  # (...), p-value of each exposure
    whole: float  # p-value of all exposures together
    alike: float  # p-value of the differences between exposures: small if they are too alike
    brightness: float  # all counts over those that the mean scene has at these budgets

    @property
    def unsure(self) -> np.ndarray:
        """Exposures (...) with a p-value below `UNSURE`."""
        return self.exposures < UNSURE

    @property
    def refused(self) -> bool:
        """Whether the joint p-value is below `REFUSED`."""
        return self.whole < REFUSED

    @property
    def refusal(self) -> str:
        """Sentence for a refused acquisition: what to check."""
        return (
            "these counts do not look like what this design was trained for (p = "
            f"{self.whole:.1g}; {self.brightness:.2f} times the counts of its mean scene at this "
            "budget): check the design, the order of frames, the scenes and their scale, and "
            "`photons`"
        )

    @property
    def remarks(self) -> Iterator[str]:
        """Lines for a reader on each difference from the training."""
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
        """Results of the acquisition, and the rates of false alarms; JSON types only."""
        return {
            "whole": self.whole,
            "alike": self.alike,
            "brightness": self.brightness,
            "false_alarms": REFUSED,
            "false_alarms_unsure": UNSURE,
        }


@dataclass(frozen=True)
class ReadoutCounts:
    """Counts of n exposures in R readouts that are lit."""

    counts: np.ndarray  # (n, R), photons, less the background
    expected: np.ndarray  # (n,)
    dark: np.ndarray  # (n, R), background that was subtracted

    def rows(self, index: np.ndarray | slice) -> "ReadoutCounts":
        """Exposures of an index or a slice."""
        return ReadoutCounts(*(array[index] for array in vars(self).values()))


@dataclass(frozen=True)
class ReadoutModel:
    """Mean and covariance of the R readouts of scenes."""

    total: float  # all counts of the mean scene over the budget
    share: np.ndarray  # (R,), share of each readout in them
    spread: float  # standard deviation of the brightness
    directions: np.ndarray  # (k, R)
    rest: np.ndarray  # (R,), variance of the patterns beyond these

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
        return cls(
            total=total,
            share=share,
            spread=float(sums.std()),
            directions=axes * np.sqrt(share),
            rest=rest * share,
        )

    def statistics(self, exposures: ReadoutCounts) -> tuple[np.ndarray, np.ndarray]:
        """Brightness and pattern of counts, each a squared distance (n,) from the mean."""
        counts = exposures.counts
        dark = exposures.dark
        expected = exposures.expected * (np.ones_like(counts) @ self.share)  # 1 but for rounding
        power = (1 + dark.sum(axis=1) / expected) / expected
        power += self.spread**2 + 0.1**2  # dead time in the all-ON frame
        bright = counts.sum(axis=1) / expected
        brightness = np.square(bright - 1) / power
        scale = exposures.expected[:, None]
        residuals = counts / scale - bright[:, None] * self.share
        floor = self.rest + np.square(0.02 * self.share)  # rounded masks, dead time
        noise = (self.share + dark / scale) / scale + floor
        if (noise == noise[0]).all():  # most often of fixed dwells: one matrix serves them all
            return brightness, _distance(residuals, noise[0], self.directions)
        distances = []
        for start in range(0, len(residuals), EXPOSURES_AT_ONCE):
            rows = slice(start, start + EXPOSURES_AT_ONCE)
            distances.append(_distance(residuals[rows, None], noise[rows], self.directions)[:, 0])
        return brightness, np.concatenate(distances)

    def likeness(self, first: ReadoutCounts, second: ReadoutCounts) -> np.ndarray:
        """Inverse (n,) of the mean squared distance of patterns in units of their noise."""
        power = np.zeros(self.share.shape)
        difference = np.zeros(())
        for sign, exposures in ((1, first), (-1, second)):
            scale = exposures.expected[:, None]
            mean = exposures.counts.sum(axis=1, keepdims=True) * self.share
            difference = difference + sign * (exposures.counts - mean) / scale
            power = power + (np.maximum(mean, self.share) + exposures.dark) / np.square(scale)
        squares = (np.square(difference) / power).mean(axis=1)
        return 1 / np.maximum(squares, SMALLEST_STATISTIC)


@dataclass(frozen=True)
class ReadoutDistribution:
    """Distribution of the readouts of training scenes, and the tails of the two statistics."""

    mean: np.ndarray  # (rails, m)
    spread: np.ndarray  # (), standard deviation of the brightness
    directions: np.ndarray  # (k, rails, m)
    rest: np.ndarray  # (rails, m), variance of the patterns beyond these
    tails: np.ndarray  # (2, 2, counts, p): all scenes and worst class, brightness and pattern
    pairs: np.ndarray  # (counts, p), of the likeness of two scenes

    @classmethod
    def restored(
        cls, arrays: dict[str, np.ndarray], readouts: tuple[int, int]
    ) -> "ReadoutDistribution":
        """Distribution from the arrays of a file."""
        levels = len(TAIL_COUNTS), len(TAIL_CHANCES)
        shapes = {
            "mean": readouts,
            "spread": (),
            "directions": (len(arrays["directions"]), *readouts),
            "rest": readouts,
            "tails": (2, 2, *levels),
            "pairs": levels,
        }
        fit = {name: array.shape for name, array in arrays.items()} == shapes
        least = min(float(arrays[name].min()) for name in ("mean", "spread", "rest"))
        shares = [arrays[name] for name in ("mean", "directions", "rest") if arrays[name].size]
        largest = max(float(np.abs(share).max()) for share in shares)
        falling = any((np.diff(arrays[name]) < 0).any() for name in ("tails", "pairs"))
        if not fit or least < 0 or largest > 1.001 or falling or not (arrays["mean"] > 0).any():
            raise ValueError("the distribution of the readouts is not of these masks")
        return cls(**arrays)

    @property
    def _model(self) -> ReadoutModel:
        """Model of the readouts that are lit."""
        fitted = {name: array.astype(float) for name, array in vars(self).items()}
        lit = fitted["mean"] > 0
        total = float(fitted["mean"].sum())
        return ReadoutModel(
            total=total,
            share=fitted["mean"][lit] / total,
            spread=float(fitted["spread"]),
            directions=fitted["directions"][:, lit],
            rest=fitted["rest"][lit],
        )

    def dimmed(self, factor: float) -> "ReadoutDistribution":
        """Distribution of readouts with this share of the light."""
        return replace(self, mean=self.mean * np.float32(factor))

    def test(
        self, counts: ArrayLike, photons: ArrayLike, background: ArrayLike
    ) -> ConsistencyResult:
        """Test counts (..., rails, m) of exposures of different scenes, at budgets (...).

        `background` has the counts that were subtracted from each readout.
        """
        model = self._model
        read = np.asarray(counts, dtype=float)
        exposures = read.shape[:-2]
        budget = np.broadcast_to(np.asarray(photons, dtype=float), exposures).reshape(-1)
        lit = (self.mean > 0).ravel()

        def of_lit(values: ArrayLike) -> np.ndarray:
            spread = np.broadcast_to(np.asarray(values, dtype=float), read.shape)
            return spread.reshape(len(budget), -1)[:, lit]

        single = ReadoutCounts(of_lit(read), budget * model.total, of_lit(background))
        together = ReadoutCounts(*(array.sum(axis=0)[None] for array in vars(single).values()))
        photons_behind = np.full_like(model.share, budget.sum())  # (R,)
        p_values, of_worst_class = self._p_values(model, single)
        alike = self._alike(model, single)
        # Fisher's sum is of independent scenes: alike ones are tested together alone
        one_by_one = 1.0 if alike < REFUSED else _fisher(of_worst_class)
        joint = float(self._p_values(model, together)[1][0])
        return ConsistencyResult(
            exposures=p_values.reshape(exposures),
            # the smaller of two p-values, doubled (Bonferroni)
            whole=min(1.0, 2 * min(one_by_one, joint)),
            alike=alike,
            brightness=float(single.counts.sum() / (photons_behind @ model.share * model.total)),
        )

    def _p_values(self, model: ReadoutModel, exposures: ReadoutCounts) -> np.ndarray:
        """p-values (2, n) of exposures, among all scenes and in the worst class."""
        statistics = model.statistics(exposures)
        ones = (np.ones_like(exposures.counts) @ model.share)[:, None]  # but for rounding
        noise = _mean_counts(exposures.expected, exposures.dark / ones)
        brightness, pattern = (
            [_survival(statistic, noise, tail) for tail in self.tails[:, k].astype(float)]
            for k, statistic in enumerate(statistics)
        )
        # the smaller of two p-values, doubled (Bonferroni)
        return np.minimum(1.0, 2 * np.minimum(brightness, pattern))

    def _alike(self, model: ReadoutModel, exposures: ReadoutCounts) -> float:
        """p-value of the likeness of exposures, taken two by two; 1 where they surely differ."""
        # exposures that do not differ disperse by 3.1 standard deviations once in 1000 runs
        if _dispersion(exposures) > 3.1:
            return 1.0
        pairs = len(exposures.counts) // 2
        first = slice(0, pairs)
        second = slice(pairs, 2 * pairs)
        likeness = model.likeness(exposures.rows(first), exposures.rows(second))
        noise = _mean_counts(exposures.expected, exposures.dark)
        fewer = np.minimum(noise[first], noise[second])
        return _fisher(_survival(likeness, fewer, self.pairs.astype(float)))


def _principal(patterns: np.ndarray) -> np.ndarray:
    """Principal axes (k, R) of patterns (n, R), scaled to their standard deviation."""
    count = min(32, *patterns.shape)
    if patterns.shape[1] <= 128:  # faster than to draw its main directions
        variances, axes = np.linalg.eigh(patterns.T @ patterns / len(patterns))
        return (axes * np.sqrt(variances.clip(min=0))).T[: -count - 1 : -1]
    from sklearn.utils.extmath import randomized_svd

    _, sizes, axes = randomized_svd(patterns, count, random_state=0)
    return axes * (sizes[:, None] / np.sqrt(len(patterns)))


def _distance(residuals: np.ndarray, noise: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Squared Mahalanobis distance (..., n) of residuals (..., n, R) from 0.

    Their covariance is the diagonal `noise` (..., R) plus the square of `directions` (k, R).
    """
    # Woodbury's identity: k equations in place of R
    scaled = directions / noise[..., None, :]
    inner = np.eye(len(directions)) + scaled @ directions.T
    projected = residuals @ scaled.swapaxes(-1, -2)
    solved = np.linalg.solve(inner, projected.swapaxes(-1, -2)).swapaxes(-1, -2)
    squares = (np.square(residuals) / noise[..., None, :]).sum(axis=-1)
    return squares - (projected * solved).sum(axis=-1)


def _mean_counts(expected: np.ndarray, dark: np.ndarray) -> np.ndarray:
    """Mean counts (n,) of a readout whose noise, without background, is relatively the same."""
    return expected**2 / (expected + dark.sum(axis=1)) / dark.shape[1]


def _dispersion(exposures: ReadoutCounts) -> float:
    """Squared differences of exposures' patterns beyond noise, in standard deviations."""
    counts = exposures.counts
    dark = exposures.dark
    total = max(float(counts.sum()), SMALLEST_STATISTIC)
    by_readout = counts.sum(axis=0) / total
    by_exposure = counts.sum(axis=1, keepdims=True) / total
    mean = total * by_exposure * by_readout
    power = mean.clip(min=0) + dark
    # the fitted sums take their share of each difference's variance
    beyond = np.square(counts - mean) - power * (1 - by_readout) * (1 - by_exposure)
    weight = np.maximum(power, 1)
    # (n − μ)² of Poisson counts n has the variance 2 μ² + μ
    error = np.sqrt(((2 * np.square(power) + power) / np.square(weight)).sum())
    return float((beyond / weight).sum() / max(error, SMALLEST_STATISTIC))


def _fisher(p_values: np.ndarray) -> float:
    """Joint p-value of independent p-values (n,), by Fisher's method; 1 for none."""
    from scipy.special import chdtrc

    return float(chdtrc(2 * len(p_values), -2 * np.log(p_values).sum())) if len(p_values) else 1.0


def _survival(statistic: np.ndarray, noise: np.ndarray, tail: np.ndarray) -> np.ndarray:
    """p-values (n,) of a statistic at mean counts of a readout, from the tail (counts, p)."""
    row = np.interp(np.log(noise), np.log(TAIL_COUNTS), np.arange(len(TAIL_COUNTS)))
    below = np.minimum(row.astype(int), len(TAIL_COUNTS) - 2)
    weight = (row - below)[:, None]
    levels = (1 - weight) * tail[below] + weight * tail[below + 1]
    # a statistic that equals a level is not beyond it: rounding must not put it there
    log = np.log(np.maximum(statistic, SMALLEST_STATISTIC)) - 1e-5
    logs = [np.interp(*pair, np.log(TAIL_CHANCES)) for pair in zip(log, levels, strict=True)]
    return np.exp(logs)

"""Answers to test scenes under noise, at one budget, and what of them measures are made of."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

MOST_DRAWS = 10_000
"""Noise draws of each scene in one test: enough for any interval, and an end in sight."""

LEAST_TRUE_CHANCE = np.finfo(np.float32).eps
"""Least probability of a true class that the log loss is taken of."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Answers:
    """Answers of one design at one budget: E exposures, so many draws of each of n scenes."""

    photons: float  # budget Φ
    noise: str
    covers: str  # what an interval over images covers
    draws: int  # independent noise draws of each scene
    counts: float
    arriving: float
    shares: list[float]
    truth: np.ndarray  # (n,), class of each scene, or its values
    scenes: np.ndarray  # (E,)
    used: float | None = None

    def by_scene(self, values: np.ndarray) -> np.ndarray:
        """Values (n, draws, …) of exposures (E, …)."""
        order = np.argsort(self.scenes, kind="stable")
        return values[order].reshape(len(self.truth), self.draws, *values.shape[1:])


@dataclass(frozen=True, eq=False)
class ClassAnswers(Answers):
    """Answers that are classes."""

    classes: np.ndarray  # (E,)
    chances: np.ndarray  # (E, C), probability of each class

    @cached_property
    def true(self) -> np.ndarray:
        """True class (E,) of each exposure."""
        return self.truth[self.scenes]

    @cached_property
    def confusion(self) -> np.ndarray:
        """Exposures (C, C): rows true classes, columns answers."""
        counts = np.zeros([self.chances.shape[1]] * 2, dtype=np.int64)
        np.add.at(counts, (self.true, self.classes), 1)
        return counts

    @property
    def rates(self) -> list[float | None]:
        """Accuracy of each class; None where the test has no scene of it."""
        rows = enumerate(self.confusion)
        return [float(row[k] / row.sum()) if row.any() else None for k, row in rows]

    @property
    def confidence(self) -> np.ndarray:
        """Probability (E,) of the answers."""
        return self.chances.max(axis=1).astype(float)

    @property
    def losses(self) -> np.ndarray:
        """−ln of the probability (E,) of the true classes, in nats."""
        chances = self.chances[np.arange(len(self.true)), self.true].astype(float)
        return -np.log(chances.clip(min=LEAST_TRUE_CHANCE))

    @cached_property
    def right(self) -> np.ndarray:
        """Share (n,) of the draws of each scene that are answered right."""
        return self.by_scene(self.classes == self.true).mean(axis=1, dtype=float)


@dataclass(frozen=True, eq=False)
class ValueAnswers(Answers):
    """Answers that are estimates of values."""

    estimates: np.ndarray  # (E, q), in the unit of each value
    names: tuple[str, ...] = ()
    bound: list[float] | None = None

    @cached_property
    def squares(self) -> np.ndarray:
        """Squared error (n, q) of each scene, in the mean over draws."""
        draws = np.moveaxis(self.by_scene(self.estimates.astype(float)), 1, 0)
        return np.square(np.ascontiguousarray(draws) - self.truth).mean(axis=0)

    @cached_property
    def losses(self) -> np.ndarray:
        """`squares` over the variance of the values; NaN of one that is alike in all scenes."""
        variance = self.truth.var(axis=0, dtype=np.float64)
        variance[variance == 0] = np.nan
        return self.squares / variance

    @property
    def explained(self) -> np.ndarray:
        """1 − `losses` (n,) in the mean over values, whose mean over scenes is R²."""
        return 1 - self.losses.mean(axis=1)

"""Answers under noise, and the table of their measures.

A new measure is one entry: results of tests, records of trials, tables of commands, points of
comparisons and their pages take it from here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from deepfsi.base.intervals import (
    Interval,
    accuracy_interval,
    balanced_interval,
    image_interval,
)

BINS = 15
"""Groups of answers of like confidence, all of one size, in which calibration is measured."""


def confidence_error(confidence: np.ndarray, right: np.ndarray) -> float:
    """Expected calibration error of E answers, by their confidence and which are right.

    It is the mean distance of confidence and accuracy over `BINS` groups, the least sure first.
    """
    order = np.argsort(confidence, kind="stable")
    return sum(
        len(group) / len(order) * abs(float(confidence[group].mean()) - float(right[group].mean()))
        for group in np.array_split(order, min(BINS, len(order)))
    )


MOST_DRAWS = 10_000
"""Largest number of noise draws of each scene in one test."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Answers:
    """Answers of a design at a budget: E exposures, `draws` of each of n scenes."""

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

    @property
    def terms(self) -> dict[str, np.ndarray]:
        """Numbers (n,) of scenes, by their names in records; means over scenes are measures."""
        return {}

    def by_scene(self, values: np.ndarray) -> np.ndarray:
        """Values (n, draws, …) of exposures (E, …)."""
        order = np.argsort(self.scenes, kind="stable")
        return values[order].reshape(len(self.truth), self.draws, *values.shape[1:])


@dataclass(frozen=True, eq=False)
class ClassAnswers(Answers):
    """Answers that are classes."""

    classes: np.ndarray  # (E,)
    probabilities: np.ndarray  # (E, C), probability of each class

    @cached_property
    def true(self) -> np.ndarray:
        """True class (E,) of each exposure."""
        return self.truth[self.scenes]

    @cached_property
    def confusion(self) -> np.ndarray:
        """Exposures (C, C): rows true classes, columns answers."""
        counts = np.zeros([self.probabilities.shape[1]] * 2, dtype=np.int64)
        np.add.at(counts, (self.true, self.classes), 1)
        return counts

    @property
    def rates(self) -> list[float | None]:
        """Accuracy of each class; None if the test has no scene of it."""
        rows = enumerate(self.confusion)
        return [float(row[k] / row.sum()) if row.any() else None for k, row in rows]

    @property
    def losses(self) -> np.ndarray:
        """−ln of the probability (E,) of the true classes, in nats."""
        probabilities = self.probabilities[np.arange(len(self.true)), self.true].astype(float)
        return -np.log(probabilities.clip(min=np.finfo(np.float32).eps))

    @property
    def terms(self) -> dict[str, np.ndarray]:
        """Share (n,) of right answers among the draws of each scene."""
        right = self.by_scene(self.classes == self.true)
        return {"accuracy": right.mean(axis=1, dtype=float)}


@dataclass(frozen=True, eq=False)
class ValueAnswers(Answers):
    """Answers that are estimates of values."""

    estimates: np.ndarray  # (E, q), in the unit of each value

    @cached_property
    def squares(self) -> np.ndarray:
        """Squared error (n, q) of each scene, in the mean over draws."""
        draws = np.moveaxis(self.by_scene(self.estimates.astype(float)), 1, 0)
        return np.square(np.ascontiguousarray(draws) - self.truth).mean(axis=0)

    @cached_property
    def losses(self) -> np.ndarray:
        """`squares` over the variance of the values; NaN for a value equal in all scenes."""
        variance = self.truth.var(axis=0, dtype=np.float64)
        variance[variance == 0] = np.nan
        return self.squares / variance

    @property
    def terms(self) -> dict[str, np.ndarray]:
        """1 − `losses` (n,) in the mean over values, whose mean over scenes is R²."""
        return {"R²": 1 - self.losses.mean(axis=1)}


@dataclass(frozen=True, kw_only=True)
class Measure:
    """A measure of answers."""

    key: str  # its name in results, records and their tables
    title: str
    of: type[Answers]  # kind of answers that have it
    compute: Callable[[Any], float | None] | None = None
    interval: Callable[[np.ndarray, np.ndarray], Interval] | None = None
    ends: tuple[str, str] = ("", "")  # names of the ends of that interval in results and records
    terms: str = ""  # name among `Answers.terms` of the numbers that its interval is of
    column: str = ""
    legend: str = ""
    averaged: bool = False  # whether points of a comparison hold its mean over trials
    # Of a measure that data sets are judged by, as `Dataset.measure` says by its title
    axis: str = ""
    meaning: str = ""  # what it is, with its unit
    guessing: str = ""  # what guessing gives

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the measure, and of the ends of its interval if it has one."""
        return (self.key, *self.ends) if self.interval else (self.key,)

    def values(self, answers: Answers, terms: dict[str, np.ndarray]) -> list[float | None]:
        """Values of `keys`, from answers and their numbers of scenes."""
        value = self.compute(answers) if self.compute else None
        if self.interval is None:
            return [value]
        mean, low, high = self.interval(terms[self.terms], answers.truth)
        return [mean if value is None else value, low, high]


def _explained_interval(terms: np.ndarray, truth: np.ndarray) -> Interval:
    mean, low, high = image_interval(terms)
    return Interval(mean, low, min(high, 1.0))


MEASURES: dict[str, Measure] = {
    measure.key: measure
    for measure in (
        Measure(
            key="accuracy",
            title="accuracy",
            of=ClassAnswers,
            compute=lambda answers: float(answers.confusion.trace() / answers.confusion.sum()),
            interval=lambda terms, truth: accuracy_interval(terms),
            ends=("low", "high"),
            terms="accuracy",
            column="accuracy",
            axis="accuracy (share correct)",
            meaning="share of test scenes classified correctly",
            guessing="the share of the commonest class",
        ),
        Measure(
            key="balanced",
            title="balanced accuracy",
            of=ClassAnswers,
            interval=balanced_interval,
            ends=("balanced_low", "balanced_high"),
            terms="accuracy",
            column="balanced",
            averaged=True,
        ),
        Measure(
            key="calibration_error",
            title="expected calibration error",
            of=ClassAnswers,
            compute=lambda answers: confidence_error(
                answers.probabilities.max(axis=1).astype(float), answers.classes == answers.true
            ),
            column="ECE",
            legend="ECE: expected calibration error, between probabilities and how often they are "
            "right",
        ),
        Measure(
            key="log_loss",
            title="log loss",
            of=ClassAnswers,
            compute=lambda answers: float(answers.losses.mean()),
            averaged=True,
        ),
        Measure(
            key="mean_light",
            title="mean light",
            of=ClassAnswers,
            compute=lambda answers: answers.used,
            column="light",
            legend="light: share of the budget that exposures take, in the mean over test scenes, "
            "as each may end early",
            averaged=True,
        ),
        Measure(
            key="r2",
            title="R²",
            of=ValueAnswers,
            interval=_explained_interval,
            ends=("low", "high"),
            terms="R²",
            column="R²",
            axis="R² of the estimates",
            meaning="share of the variance of the values that the estimates explain (R², in the "
            "mean over values)",
            guessing="that of answering the mean of all scenes",
        ),
    )
}
"""Measures by their key. Tables and pages have them in this order."""


def main_measure(title: str) -> Measure:
    """The measure with a title, such as "accuracy" or "R²"."""
    return next(measure for measure in MEASURES.values() if measure.title == title)

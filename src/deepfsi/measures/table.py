"""The measures of answers, a table: what each is, what it stands for and where it is shown.

A new measure is one entry. Results of tests, records of trials, tables of commands, points of
comparisons and their pages take it from here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from deepfsi.base.numeric.intervals import (
    Interval,
    accuracy_interval,
    balanced_interval,
    image_interval,
)
from deepfsi.measures.answers import Answers, ClassAnswers, ValueAnswers
from deepfsi.measures.reliability import confidence_error


@dataclass(frozen=True, kw_only=True)
class Measure:
    """A measure of answers."""

    key: str  # its name in results, records and their tables
    title: str
    of: type[Answers]  # kind of answers that have it
    compute: Callable[[Any], float | None] | None = None
    interval: Callable[[np.ndarray, np.ndarray], Interval] | None = None
    ends: tuple[str, str] = ("", "")  # names of the ends of that interval in results and records
    terms: str = ""  # name in records of those numbers of images
    terms_of: Callable[[Any], np.ndarray] | None = None  # gives the numbers (n,) of answers
    column: str = ""
    legend: str = ""
    averaged: bool = False  # whether points of a comparison hold its mean over trials
    chooses: bool = False

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the measure and of the ends of its interval, where it has one."""
        return (self.key, *self.ends) if self.interval else (self.key,)

    def values(self, answers: Answers, terms: np.ndarray | None) -> list[float | None]:
        """Values of `keys`, from answers and the numbers of images that are named `terms`."""
        value = self.compute(answers) if self.compute else None
        if self.interval is None:
            return [value]
        if terms is None:
            return [None] * len(self.keys)
        mean, low, high = self.interval(terms, answers.truth)
        return [mean if value is None else value, low, high]


@dataclass(frozen=True, kw_only=True)
class MainMeasure(Measure):
    """A measure that data sets are judged by: `Dataset.measure` is its title."""

    axis: str
    meaning: str  # what it is, with its unit
    guessing: str  # what guessing gives
    task: str  # what a network does with the photon counts of scenes, with a place for these


def _explained_interval(terms: np.ndarray, truth: np.ndarray) -> Interval:
    mean, low, high = image_interval(terms)
    return Interval(mean, low, min(high, 1.0))


MEASURES: dict[str, Measure] = {
    measure.key: measure
    for measure in (
        MainMeasure(
            key="accuracy",
            title="accuracy",
            of=ClassAnswers,
            compute=lambda answers: float(answers.confusion.trace() / answers.confusion.sum()),
            interval=lambda terms, truth: accuracy_interval(terms),
            ends=("low", "high"),
            terms="accuracy",
            terms_of=lambda answers: answers.right,
            column="accuracy",
            chooses=True,
            axis="accuracy (share correct)",
            meaning="share of test scenes classified correctly",
            guessing="the share of the commonest class",
            task="the share of {scenes} that a trained network classifies correctly from the "
            "photon counts",
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
            chooses=True,
        ),
        Measure(
            key="calibration_error",
            title="expected calibration error",
            of=ClassAnswers,
            compute=lambda answers: confidence_error(
                answers.confidence, answers.classes == answers.true
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
        MainMeasure(
            key="r2",
            title="R²",
            of=ValueAnswers,
            interval=_explained_interval,
            ends=("low", "high"),
            terms="R²",
            terms_of=lambda answers: answers.explained,
            column="R²",
            chooses=True,
            axis="R² of the estimates",
            meaning="share of the variance of the values that the estimates explain (R², in the "
            "mean over values)",
            guessing="that of answering the mean of all scenes",
            task="how well a trained network estimates values from the photon counts, on {scenes}: "
            "R², the share of their variance that the estimates explain, in the mean over values",
        ),
    )
}
"""Measures by their key. Tables and pages have them in this order."""


def main_measure(title: str) -> MainMeasure:
    """The measure that data sets are judged by which say so, such as "accuracy" or "R²"."""
    named = {
        measure.title: measure for measure in MEASURES.values() if isinstance(measure, MainMeasure)
    }
    return named[title]

"""Folds of few training scenes: what calibrates a design that leaves no scenes out."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deepfsi.datasets import Dataset
from deepfsi.designfile import Temperatures
from deepfsi.evaluation import CalibrationScenes, LeftOutTest, fit_temperatures, measure_left_out

FEW_SCENES = 1000
"""Training scenes below which a design is surer of them than it is right on others."""

FOLDS = 10
"""Parts of the training scenes, each to be left out of a training of its own."""

LEFT_OUT = 150
"""Scenes that are to be left out in all, where there are so many: then no more folds are."""

DOUBT = 1.0
"""Scenes of any class that are added to those left out."""

EXPOSURES = 1000
"""Exposures of left-out scenes by which networks are calibrated, about."""


def folds_of(data: Dataset) -> list[Dataset]:
    """Few training scenes in folds: in each its test part is left out of its training part.

    All classes have their share in each fold, whose test part is in the order of classes. Scenes
    that are alone in their class are never left out. There are no folds of many scenes, and of
    scenes with values.
    """
    n = len(data.x_train)
    if not data.classes or n >= FEW_SCENES:
        return []
    labels = data.y_train
    order = np.random.default_rng(0).permutation(n)
    order = order[np.argsort(labels[order], kind="stable")]
    order = order[np.bincount(labels)[labels[order]] > 1]
    left = [order[start::FOLDS] for start in range(FOLDS)]
    count = min(FOLDS, -(-LEFT_OUT * FOLDS // n))
    return [_without(data, rows) for rows in left[:count] if len(rows)]


def _without(data: Dataset, rows: np.ndarray) -> Dataset:
    """Data with some training scenes as the test part in place of it."""
    kept = np.setdiff1d(np.arange(len(data.x_train)), rows)
    return replace(
        data,
        x_train=data.x_train[kept],
        y_train=data.y_train[kept],
        x_test=data.x_train[rows],
        y_test=data.y_train[rows],
        origin=None,
    )


def calibrated(
    scenes: CalibrationScenes, budgets: np.ndarray, data: Dataset, photons: float, seed: int
) -> tuple[Temperatures, LeftOutTest]:
    """Temperatures by scenes that were left out of the training, and the test of their answers."""
    found = fit_temperatures(scenes, budgets, trained_on=False, seed=seed)
    guess = np.bincount(data.y_train, minlength=len(data.classes)) / len(data.y_train)
    return found, measure_left_out(scenes, found, photons, guess, seed=seed)


def draws_of(folds: Sequence[Dataset]) -> int:
    """Exposures of each left-out scene by which a network is calibrated."""
    return max(1, EXPOSURES // sum(len(fold.x_test) for fold in folds))

"""Calibration of the test of counts: simulated exposures of scenes that a model has not seen."""

from collections.abc import Callable, Sequence

import numpy as np
from torch import Tensor

from deepfsi.designfile.distribution import (
    SMALLEST_STATISTIC,
    TAIL_CHANCES,
    TAIL_COUNTS,
    FrameLight,
    ReadoutCounts,
    ReadoutDistribution,
    ReadoutModel,
)

FEWEST_SCENES = 100
"""Scenes from which on a tail is calibrated."""

FEWEST_OF_A_CLASS = 50
"""Scenes of each class from which on a tail is calibrated: `IN_TAIL` of them are a fifth."""

MOST_SCENES = 4096
"""Training scenes that are looked at, at most."""

MOST_NUMBERS = 2**21
"""Scenes times readouts that are looked at, at most, but for `LEAST_SCENES`."""

LEAST_SCENES = 512
"""Training scenes that are looked at however many readouts there are."""

FIT_FOLDS = 4
"""Parts of the scenes, each calibrated with the covariance of the others."""

IN_TAIL = 10
"""Scenes to which a tail's power law is fitted, at least."""


def sample_scenes(count: int, readouts: int, seed: int = 0) -> np.ndarray:
    """Places of the training scenes, of `count`, that are looked at."""
    most = min(max(MOST_NUMBERS // readouts, LEAST_SCENES), MOST_SCENES)
    return np.random.default_rng(seed).permutation(count)[:most]


def find_distribution(
    rates: Tensor,
    labels: Sequence[int] | np.ndarray,
    classes: int,
    seed: int = 0,
    light: FrameLight | None = None,
) -> ReadoutDistribution | None:
    """Distribution of readouts of training scenes, or None where there are too few scenes.

    Rates (n, rails, m) are for a budget of one photon. Too few scenes of one of the labels (n,) are
    too few.
    """
    fluctuation = 0.0 if light is None else light.fluctuation
    every = rates.double().cpu().numpy()
    rng = np.random.default_rng([seed, 12])
    folds = np.array_split(rng.permutation(len(every)), FIT_FOLDS)
    # what the scenes of one fold alone light cannot be compared with those of the others
    lit = np.sum([(every[fold] > 0).any(axis=0) for fold in folds], axis=0) > 1
    sizes = np.bincount(labels, minlength=classes)
    if len(every) < FEWEST_SCENES or sizes.min() < FEWEST_OF_A_CLASS or not lit.any():
        return None
    held = every[:, lit]
    total = held.mean(axis=0).sum()

    def exposed(expected: float) -> np.ndarray:
        if light is not None:
            return light.counts(every * (expected / total), rng)[:, lit].astype(float)
        return rng.poisson(held * (expected / total)).astype(float)

    model = ReadoutModel.fit(held, fluctuation)
    tails, pairs = _calibrate(model, held, np.asarray(labels), folds, exposed=exposed)

    def spread_out(part: np.ndarray) -> np.ndarray:
        whole = np.zeros((*part.shape[:-1], *lit.shape), np.float32)
        whole[..., lit] = part
        return whole

    return ReadoutDistribution(
        mean=spread_out(model.share * model.total),
        spread=np.array(model.spread, np.float32),
        directions=spread_out(model.directions),
        rest=spread_out(model.rest),
        tails=tails.astype(np.float32),
        pairs=pairs.astype(np.float32),
        fluctuation=np.array(fluctuation, np.float32),
    )


def _calibrate(
    whole: ReadoutModel,
    rates: np.ndarray,
    labels: np.ndarray,
    folds: list[np.ndarray],
    exposed: Callable[[float], np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Tails (2, 2, counts, chances) of scenes (n, R), and (counts, chances) of pairs of them."""
    # Each scene is compared with the model of the other folds
    members = [np.flatnonzero(labels == k) for k in np.unique(labels)]
    couples = [each[: len(each) // 2 * 2].reshape(2, -1) for each in members]
    models = [ReadoutModel.fit(np.delete(rates, fold, axis=0), whole.fluctuation) for fold in folds]
    likeness = [np.empty((len(TAIL_COUNTS), couple.shape[1])) for couple in couples]
    levels = []
    for place, counts in enumerate(TAIL_COUNTS):
        expected = np.full(len(rates), counts * rates.shape[1])
        read = exposed(float(expected[0]))
        seen = ReadoutCounts(read, expected, np.zeros_like(read), np.ones_like(read))
        values = np.empty((2, len(rates)))
        for fold, model in zip(folds, models, strict=True):
            values[:, fold] = model.statistics(seen.rows(fold))
        for found, (first, second) in zip(likeness, couples, strict=True):
            found[place] = whole.likeness(seen.rows(first), seen.rows(second))
        levels.append(values)
    logs = np.log(np.maximum(np.stack(levels, axis=1), SMALLEST_STATISTIC))
    every = _tail(logs)
    worst = np.max([every, *(_tail(logs[..., each]) for each in members)], axis=0)
    pairs = np.max([_tail(np.log(found)) for found in likeness], axis=0)
    return np.stack([every, worst]), pairs


def _tail(logs: np.ndarray) -> np.ndarray:
    """Logarithms (..., chances) that values (..., n) exceed with each of `TAIL_CHANCES`."""
    chances = np.array(TAIL_CHANCES)
    tail = chances[chances * logs.shape[-1] >= IN_TAIL].min()
    bulk = np.moveaxis(np.quantile(logs, 1 - chances, axis=-1), 0, -1)
    start = bulk[..., chances == tail]
    beyond = np.where(logs > start, logs - start, 0).mean(axis=-1, keepdims=True) / tail
    return np.where(chances >= tail, bulk, start + beyond * np.log(tail / chances))

"""Tests of designs that estimate values: R² and errors over budgets, beside what is possible."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepfsi.base import Progress
from deepfsi.base.numeric import Z_95, image_interval
from deepfsi.camera import find_noise
from deepfsi.datasets import Dataset
from deepfsi.design.design import Design
from deepfsi.evaluation.bounds import linear_bound
from deepfsi.physics import Scanner

CHUNK = 1024
"""Scenes that are exposed at once."""

COVERS = (
    "test images and noise draws, of one training; the variance of the values is taken as known"
)


@dataclass(frozen=True)
class Estimates:
    """A design that estimates q values, at one budget.

    Attributes
    ----------
    photons : float
        Budget Φ.
    noise : str
        Of this test.
    r2, low, high : float
        R², 1 − mean squared error over variance, in the mean over values, and its 95 % interval.
    covers : str
        What the intervals cover.
    images, draws : int
        Scenes, and independent noise draws of each.
    values : list of str
        Names of the values.
    r2_each : list of float
        R² of each value.
    rmse, rmse_low, rmse_high : list of float
        Root mean squared error of each value, in its own unit, and its 95 % interval.
    bound : list of float or None
        That of the best linear estimator of the same counts (`bounds.linear_bound`), which no
        estimator is below where values and readouts are jointly normal; None of exposures that have
        none.
    counts, arriving, throughput, photons_per_mask
        As of `evaluation.Result`.
    explained : list of float
        Of each test image 1 − its squared error over the variance, in the mean over draws and
        values; R² is the mean over images. Not in `as_dict`.

    Examples
    --------
    >>> import deepfsi
    >>> digits = deepfsi.load_dataset("digits")
    >>> light = digits.x_train.mean(axis=1), digits.x_test.mean(axis=1)  # float: a value
    >>> data = deepfsi.from_arrays(digits.x_train, light[0], digits.x_test, light[1])
    >>> few = deepfsi.Training(epochs=2)
    >>> design = deepfsi.learn(data, photons=1e6, masks=4, design="pca", training=few)
    >>> [result] = deepfsi.evaluate(design, data, 1e6, draws=1)
    >>> len(result.rmse)
    1
    """

    photons: float
    noise: str
    r2: float
    low: float
    high: float
    covers: str
    images: int
    draws: int
    values: list[str]
    r2_each: list[float]
    rmse: list[float]
    rmse_low: list[float]
    rmse_high: list[float]
    bound: list[float] | None
    counts: float
    arriving: float
    throughput: float
    photons_per_mask: list[float]
    explained: list[float] = field(default_factory=list, repr=False)

    @property
    def clicks(self) -> bool:
        """True of detectors that click, whose counts are fewer than the photons that arrive."""
        return find_noise(self.noise).gates

    def as_dict(self) -> dict[str, Any]:
        """JSON types only, without the numbers of each image."""
        return {name: value for name, value in asdict(self).items() if name != "explained"}


def test_values(
    design: Design,
    scanner: Scanner,
    data: Dataset,
    budgets: Sequence[float],
    draws: int,
    seed: int,
    report: Progress,
) -> list[Estimates]:
    """Results of the estimates of the values of test scenes, at each budget."""
    assert design.values is not None
    rows = torch.from_numpy(data.x_test).split(CHUNK)
    found = []
    for done, budget in enumerate(budgets, start=1):
        generator = torch.Generator(design.exposure.device).manual_seed(seed)
        guesses, light = [], np.zeros(2)
        with torch.no_grad():
            for x in rows:
                rates = design.rates(scanner, x)
                every = [_exposed(design, scanner, rates, generator, budget) for _ in range(draws)]
                guesses.append(torch.stack([values for values, _ in every]))
                light += np.sum([sums for _, sums in every], axis=0)
        errors = torch.cat(guesses, dim=1).double().cpu().numpy() - data.y_test
        bound = linear_bound(design, scanner, data, budget)
        shares = design.shares.view(design.masks, -1).sum(dim=1).tolist()
        means = (light / (draws * len(data.x_test))).tolist()
        found.append(_result(budget, scanner.noise.name, data, errors, bound, means, shares))
        report(done / len(budgets))
    return found


def _exposed(
    design: Design, scanner: Scanner, rates: Tensor, generator: torch.Generator, budget: float
) -> tuple[Tensor, tuple[float, float]]:
    """Estimates (b, q) of scenes exposed once, and sums of expected counts and of photons."""
    assert design.values is not None
    seen = design.exposure.expose(scanner, rates, budget, generator)
    light = design.exposure.light(scanner, rates, seen, budget)
    estimated = design.values.estimated(design.logits_of(seen, budget))
    return estimated, (light.counts, light.photons)


def _result(
    budget: float,
    noise: str,
    data: Dataset,
    errors: np.ndarray,
    bound: list[float] | None,
    light: list[float],
    shares: list[float],
) -> Estimates:
    """Result of errors (draws, n, q) of estimates of test scenes."""
    squares = np.square(errors).mean(axis=0)
    power, half = squares.mean(axis=0), _half(squares)
    variance = data.y_test.var(axis=0, dtype=np.float64)
    variance[variance == 0] = np.nan  # of a value that is the same of all test scenes no R² is
    lost = squares / variance
    counts, arriving = light
    explained = 1 - lost.mean(axis=1)
    r2, low, high = image_interval(explained)
    return Estimates(
        photons=budget,
        noise=noise,
        r2=r2,
        low=low,
        high=min(high, 1.0),
        covers=COVERS,
        images=errors.shape[1],
        draws=len(errors),
        values=list(data.values),
        r2_each=(1 - lost.mean(axis=0)).tolist(),
        rmse=np.sqrt(power).tolist(),
        rmse_low=np.sqrt(np.clip(power - half, 0, None)).tolist(),
        rmse_high=np.sqrt(power + half).tolist(),
        bound=bound,
        counts=counts,
        arriving=arriving,
        throughput=sum(shares),
        photons_per_mask=[budget * part for part in shares],
        explained=explained.tolist(),
    )


def _half(values: np.ndarray) -> np.ndarray:
    """Half of the 95 % interval of a mean over images (n, …)."""
    return Z_95 * values.std(axis=0, ddof=min(len(values) - 1, 1)) / np.sqrt(len(values))

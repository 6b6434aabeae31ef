"""Counts are tested for what a design was trained for: sound ones pass as often as stated."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from conftest import quick
from deepfsi.base.errors import InputError
from deepfsi.datasets.arrays import from_arrays
from deepfsi.designfile.design_file import Temperatures
from deepfsi.designfile.distribution import REFUSED, UNSURE
from deepfsi.evaluation import confidence
from deepfsi.evaluation.confidence import find_distribution
from deepfsi.exposure.kind import temperatures_at

READOUTS = (2, 9)
CLASSES = 5


def scenes_of(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Shares of the budget of readouts (n, 2, m) of random scenes, heavy-tailed, with classes."""
    fixed, rng = np.random.default_rng(1), np.random.default_rng(seed)
    means = fixed.gamma(8.0, size=(CLASSES, *READOUTS)) / 8
    axes = 0.15 * fixed.normal(size=(4, *READOUTS))
    labels = rng.integers(CLASSES, size=count)
    along = rng.standard_t(5, size=(count, 4))
    rates = means[labels] * np.exp(np.tensordot(along, axes, axes=1).clip(-1, 1))
    rates *= np.exp(0.1 * rng.normal(size=(count, 1, 1)))
    rates[:, 1, 3] = 0  # a rail that is dark
    return 0.02 * rates, labels


@pytest.fixture(scope="module")
def known():
    rates, labels = scenes_of(confidence.MOST_SCENES, seed=2)
    return find_distribution(torch.from_numpy(rates), labels, CLASSES)


def assert_as_often(unsure, least_photons):
    """Within five sigma of this sample and of the one that calibrates."""
    error = 5 * np.sqrt(UNSURE * (1 / len(unsure) + 1 / confidence.MOST_SCENES))
    # counts of one or two take few values, so that fewer may be unsure
    least = UNSURE - error if least_photons > 100 else 0.0
    assert least <= unsure.mean() <= UNSURE + error


@pytest.mark.parametrize("dark", [0.0, 0.3, 3.0])
@pytest.mark.parametrize("photons", [30.0, 1e3, 2e4, 5e5, 1e9])
def test_sound_exposures_are_unsure_as_often_as_stated(known, photons, dark):
    rng = np.random.default_rng(3)
    rates, _ = scenes_of(8000, seed=4)
    background = dark * 0.01 * photons * rng.random(READOUTS)
    counts = rng.poisson(rates * photons + background) - background
    counts[:, 1, 3] = 0
    assert_as_often(known.test(counts, np.full(len(counts), photons), background).unsure, photons)


@pytest.mark.parametrize("classes", [CLASSES, 1, 2])
def test_sound_acquisitions_are_refused_as_seldom_as_stated(known, classes):
    """Of any size, budgets scene by scene, background and classes."""
    rng = np.random.default_rng(5)
    rates, labels = scenes_of(20_000, seed=6)
    trials, results = 300, []
    for _ in range(trials):
        there = np.flatnonzero(np.isin(labels, rng.choice(CLASSES, classes, replace=False)))
        chosen = rates[rng.choice(there, rng.choice([1, 2, 5, 20, 60]), replace=False)]
        photons = 10 ** rng.uniform(2, 7) * rng.uniform(0.7, 1.4, size=len(chosen))
        background = np.full(READOUTS, photons.mean() * 10 ** rng.uniform(-5, -2))
        background[1, 3] = 0
        counts = rng.poisson(chosen * photons[:, None, None] + background) - background
        results.append(known.test(counts, photons, background))
    most = trials * REFUSED + 5 * np.sqrt(trials * REFUSED)
    assert sum(each.refused for each in results) <= most
    assert sum(each.alike < REFUSED for each in results) <= most


@pytest.fixture(scope="module")
def data(digits):
    """Digits in another order, 800 of them to test with: the test part has other writers."""
    x = np.concatenate([digits.x_train, digits.x_test])
    y = np.concatenate([digits.y_train, digits.y_test])
    order = np.random.default_rng(0).permutation(len(x))
    x, y, n = x[order], y[order], len(x) - 800
    return replace(digits, x_train=x[:n], y_train=y[:n], x_test=x[n:], y_test=y[n:])


@pytest.fixture(scope="module")
def design(data):
    return quick(data, masks=16, light="equal-dwell")


@torch.no_grad()
def rates_of(design, x: np.ndarray) -> np.ndarray:
    return design.exposure.rates(design.scanner(), torch.from_numpy(x).float()).double().numpy()


def moved(rates: np.ndarray, frames) -> np.ndarray:
    """Rates with the frames of both rails in another order."""
    return rates.reshape(len(rates), -1)[:, frames].reshape(rates.shape)


SWAPPED = np.arange(32)
SWAPPED[[3, 20]] = 20, 3
FAULTS = {
    "another design": (1e4, lambda rates, data: rates_of(another(data), data.x_test)),
    "half the light": (1e3, lambda rates, _: rates / 2),
    "twice the light": (1e2, lambda rates, _: rates * 2),
    "a frame late": (1e4, lambda rates, _: moved(rates, np.roll(np.arange(32), 1))),
    "two frames swapped": (3e5, lambda rates, _: moved(rates, SWAPPED)),
    "rails swapped": (1e4, lambda rates, _: rates[:, ::-1]),
}


def another(data):
    return quick(data, "random", masks=16, light="equal-dwell")


@pytest.mark.parametrize("fault", [*FAULTS, "inverted scenes"])
def test_what_is_not_trained_for_is_refused(design, data, fault):
    x = 1 - data.x_test if fault == "inverted scenes" else data.x_test
    photons, change = FAULTS.get(fault, (1e5, lambda rates, _: rates))
    counts = np.random.default_rng(7).poisson(change(rates_of(design, x), data) * photons)
    for part in np.split(counts, len(counts) // 40):
        assert design.consistency(part, photons).refused


def test_what_has_no_distribution_says_so(data, design):
    few = from_arrays(data.x_train[:60].reshape(-1, 8, 8), data.y_train[:60] % 2)
    for each in (quick(few, masks=4, batch=32), design.quantised(3)):
        assert each.distribution is None
        with pytest.raises(InputError, match="no distribution"):
            each.consistency(np.ones((1, *each.rails.stacked.shape[:2])), 1e3)


@pytest.mark.parametrize(
    ("counts", "photons", "said"),
    [
        (np.ones((3, 2, 15)), 1e3, "do not fit"),
        (np.ones((0, 2, 16)), 1e3, "no exposures"),
        (np.ones((1, 2, 16)), 0.0, "photons"),
    ],
)
def test_bad_counts_are_named(design, counts, photons, said):
    with pytest.raises(InputError, match=said):
        design.consistency(counts, photons)


FITTED = Temperatures(np.array([[4.0, 2.0, 0.0], [2.0, 1.0, 0.0]]), np.array([1.0, 10.0, 100.0]))


def temperature(stop, photons):
    budget = torch.tensor([photons], dtype=torch.double)
    return float(temperatures_at(FITTED, torch.tensor([stop - 1.0]), budget))


def test_their_logarithm_is_interpolated():
    assert temperature(1, 1.0) == pytest.approx(np.exp(4))
    assert temperature(2, 10**1.5) == pytest.approx(np.exp(0.5))
    assert temperature(1.5, 10.0) == pytest.approx(np.exp(1.5))
    assert temperature(8, 1e9) == pytest.approx(1)  # the last look, the highest budget
    assert temperature(1, 0.01) == pytest.approx(np.exp(4) * 100)  # as 1 / Φ

"""The ideal observer is what the laws of probability say, and nothing told the truth beats it."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.special import logsumexp
from scipy.stats import poisson

from conftest import every_optics, generator
from deepfsi import InputError, evaluate, ideal_observer
from deepfsi.base.progress import Progress
from deepfsi.evaluation.ideal import IdealObserver


def exact(rates: np.ndarray, labels: np.ndarray, counts: np.ndarray, photons: float) -> np.ndarray:
    """Class probabilities (b, C) from the Poisson law, in float64 and readout by readout."""
    mean = photons * rates.reshape(len(rates), -1).astype(float)
    read = counts.reshape(len(counts), 1, -1)
    with np.errstate(divide="ignore"):
        logs = poisson.logpmf(read, mean).sum(axis=2)
    each = [logsumexp(logs[:, labels == k], axis=1) for k in range(labels.max() + 1)]
    return np.exp(np.stack(each, axis=1) - logsumexp(logs, axis=1)[:, None])


@pytest.mark.parametrize("photons", [3.0, 1e3, 1e5, 1e7])
@every_optics
def test_chances_are_those_of_the_poisson_law(made, digits, light, rails, photons):
    design = made("pca", light, rails)
    scanner = design.scanner()
    x = torch.from_numpy(digits.x_train[:300])
    rates, labels = design.exposure.rates(scanner, x), digits.y_train[:300]
    seen = design.exposure.rates(scanner, torch.from_numpy(digits.x_test[:60]))
    counts = scanner.read(seen * photons, generator())
    found = IdealObserver(rates, torch.from_numpy(labels), 10).probabilities(counts, photons)
    lit = rates.flatten(1).amax(dim=0).numpy() > 0  # scipy gives NaN for 0 counts of rate 0
    flat, read = rates.flatten(1).numpy()[:, lit], counts.flatten(1).numpy()[:, lit]
    np.testing.assert_allclose(found, exact(flat, labels, read, photons), atol=2e-3)


@pytest.mark.parametrize("photons", [30.0, 300.0])
def test_no_other_rule_is_better_on_scenes_of_the_prior(good, made, digits, photons):
    """Test scenes are the training scenes: no rule has a higher accuracy in the mean."""
    known = replace(digits, x_test=digits.x_train, y_test=digits.y_train)
    draws = 4
    [ideal] = ideal_observer(good, known, photons, draws=draws)
    [network] = evaluate(good, known, photons, draws=draws, seed=1)
    spread = math.sqrt(2 * 0.25 / len(known.y_test))
    assert ideal.accuracy > network.accuracy - 5 * spread
    assert ideal.photons_per_mask == pytest.approx(network.photons_per_mask, rel=1e-4)
    [bound] = ideal_observer(made("impulse", "column", "single"), known, photons)
    assert bound.draws == 1
    assert bound.accuracy > ideal.accuracy - 5 * spread, "column designs route impulse imaging's"


@pytest.mark.parametrize("test", [evaluate, ideal_observer])
def test_a_test_draws_by_seed_0_and_ends_with_all_done(good, digits, test):
    shares = []
    progress = Progress(lambda share, _: shares.append(share))
    found = test(good, digits, [30.0, 100.0], draws=1, report=progress)
    assert found == test(good, digits, [30.0, 100.0], draws=1, seed=0)
    assert shares[-1] == 1


def test_what_cannot_be_had_is_refused(good, digits):
    with pytest.raises(InputError, match="photon budget"):
        ideal_observer(good, digits, -1.0)


def test_counts_that_a_scene_cannot_give_exclude_it():
    rates = torch.tensor([[0.5, 0.0, 0.0], [0.3, 0.2, 0.0], [0.1, 0.2, 0.2]])
    counts = torch.tensor([[3.0, 1, 0], [3, 0, 1], [9, 0, 0]])
    chances = IdealObserver(rates, torch.arange(3), 4).probabilities(counts, 10.0)
    assert (chances > 0).tolist() == [
        [False, True, True, False],
        [False, False, True, False],
        [True, True, True, False],  # the fourth is a class without a scene
    ]


def test_where_no_scene_can_give_the_counts_the_fewest_impossible_ones_count():
    """The limit of a background that vanishes, and readouts that no scene lights say nothing."""
    rates = torch.tensor([[0.5, 0.0, 0.2, 0.0], [0.0, 0.4, 0.2, 0.0], [0.5, 0.2, 0.0, 0.0]])
    counts = torch.tensor([[2.0, 1, 3, 0], [2, 1, 3, 7], [1, 1, 1, 0]])
    found = IdealObserver(rates, torch.arange(3), 3).probabilities(counts, 10.0)
    dim_rates, counts = rates.double() + 1e-30, counts.double()
    dim = IdealObserver(dim_rates, torch.arange(3), 3).probabilities(counts, 10.0)
    np.testing.assert_allclose(found, dim, atol=1e-6)
    assert torch.equal(found[0], found[1])

"""The ideal observer is what the laws of probability say, and nothing told the truth beats it."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.special import logsumexp
from scipy.stats import poisson

from conftest import every_optics, generator, real_mnist
from deepfsi import IdealObserver, evaluate, ideal_observer
from deepfsi.base.errors import InputError
from deepfsi.datasets.arrays import from_arrays
from deepfsi.datasets.load import load_dataset


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
    rates, labels = design.rates(scanner, x), digits.y_train[:300]
    seen = design.rates(scanner, torch.from_numpy(digits.x_test[:60]))
    counts = scanner.read(seen * photons, generator())
    found = IdealObserver(rates, torch.from_numpy(labels), 10).chances(counts, photons)
    lit = rates.flatten(1).amax(dim=0).numpy() > 0  # scipy gives NaN for 0 counts of rate 0
    flat, read = rates.flatten(1).numpy()[:, lit], counts.flatten(1).numpy()[:, lit]
    np.testing.assert_allclose(found, exact(flat, labels, read, photons), atol=2e-3)


def test_two_scenes_are_told_apart_as_by_the_likelihood_ratio():
    """One readout, one scene a class: the error is Σ min(P(y | a), P(y | b)) / 2."""
    a, b, photons = 0.4, 0.7, 20.0
    observer = IdealObserver(torch.tensor([[a], [b]]), torch.tensor([0, 1]), 2)
    counts = np.arange(80)
    likelihood = np.stack([poisson.pmf(counts, photons * rate) for rate in (a, b)], axis=1)
    chances = observer.chances(torch.from_numpy(counts[:, None]).float(), photons).numpy()
    ratio = likelihood / likelihood.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(chances, ratio, atol=1e-5)
    error = likelihood[counts, 1 - chances.argmax(axis=1)].sum() / 2
    assert error == pytest.approx(likelihood.min(axis=1).sum() / 2, abs=1e-12)

    scenes, labels = np.array([[a], [b]]), np.array([0, 1])
    data = from_arrays(scenes, labels, np.tile(scenes, (4000, 1)), np.tile(labels, 4000))
    phi = photons * scenes.mean()  # so that the mean counts are those above
    [found] = ideal_observer(torch.ones(1, 1, 1), data, phi)
    spread = math.sqrt(error * (1 - error) / 8000)
    assert abs(1 - found.accuracy - error) < 5 * spread


@pytest.mark.parametrize("photons", [30.0, 300.0])
def test_no_other_rule_is_better_on_scenes_of_the_prior(good, digits, photons):
    """Test scenes are the training scenes: no rule has a higher accuracy in the mean."""
    known = replace(digits, x_test=digits.x_train, y_test=digits.y_train)
    draws = 4
    [ideal] = ideal_observer(good, known, photons, draws=draws)
    [network] = evaluate(good, known, photons, draws=draws, seed=1)
    spread = math.sqrt(2 * 0.25 / len(known.y_test))
    assert ideal.accuracy > network.accuracy - 5 * spread
    [bound] = ideal_observer(torch.eye(known.pixels)[None], known, photons, draws=draws)
    assert bound.accuracy > ideal.accuracy - 5 * spread, "column designs route impulse imaging's"


def test_what_cannot_be_had_is_refused(good, digits):
    for design, photons, match in (
        (good, -1.0, "photon budget"),
        (torch.eye(63)[None], 1e3, "photons of shape"),
    ):
        with pytest.raises(InputError, match=match):
            ideal_observer(design, digits, photons)


@real_mnist
@pytest.mark.slow
def test_one_photon_tells_what_was_published_first():
    """Fischbacher and Sbaiz, *Single-photon image classification*: MNIST from exactly one photon.

    The best rule that knows the test images is right in 0.2296, as in their manuscript of 2020
    (their later text has 0.2127); that of the training images in 0.2284. Both are sums over
    pixels, without any draw.
    """
    data = load_dataset("mnist", rescale=(0.0, 1.0))
    where = torch.eye(data.pixels)

    def accuracy(prior: np.ndarray, labels: np.ndarray) -> float:
        # scenes of one brightness: that there is one photon says nothing
        known = torch.from_numpy(prior / prior.sum(axis=1, keepdims=True))
        observer = IdealObserver(known, torch.from_numpy(labels), 10)
        answer = observer.chances(where, 1.0).argmax(dim=1).numpy()
        right = [photons[label, answer == label].sum() for label in range(10)]
        return float(sum(right) / len(data.x_test))

    photon = data.x_test / data.x_test.sum(axis=1, keepdims=True, dtype=np.float64)
    photons = np.stack([photon[data.y_test == label].sum(axis=0) for label in range(10)])

    assert accuracy(data.x_test, data.y_test) == pytest.approx(0.2296, abs=5e-5)
    assert accuracy(data.x_train, data.y_train) == pytest.approx(0.2284, abs=5e-5)


def test_counts_that_a_scene_cannot_give_exclude_it():
    rates = torch.tensor([[0.5, 0.0, 0.0], [0.3, 0.2, 0.0], [0.1, 0.2, 0.2]])
    counts = torch.tensor([[3.0, 1, 0], [3, 0, 1], [9, 0, 0]])
    chances = IdealObserver(rates, torch.arange(3), 4).chances(counts, 10.0)
    assert (chances > 0).tolist() == [
        [False, True, True, False],
        [False, False, True, False],
        [True, True, True, False],  # the fourth is a class without a scene
    ]


def test_where_no_scene_can_give_the_counts_the_fewest_impossible_ones_count():
    """The limit of a background that vanishes, and readouts that no scene lights say nothing."""
    rates = torch.tensor([[0.5, 0.0, 0.2, 0.0], [0.0, 0.4, 0.2, 0.0], [0.5, 0.2, 0.0, 0.0]])
    counts = torch.tensor([[2.0, 1, 3, 0], [2, 1, 3, 7], [1, 1, 1, 0]])
    found = IdealObserver(rates, torch.arange(3), 3).chances(counts, 10.0)
    dim = IdealObserver(rates.double() + 1e-30, torch.arange(3), 3).chances(counts.double(), 10.0)
    np.testing.assert_allclose(found, dim, atol=1e-6)
    assert torch.equal(found[0], found[1])

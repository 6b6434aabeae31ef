"""Adaptive masks: the posterior is Poisson's law, and the next mask is what tells most."""

import numpy as np
import pytest
import torch
from scipy.special import logsumexp, xlogy
from scipy.stats import nbinom, poisson, spearmanr

from conftest import generator
from deepfsi.design.adaptive import (
    AdaptivePosterior,
    ScenePrior,
    adaptive_masks,
    brightest,
    separation,
)
from deepfsi.design.evaluation import evaluate
from deepfsi.errors import InputError

PIXELS, SCENES, CLASSES = 8, 40, 3


def small(seed: int, classes: int = CLASSES):
    """Scenes (n, N) of classes (n,), about a pattern of each class."""
    rng = np.random.default_rng(seed)
    labels = rng.permutation(np.arange(SCENES) % classes)
    x = 0.3 + 0.5 * rng.random((classes, PIXELS))[labels] + 0.2 * rng.random((SCENES, PIXELS))
    return x.astype(np.float32), labels


def expected(x, masks, photons, dark):
    """Counts (n, looks) of looks of equal length, in float64."""
    looks = len(masks)
    return (photons * x.astype(float) @ masks.T / x.sum(axis=1).mean() + dark) / looks


def told(x, labels, masks, counts, photons, **settings):
    """Posterior after looks that show masks (looks, N) and count (b, looks)."""
    state = AdaptivePosterior(ScenePrior(x, labels, CLASSES), len(counts), photons, **settings)
    for mask, found in zip(masks, counts.T, strict=True):
        row = torch.from_numpy(mask).float().expand(len(counts), -1)
        state.update(row, torch.from_numpy(found).float(), 1 / len(masks))
    return state


def by_hand(logs, labels):
    each = np.stack([logsumexp(logs[:, labels == k], axis=1) for k in range(CLASSES)], axis=1)
    return np.exp(each - logsumexp(each, axis=1)[:, None])


@pytest.mark.parametrize("photons", [1.0, 1e2, 1e4, 1e7])
@pytest.mark.parametrize("dark", [0.0, 30.0])
def test_the_posterior_is_that_of_the_poisson_law(photons, dark):
    x, labels = small(0)
    rng = np.random.default_rng(1)
    masks = (rng.random((6, PIXELS)) < 0.5).astype(float)
    mean = expected(x, masks, photons, dark)
    counts = rng.poisson(mean[:20])
    found = told(x, labels, masks, counts, photons, dark=dark).chances
    exact = poisson.logpmf(counts[:, None], mean).sum(axis=2)
    np.testing.assert_allclose(found, by_hand(exact, labels), atol=2e-3)


@pytest.mark.parametrize("mismatch", [0.01, 0.1])
def test_a_mismatch_makes_counts_negative_binomial(mismatch):
    """Of a gamma law of the light about each scene's, with that relative standard deviation."""
    x, labels = small(0)
    rng = np.random.default_rng(1)
    masks = (rng.random((6, PIXELS)) < 0.5).astype(float)
    masks[:, 0] = 1
    mean, size = expected(x, masks, 1e4, 0.0), mismatch**-2
    counts = rng.poisson(mean[:20])
    found = told(x, labels, masks, counts, 1e4, mismatch=mismatch).chances
    exact = nbinom.logpmf(counts[:, None], size, size / (size + mean)).sum(axis=2)
    np.testing.assert_allclose(found, by_hand(exact, labels), atol=2e-3)


def every_mask() -> np.ndarray:
    return (np.arange(1, 2**PIXELS)[:, None] >> np.arange(PIXELS) & 1).astype(np.float32)


def test_the_brightest_mask_is_nearly_the_best_of_all():
    """Of all 255 masks: the largest squared difference over its photons."""
    rng = np.random.default_rng(2)
    differ, scene = rng.normal(size=(50, PIXELS)), rng.random((50, PIXELS)) + 0.1
    differ[:, 0] = abs(differ[:, 0])  # else the best mask may be all OFF
    masks = every_mask()
    signal, noise = differ @ masks.T, scene @ masks.T
    best = np.where(signal > 0, signal**2 / noise, 0).max(axis=1)
    found = brightest(torch.from_numpy(differ), torch.from_numpy(scene)).numpy()
    mine = (found * differ).sum(axis=1) ** 2 / (found * scene).sum(axis=1)
    assert (mine > 0.5 * best).all()
    assert (mine / best).mean() > 0.95


def information(mean, labels) -> np.ndarray:
    """Nats that Poisson counts of means (n, P) tell of the classes, summed count by count."""
    counts = np.arange(int(mean.max() + 10 * np.sqrt(mean.max()) + 20))
    law = poisson.pmf(counts[:, None, None], mean)  # (counts, n, P)
    joint = np.stack([law[:, labels == k].sum(axis=1) for k in range(CLASSES)]) / len(labels)
    apart = joint.sum(axis=0) * joint.sum(axis=1, keepdims=True)
    return (xlogy(joint, joint) - xlogy(joint, apart.clip(1e-300))).sum(axis=(0, 1))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("photons", [30.0, 300.0])
def test_the_first_mask_tells_nearly_as_much_as_the_best_fixed_one(seed, photons):
    """Of all 255 masks, by brute force; it is the same for all exposures."""
    x, labels = small(seed)
    state = AdaptivePosterior(ScenePrior(x, labels, CLASSES), 4, photons)
    first = state.choose(1.0, generator()).numpy()
    assert (first == first[0]).all()
    masks = every_mask()
    told = information(photons * x.astype(float) @ masks.T / x.sum(axis=1).mean(), labels)
    [mine] = told[(masks == first[0]).all(axis=1)]
    assert mine > 0.85 * told.max()


def test_separation_ranks_masks_as_their_information_does():
    x, labels = small(3)
    masks = every_mask()
    mean = 200.0 * x.astype(float) @ masks.T / x.sum(axis=1).mean()
    members = np.eye(CLASSES)[labels] / SCENES
    found = separation(*(torch.from_numpy(each)[None] for each in (mean.T, members)))[0].numpy()
    told = information(mean, labels)
    assert told[found.argmax()] > 0.9 * told.max()
    assert spearmanr(found, told).statistic > 0.95


def test_names_of_classes_do_not_matter():
    """All scenes are compared where they are few, so the masks are the same."""
    x, labels = small(4)
    other = np.array([2, 0, 1])
    photons, counts = 300.0, torch.tensor([40.0, 60.0])
    states = [
        AdaptivePosterior(ScenePrior(x, each, CLASSES), 2, photons)
        for each in (labels, other[labels])
    ]
    masks = [state.choose(0.5, generator()) for state in states]
    assert torch.equal(*masks)
    for state in states:
        state.update(masks[0], counts, 0.5)
    torch.testing.assert_close(states[1].chances[:, other], states[0].chances)
    assert torch.equal(*(state.choose(0.5, generator()) for state in states))


def test_each_mask_is_of_what_its_own_exposure_counted():
    x, labels = small(5)
    state = AdaptivePosterior(ScenePrior(x, labels, CLASSES), 2, 1e3)
    first = state.choose(0.5, generator())
    mean = float(state.expected(first[:1], torch.from_numpy(x).mean(dim=0)[None], 0.5))
    state.update(first, torch.tensor([0.7 * mean, 1.3 * mean]), 0.5)
    second = state.choose(0.5, generator())
    assert not torch.equal(second[0], second[1])
    assert set(second.unique().tolist()) <= {0.0, 1.0}


@pytest.mark.slow
def test_adaptive_masks_tell_more_than_fixed_ones_and_as_sure_as_right(digits, made):
    [found] = adaptive_masks(digits, 1e4, looks=16)
    [fixed] = evaluate(made("deepfsi", "free-dwell", "single"), digits, 1e4)
    assert found.low > fixed.high
    assert found.accuracy > 0.95
    assert found.calibration_error < 0.03
    [again] = adaptive_masks(digits, 1e4, looks=16)
    assert again == found


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"looks": 0}, "looks = 0"),
        ({"looks": True}, "looks = True"),
        ({"prior": 10**9}, "prior = 1000000000"),
        ({"components": 0}, "components = 0"),
        ({"dark": -1.0}, "dark = -1.0"),
        ({"mismatch": float("nan")}, "mismatch = nan"),
    ],
)
def test_what_cannot_be_is_one_line(digits, settings, said):
    with pytest.raises(InputError, match=said):
        adaptive_masks(digits, 1e4, **settings)

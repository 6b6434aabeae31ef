"""Priors of cluster centres: normal scenes about each, and as many as it stands for."""

import numpy as np
import pytest
import torch
from scipy.spatial.distance import cdist
from scipy.special import softmax
from scipy.stats import multivariate_normal

from deepfsi.adaptive import posterior
from deepfsi.adaptive.posterior import AdaptivePosterior, ScenePrior
from deepfsi.base.errors import InputError
from deepfsi.designfile.design_file import Temperatures

PIXELS, SIZES = 8, (30, 60, 90)


def unequal(seed: int = 0):
    """Scenes (n, N) about a pattern of each class, in classes (n,) of unequal sizes."""
    rng = np.random.default_rng(seed)
    labels = rng.permutation(np.repeat(np.arange(len(SIZES)), SIZES))
    x = 0.3 + 0.4 * rng.random((len(SIZES), PIXELS))[labels]
    return (x + 0.1 * rng.normal(size=(sum(SIZES), PIXELS)).clip(-2, 2)).astype(np.float32), labels


def test_one_centre_a_class_is_a_normal_law_of_each_class():
    """At so many photons counts are normal: by hand, from the scenes themselves."""
    (x, labels), rng = unequal(), np.random.default_rng(1)
    photons, shares = 3e5, np.full(6, 1 / 6)
    masks = (rng.random((6, PIXELS)) < 0.5).astype(np.float32)
    lit = masks * (photons * shares[:, None] / x.sum(axis=1).mean())
    counts = rng.poisson(x[::9] @ lit.T)
    prior = ScenePrior(x, labels, 3, clusters=1)
    state = AdaptivePosterior(prior, len(counts), posterior.LookOptics(photons))
    for mask, count, share in zip(masks, counts.T, shares, strict=True):
        row = torch.from_numpy(mask).expand(len(counts), -1)
        state.update(row, torch.from_numpy(count[:, None]).float(), share)
    means = np.stack([x[labels == k].mean(axis=0) for k in range(3)]).astype(float)
    away = x - means[labels]
    near = prior.spread**2 * away.T @ away / len(x)
    noise = lit @ near @ lit.T + np.diag(lit @ x.mean(axis=0))
    laws = [multivariate_normal(lit @ mean, noise).logpdf(counts) for mean in means]
    exact = softmax(np.stack(laws, axis=1) + np.log(SIZES), axis=1)
    np.testing.assert_allclose(state.probabilities, exact, atol=0.05)
    assert (exact.max(axis=1) < 0.9).any(), "some classes are not told apart"


def test_centres_are_means_of_their_scenes_and_components_the_distances_from_them():
    (x, labels), clusters = unequal(), 4
    prior = ScenePrior(x, labels, 3, components=PIXELS, clusters=clusters)
    assert prior.labels.tolist() == np.repeat(range(3), clusters).tolist()
    mean, components = prior.mean.numpy(), prior.components.numpy()
    away = []
    for label, (own, many) in enumerate(zip(
        prior.coefficients.numpy().reshape(3, clusters, -1),
        prior.members.numpy().reshape(3, clusters),
        strict=True,
    )):  # fmt: skip
        centres = mean + own @ components
        scenes = x[labels == label]
        nearest = cdist(scenes, centres).argmin(axis=1)  # K-means has converged
        np.testing.assert_array_equal(many, np.bincount(nearest, minlength=clusters))
        means = [scenes[nearest == k].mean(axis=0) for k in range(clusters)]
        np.testing.assert_allclose(centres, means, atol=1e-5)
        away.append((scenes - centres[nearest]) @ np.linalg.inv(components))
    covariance = np.cov(np.concatenate(away).T, bias=True) * prior.spread**2
    np.testing.assert_allclose(covariance, np.eye(PIXELS), atol=2e-3)


@pytest.mark.parametrize(
    ("scenes", "clusters", "match"),
    [
        ([0, 1], None, "from how scenes differ"),  # one of a class
        ([0, 0, 0, 1, 1, 1], None, "without copies"),
        ([0, 0, 0, 1, 1, 1], 1, "without copies"),
        ([0, 2, 2, 1, 3, 3], 3, "give fewer `clusters`"),
    ],
)
@pytest.mark.filterwarnings("ignore:Number of distinct clusters")
def test_scenes_that_do_not_differ_are_refused(scenes, clusters, match):
    """They say nothing of how scenes lie about each other: posteriors were not numbers."""
    x = np.random.default_rng(0).random((4, PIXELS), np.float32)[scenes]
    with pytest.raises(InputError, match=match):
        ScenePrior(x, np.array(scenes) % 2, 2, spread=0.3, clusters=clusters)


def test_a_part_of_a_prior_has_scenes_of_each_class_by_lot():
    rng = np.random.default_rng(0)
    labels = np.repeat(np.arange(4), [1, 20, 300, 79])
    prior = ScenePrior(rng.random((400, 6)).astype(np.float32), labels, 4, spread=0.5)
    few, again, other = prior.subset(100, 1), prior.subset(100, 1), prior.subset(100, 2)
    assert few.sizes == [1, 5, 75, 19]
    assert torch.equal(few.coefficients, again.coefficients)
    assert not torch.equal(few.coefficients, other.coefficients)
    step = prior.coefficients.abs().amax(dim=0) / 127
    far = (few.coefficients[:, None] - prior.coefficients).abs()
    found = (far <= 0.501 * step).all(dim=2).nonzero()[:, 1]
    assert len(found) == 100  # each is one of them, and no other
    assert torch.equal(few.labels, prior.labels[found])
    assert prior.subset(10**6).sizes == prior.sizes


@pytest.mark.parametrize("clusters", [None, 5])
def test_the_model_of_a_prior_has_its_moments(clusters):
    """Of scenes about the means of their classes, and about their centres by the prior's law."""
    x, labels = unequal()
    prior = ScenePrior(x, labels, 3, components=PIXELS, clusters=clusters)
    scenes = (prior.mean + prior.coefficients @ prior.components).double().numpy()
    members, classes = prior.members.double().numpy(), prior.labels.numpy()
    means = np.stack([x[labels == k].mean(axis=0) for k in range(3)])
    away = scenes - means[classes]
    covariance = (away.T * members) @ away / (len(x) - 3)
    if clusters:
        parts = prior.components.double().numpy()
        covariance = covariance + parts.T @ parts
    model = prior.model
    axes = model.axes.astype(float)
    np.testing.assert_allclose(model.means, means, atol=1e-3)
    np.testing.assert_allclose(axes.T @ axes + np.diag(model.rest), covariance, atol=3e-4)
    np.testing.assert_allclose(model.shares, np.array(SIZES) / sum(SIZES), atol=1e-3)
    np.testing.assert_allclose(prior.class_shares, np.array(SIZES) / sum(SIZES), rtol=1e-6)
    assert ScenePrior(x[::5], labels[::5], 3).model is None, "too few scenes of a class"


@pytest.mark.parametrize("spread", [0.5, 2.0])
def test_scenes_lie_about_each_other_as_nearest_neighbours_of_a_class_do(spread):
    """A thousandth of the mean variance is added in every direction."""
    x, labels = unequal()
    few = [*np.flatnonzero(labels == 0)[1:], *np.flatnonzero(labels == 1)[2:]]
    x, labels = np.delete(x, few, axis=0), np.delete(labels, few)
    prior = ScenePrior(x, labels, 3, components=PIXELS, spread=spread)
    away = []
    for k in (1, 2):  # a scene that is alone in its class has no neighbour
        scenes = x[labels == k].astype(float)
        apart = cdist(scenes, scenes) + np.diag(np.full(len(scenes), np.inf))
        away.append(scenes - scenes[apart.argmin(axis=1)])
    away = np.concatenate(away) * spread
    covariance = away.T @ away / len(away)
    covariance += 1e-3 * np.trace(covariance) / PIXELS * np.eye(PIXELS)
    parts = prior.components.double().numpy()
    np.testing.assert_allclose(parts.T @ parts, covariance, rtol=1e-3, atol=1e-5)
    again = prior.mean + prior.coefficients @ prior.components
    np.testing.assert_allclose(again, x[prior.order], atol=1e-4)
    stored = ScenePrior.restored(prior.arrays)
    assert torch.equal(stored.labels, prior.labels)
    assert (stored.spread, stored.sizes) == (spread, [1, 2, 90])


def test_temperatures_divide_odds_and_not_the_shares_before_all_looks():
    """Those of the look before: after two looks, and at ten times the budget, half as sure."""
    x, labels = unequal()
    prior = ScenePrior(x, labels, 3)
    odds = torch.tensor([[1.0, -2.0, 0.5]])
    shares = torch.tensor(SIZES) / sum(SIZES)
    usual = (odds.exp() * shares / (odds.exp() * shares).sum()).float()
    torch.testing.assert_close(prior.calibrated(odds, 1, 1e3), usual)
    logs = np.log([[1.0, 1.0], [1.5, 2.0], [4.0, 4.0]])
    prior.temperatures = Temperatures(logs, np.array([1e3, 1e4]))
    half = (odds / 2).exp() * shares
    torch.testing.assert_close(prior.calibrated(odds, 2, 1e4), (half / half.sum()).float())
    state = AdaptivePosterior(prior, 1, posterior.LookOptics(1e4))
    torch.testing.assert_close(state.probabilities, shares[None])
    torch.testing.assert_close(state.odds, torch.zeros(1, 3))
    sure = torch.tensor([[0.5e-9, 1 - 1e-9, 0.5e-9]])
    assert posterior.confidence_of(sure).tolist() == [1 - 1e-9]


def test_memory_holds_four_million_likelihoods_of_32_exposures_at_most():
    x, labels = unequal()
    prior = ScenePrior(x, labels, 3)
    for scenes, exposures in ((2**17, 32), (2**17 + 1, 31), (2**20, 4), (2**23, 1)):
        prior.labels = torch.zeros(1).expand(scenes)
        assert prior.exposed_at_once == exposures


def test_a_file_keeps_coefficients_to_half_a_step_of_the_largest():
    x, labels = unequal()
    prior = ScenePrior(0.5 + 1e-3 * x, labels, 3)  # all are far below 1
    again = ScenePrior.restored(prior.arrays)
    largest = prior.coefficients.abs().amax(dim=0)
    error = (again.coefficients - prior.coefficients).abs().amax(dim=0)
    assert (error <= 1.001 * largest / 254).all()

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

"""Priors of cluster centres: normal scenes about each, and as many as it stands for."""

import numpy as np
import pytest
import torch
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from deepfsi import evaluate, learn
from deepfsi.base import InputError
from deepfsi.exposure import AdaptivePosterior, ScenePrior
from deepfsi.exposure.posterior import LookOptics
from deepfsi.jobs import Job

PIXELS, SIZES = 8, (30, 60, 90)
PHOTONS = 1e3


def unequal(seed: int = 0):
    """Scenes (n, N) about a pattern of each class, in classes (n,) of unequal sizes."""
    rng = np.random.default_rng(seed)
    labels = rng.permutation(np.repeat(np.arange(len(SIZES)), SIZES))
    x = 0.3 + 0.4 * rng.random((len(SIZES), PIXELS))[labels]
    return (x + 0.1 * rng.normal(size=(sum(SIZES), PIXELS)).clip(-2, 2)).astype(np.float32), labels


def settings(clusters=None) -> dict:
    return {
        "design": "adaptive",
        "masks": 8,
        "photons": PHOTONS,
        "training": {"clusters": clusters},
    }


def test_before_any_count_classes_are_as_likely_as_they_are_frequent():
    state = AdaptivePosterior(ScenePrior(*unequal(), 3, clusters=4), 2, LookOptics(PHOTONS))
    wanted = torch.tensor(SIZES) / sum(SIZES)
    torch.testing.assert_close(state.chances, wanted.expand(2, 3))
    torch.testing.assert_close(state.scene, state.prior.mean.expand(2, PIXELS))


@pytest.mark.parametrize("clusters", [1, 4, 15])
def test_scenes_of_the_prior_vary_as_those_of_the_training(clusters):
    """Covariance within clusters and between their centres, together; by pixels."""
    x, labels = unequal()
    prior = ScenePrior(x, labels, 3, clusters=clusters)
    assert prior.sizes == [clusters] * 3
    parts, weights = prior.components.double(), prior.members.double() / len(x)
    centres = prior.coefficients.double() @ parts
    between = centres.T @ (weights[:, None] * centres)
    whole = np.cov(x.T.astype(float), bias=True)
    off = (parts.T @ parts / prior.spread**2 + between).numpy() - whole
    assert np.abs(off).max() < 2e-3 * np.diag(whole).mean()  # twice the least variance
    assert prior.members.sum() == len(x)


def test_one_centre_a_class_is_a_normal_law_of_each_class():
    """At so many photons counts are normal: by hand, from the scenes themselves."""
    (x, labels), rng = unequal(), np.random.default_rng(1)
    photons, shares = 3e5, np.full(6, 1 / 6)
    masks = (rng.random((6, PIXELS)) < 0.5).astype(np.float32)
    lit = masks * (photons * shares[:, None] / x.sum(axis=1).mean())
    counts = rng.poisson(x[::9] @ lit.T)
    prior = ScenePrior(x, labels, 3, clusters=1)
    state = AdaptivePosterior(prior, len(counts), LookOptics(photons))
    for mask, count, share in zip(masks, counts.T, shares, strict=True):
        row = torch.from_numpy(mask).expand(len(counts), -1)
        state.update(row, torch.from_numpy(count[:, None]).float(), share)
    means = np.stack([x[labels == k].mean(axis=0) for k in range(3)]).astype(float)
    away = x - means[labels]
    near = prior.spread**2 * away.T @ away / len(x)
    noise = lit @ near @ lit.T + np.diag(lit @ x.mean(axis=0))
    logs = np.stack(
        [
            multivariate_normal(lit @ mean, noise).logpdf(counts) + np.log(size)
            for mean, size in zip(means, SIZES, strict=True)
        ],
        axis=1,
    )
    exact = np.exp(logs - logsumexp(logs, axis=1)[:, None])
    np.testing.assert_allclose(state.chances, exact, atol=0.05)
    assert (exact.max(axis=1) < 0.9).any(), "some classes are not told apart"


def test_centres_answer_as_the_scenes_do_and_more_of_them_better(digits):
    one, some, whole = (
        evaluate(learn(digits, **settings(count)), digits, PHOTONS, draws=3)[0].accuracy
        for count in (1, 20, None)
    )
    spread = np.sqrt(0.5 / len(digits.y_test))  # images as the trials, of two tests
    assert some > whole - 3 * spread
    assert some > one - spread
    assert one > 0.1 + 5 * np.sqrt(0.09 / len(digits.y_test))


@pytest.mark.parametrize(("clusters", "words"), [(0, "clusters"), (1000, "give at most [0-9]+")])
def test_centres_are_fewer_than_half_of_the_scenes_of_a_class(digits, clusters, words):
    with pytest.raises(InputError, match=words) as error:
        learn(digits, **settings(clusters))
    assert "\n" not in str(error.value)


def test_a_design_of_known_masks_has_no_clusters(digits):
    with pytest.raises(InputError, match="`clusters` are of adaptive masks"):
        learn(digits, masks=4, photons=PHOTONS, training={"clusters": 3})
    assert Job(masks=4, photons=PHOTONS).training.clusters is None


def test_light_and_misfit_are_measured_with_scenes_of_all_classes(digits):
    """With more scenes than there are centres."""
    design = learn(digits, **settings(4))
    [found] = evaluate(design, digits, PHOTONS, draws=1)
    assert found.counts / PHOTONS == pytest.approx(float(design.shares.sum()), rel=0.1)
    assert design.prior_exposure.usual_misfit is not None

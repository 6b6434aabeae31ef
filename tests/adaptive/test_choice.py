"""Adaptive masks: the posterior is Poisson's law, and the next mask is what tells most."""

import numpy as np
import pytest
import torch
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, poisson

from deepfsi import Design, Result, evaluate, learn
from deepfsi.adaptive import choice, posterior
from deepfsi.adaptive.exposure import AdaptiveExposure, prior_of
from deepfsi.adaptive.posterior import AdaptivePosterior, ScenePrior
from deepfsi.base.errors import InputError
from deepfsi.camera.camera import Camera
from deepfsi.datasets.arrays import from_arrays
from deepfsi.datasets.dataset import Dataset
from deepfsi.jobs.exposures import AdaptiveMasks

PIXELS, SCENES, CLASSES = 8, 40, 3
QUARTERS = torch.arange(PIXELS) // 2
SHARES = np.array([0.05, 0.1, 0.1, 0.15, 0.2, 0.4])
MASKS = (np.random.default_rng(1).random((6, PIXELS)) < 0.5).astype(float)
"""Masks of six looks, and their shares of the exposure."""


def tried(data: Dataset, photons, camera="dmd", draws=1, **settings) -> Result:
    """Accuracy of adaptive masks on the test scenes of data."""
    chosen = AdaptiveMasks(**settings)
    prior = prior_of(data, chosen)
    shares = torch.zeros(chosen.looks)
    exposure = AdaptiveExposure(prior, chosen, data.image_shape, shares, Camera())
    design = Design("adaptive", data.classes, exposure)
    return evaluate(design, data, photons, camera=camera, draws=draws)[0]


def small(seed: int = 0):
    """Scenes (n, N) of classes (n,), about a pattern of each class."""
    rng = np.random.default_rng(seed)
    labels = rng.permutation(np.arange(SCENES) % CLASSES)
    x = 0.3 + 0.5 * rng.random((CLASSES, PIXELS))[labels] + 0.2 * rng.random((SCENES, PIXELS))
    return x.astype(np.float32), labels


def state_of(x, labels, photons, spread=0.0, **optics) -> AdaptivePosterior:
    prior = ScenePrior(x, labels, CLASSES, spread=spread)
    return AdaptivePosterior(prior, 20, posterior.LookOptics(photons, **optics))


def readouts(masks, arms=1, detectors=None) -> np.ndarray:
    """Pixels that each readout sees (looks, Q, N), by hand."""
    rails = np.stack([masks, 1 - masks] if arms == 2 else [masks], axis=1)
    if detectors is None:
        return rails
    areas = [(detectors.numpy() == d).astype(float) for d in range(int(detectors.max()) + 1)]
    return np.stack([rail * area for rail in rails.swapaxes(0, 1) for area in areas], axis=1)


def expected(x, seen, photons, dark=0.0) -> np.ndarray:
    """Counts (n, looks, Q) behind readouts (looks, Q, N), in float64."""
    light = np.einsum("kqj,nj->nkq", seen, x.astype(float)) * photons / x.sum(axis=1).mean()
    return (light + dark) * SHARES[:, None]


def told(state, counts) -> AdaptivePosterior:
    """State after looks that show the masks and count (b, looks, Q)."""
    for mask, count, share in zip(MASKS, counts.swapaxes(0, 1), SHARES, strict=True):
        row = torch.from_numpy(mask).float().expand(len(state), -1)
        state.update(row, torch.from_numpy(count).float(), share)
    return state


def by_hand(logs, labels):
    each = np.stack([logsumexp(logs[:, labels == k], axis=1) for k in range(CLASSES)], axis=1)
    return np.exp(each - logsumexp(each, axis=1)[:, None])


@pytest.mark.parametrize("photons", [1.0, 1e2, 1e4, 1e7])
@pytest.mark.parametrize("dark", [0.0, 30.0])
@pytest.mark.parametrize("arms", [1, 2])
@pytest.mark.parametrize("detectors", [None, QUARTERS], ids=["one", "four"])
def test_the_posterior_is_that_of_the_poisson_law(photons, dark, arms, detectors):
    (x, labels), rng = small(), np.random.default_rng(1)
    mean = expected(x, readouts(MASKS, arms, detectors), photons, dark)
    counts = rng.poisson(mean[:20])
    state = state_of(x, labels, photons, dark=dark, arms=arms, detectors=detectors)
    found = told(state, counts).probabilities
    with np.errstate(invalid="ignore"):
        each = np.where(mean > 0, poisson.logpmf(counts[:, None], mean), 0.0)
    np.testing.assert_allclose(found, by_hand(each.sum(axis=(2, 3)), labels), atol=2e-3)


@pytest.mark.parametrize("spread", [0.3, 1.0])
def test_scenes_near_those_of_the_prior_are_as_likely_as_their_normal_law_says(spread):
    """At so many photons counts are normal, and all looks at once have one covariance."""
    (x, labels), rng, photons = small(), np.random.default_rng(1), 3e5
    state = state_of(x, labels, photons, spread=spread)
    parts = state.prior.components.double().numpy()
    near = parts.T @ parts
    mean = expected(x, readouts(MASKS), photons)[..., 0]
    lit = photons / x.sum(axis=1).mean() * SHARES[:, None] * MASKS
    whole = lit @ near @ lit.T
    errors = rng.multivariate_normal(np.zeros(6), whole, 20)
    counts = rng.poisson(np.clip(mean[:20] + errors, 0, None))
    found = told(state, counts[..., None])
    logs = np.zeros((20, SCENES))
    for k, centre in enumerate(mean):
        law = multivariate_normal(centre, whole + np.diag(mean.mean(axis=0)))
        logs[:, k] = law.logpdf(counts)
    np.testing.assert_allclose(found.probabilities, by_hand(logs, labels), atol=0.05)
    # mean scene: least squares of all looks at once, about each scene of the prior
    weights = np.exp(logs - logsumexp(logs, axis=1)[:, None])
    kept = near @ lit.T @ np.linalg.inv(whole + np.diag(mean.mean(axis=0)))
    exact = weights @ x + (counts - weights @ mean) @ kept.T
    wrong = np.abs(found.scene.numpy() - exact)
    assert wrong.mean() < 0.003
    assert wrong.max() < 0.04
    assert np.abs(weights @ x - exact).mean() > 0.005, "what counts tell beyond the prior's scenes"


@pytest.mark.parametrize("arms", [1, 2])
def test_the_brightest_mask_is_nearly_the_best_of_all(arms):
    """Of all 255 masks: the largest squared difference over its photons."""
    rng = np.random.default_rng(2)
    differ, scene = rng.normal(size=(50, PIXELS)), rng.random((50, PIXELS)) + 0.1
    differ[:, 0] = abs(differ[:, 0])  # else the best mask may be all OFF
    # but for all ON, which has no other arm
    masks = (np.arange(1, 2**PIXELS - 1)[:, None] >> np.arange(PIXELS) & 1).astype(np.float32)

    def worth(shown):
        signal, noise = differ @ shown.T, scene @ shown.T
        return np.where((signal > 0) | (arms == 2), signal**2 / noise, 0)

    def of_arms(shown):
        return worth(shown) + (worth(1 - shown) if arms == 2 else 0)

    every, lit = of_arms(masks), torch.ones(1, PIXELS).double()
    found = choice.difference_masks(torch.from_numpy(differ), torch.from_numpy(scene), lit, arms)
    mine = np.diag(of_arms(found.numpy()))
    worst, mean = (0.5, 0.95) if arms == 1 else (0.2, 0.85)  # local maxima of two arms
    assert (mine > worst * every.max(axis=1)).all()
    assert (mine / every.max(axis=1)).mean() > mean


@pytest.mark.parametrize("light", ["free-dwell", "two-arm"])
def test_photons_are_conserved(light):
    """Both arms count all photons, one no more than its open mirrors; dark counts are no light."""
    x, labels = small(6)
    data = from_arrays(x, labels, x, labels)
    camera = {"light": light, "dark": 30.0}
    found = tried(data, 500.0, camera=camera, looks=4, draws=2)
    if light == "two-arm":
        assert found.counts == pytest.approx(500.0, rel=1e-4)
    else:
        assert 50 < found.counts < 450


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        *(({"looks": bad}, "looks") for bad in (0, True)),
        *(({name: 0}, name) for name in ("components", "until", "growth")),
        ({"spread": float("nan")}, "spread"),
        ({"camera": "paper"}, "not column"),
        ({"camera": {"noise": "camera", "sigma": 2.0}}, "photon counts"),
        ({"camera": {"light": "free-dwell", "fluctuation": 0.1}}, "steady light"),
    ],
)
def test_what_cannot_be_is_refused(digits, settings, match):
    with pytest.raises(InputError, match=match):
        tried(digits, 1e4, **settings)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"masks": 65}, "1 to 64"),
        ({"camera": Camera(device="dlp7000", exposure="1ms"), "masks": 50}, "give at most [0-9]+ "),
    ],
)
def test_more_looks_than_there_can_be_are_refused(digits, settings, words):
    with pytest.raises(InputError, match=words):
        learn(digits, **({"design": "adaptive", "masks": 6, "photons": 1e4} | settings))

"""Adaptive masks: the posterior is Poisson's law, and the next mask is what tells most."""

import numpy as np
import pytest
import torch
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, nbinom, poisson

from deepfsi import Camera, Dataset, Design, InputError, Result, evaluate, from_arrays, learn
from deepfsi.adaptive import choice, posterior
from deepfsi.adaptive.exposure import AdaptiveExposure, prior_of
from deepfsi.adaptive.posterior import AdaptivePosterior, ScenePrior
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


@pytest.mark.parametrize("readouts", [1, 3])
@pytest.mark.parametrize("near", [False, True])
def test_information_is_that_of_normal_laws_with_equal_noise(readouts, near):
    """Half the logarithm of the variance of all over that within classes, with photon noise 1."""
    rng = np.random.default_rng(1)
    counts = rng.gamma(2.0, 30.0, (2, 4, readouts, SCENES))
    weights = rng.dirichlet(np.ones(SCENES), 2)
    labels = np.arange(SCENES) % CLASSES
    members = weights[..., None] * np.eye(CLASSES + 1)[labels]  # one class has no scene
    roots = rng.normal(size=(2, 4, readouts, readouts))
    noise = np.eye(readouts) + near * roots @ roots.swapaxes(2, 3)
    given = [torch.from_numpy(each) for each in (counts, members, noise - np.eye(readouts))]
    found = choice.information(*given[:2], given[2] if near else None)
    for (row, mask), one in np.ndenumerate(found.numpy()):
        scale, weight = 2 * np.sqrt(counts[row, mask] + 3 / 8), weights[row]
        total = np.cov(scale, aweights=weight, ddof=0)
        within = sum(
            weight[labels == k].sum() * np.cov(scale[:, labels == k], aweights=weight[labels == k],
                                               ddof=0) for k in range(CLASSES)
        )  # fmt: skip
        every, apart = (np.atleast_2d(each) + noise[row, mask] for each in (total, within))
        gain = np.log(np.linalg.det(every) / np.linalg.det(apart)) / 2
        assert one == pytest.approx(gain, rel=1e-6)


def test_scenes_are_drawn_as_often_as_their_weights_say():
    """To less than one, of 50 at equal steps; all are taken where there are no more."""
    weights = torch.from_numpy(np.random.default_rng(0).dirichlet(np.ones(200) / 3, 300))
    indices, shares = choice.draw_scenes(weights, torch.Generator().manual_seed(0), 50)
    often = torch.stack([torch.bincount(row, minlength=200) for row in indices])
    assert ((often - 50 * weights).abs() < 1 + 1e-6).all()
    assert (often - 50 * weights).mean(dim=0).abs().max() < 5 * 0.5 / 300**0.5
    assert (shares == 1 / 50).all()
    indices, shares = choice.draw_scenes(weights[:, :50], torch.Generator(), 50)
    assert torch.equal(indices, torch.arange(50).expand(300, -1))
    assert torch.equal(shares, weights[:, :50])


@pytest.mark.parametrize("arms", [1, 2])
def test_the_mask_of_each_detector_is_that_of_its_pixels_alone(arms):
    rng = np.random.default_rng(3)
    differ, scene = (
        torch.from_numpy(rng.normal(size=(50, 16))),
        torch.from_numpy(rng.random((50, 16))),
    )
    areas = torch.eye(2).double().repeat_interleave(8, dim=1)
    whole = choice.difference_masks(differ, scene, areas, arms)
    parts = [
        choice.difference_masks(differ[:, part], scene[:, part], torch.ones(1, 8).double(), arms)
        for part in (slice(8), slice(8, None))
    ]
    assert torch.equal(whole, torch.cat(parts, dim=1))
    assert torch.equal(whole, choice.difference_masks(differ, 1e-6 * scene, areas, arms))


@pytest.mark.parametrize("arms", [1, 2])
def test_groups_of_the_likeliest_classes_differ_by_their_mean_scenes(arms):
    """Each pair of groups of three classes once; on one arm either of them is the brighter one."""
    x, labels = small()
    state = state_of(x, labels, 300.0, arms=arms)
    rng = np.random.default_rng(1)
    told(state, rng.poisson(expected(x, readouts(MASKS, arms), 300.0)[:20]))
    weights, own = state.weights.double().numpy(), labels[state.prior.order]
    scenes = x[state.prior.order].astype(float)
    found = state.group_differences().numpy()
    assert found.shape[1] == 3 * (3 - arms)
    for row in range(20):
        chances = np.array([weights[row, own == k].sum() for k in range(CLASSES)])
        mean = [weights[row, own == k] @ scenes[own == k] for k in range(CLASSES)]
        for alone in range(CLASSES):
            others = [k for k in range(CLASSES) if k != alone]
            rest = sum(mean[k] for k in others) / chances[others].sum()
            differ = mean[alone] / chances[alone] - rest
            off = np.abs(found[row][:, None] - [differ, -differ]).max(axis=2)
            if chances[alone] > 1e-4 and chances[others].sum() > 1e-4:
                assert (off < 2e-3).sum() == 3 - arms
    x, labels = rng.random((60, PIXELS), np.float32), np.arange(60) % 6
    six = AdaptivePosterior(ScenePrior(x, labels, 6), 1, posterior.LookOptics(1e9, arms=arms))
    mask, seen = torch.ones(1, PIXELS), torch.from_numpy(x[:1])
    six.update(mask, six.expected(mask, seen, 1.0), 1.0)
    assert (six.class_probabilities > 0).sum() < 4, "some are excluded"
    assert six.group_differences().shape[1] == 7 * (3 - arms), "of four classes"
    assert six.group_differences().isfinite().all()


@pytest.mark.parametrize("optics", [{}, {"dark": 40.0}, {"arms": 2}, {"detectors": QUARTERS}])
@pytest.mark.parametrize("spread", [0.0, 0.6])
def test_the_next_mask_is_the_candidate_whose_counts_tell_most(optics, spread):
    """Of all scenes, and the covariance of the roots of their counts by scenes near them."""
    x, labels = small()
    state = state_of(x, labels, 100.0, spread, **optics)
    if not spread:
        mean = expected(x, readouts(MASKS, optics.get("arms", 1), optics.get("detectors")), 100.0)
        told(state, np.random.default_rng(1).poisson(mean[:20]))
    share, prior, masks = 0.2, state.prior, state.candidates()
    gain, seen = 100.0 / prior.summed_reflectance * share, state.optics.readouts(masks).double()
    dark = optics.get("dark", 0.0) * share
    counts = gain * seen @ torch.from_numpy(x[prior.order]).double().T + dark
    weights = state.weights.double()
    members = torch.nn.functional.one_hot(prior.labels, CLASSES) * weights[..., None]
    parts = seen @ prior.components.double().T * bool(spread)
    steps = (counts * weights[:, None, None]).sum(dim=-1, keepdim=True)
    steps = gain * parts * steps.clamp(min=1e-6).rsqrt()
    told_by = choice.information(counts, members, steps @ steps.transpose(2, 3))
    found = state.next_masks(share, torch.Generator())
    which = (masks == found[:, None]).all(dim=2)
    chosen = told_by.masked_fill(~which, -1).amax(dim=1)
    assert (chosen > told_by.amax(dim=1) * (1 - 1e-3)).all()


@pytest.mark.parametrize("photons", [3.0, 300.0])
def test_one_look_at_scenes_near_those_of_the_prior_has_a_negative_binomial_law(photons):
    """Of the variance that scenes near the mean one give the light, at any light."""
    x, labels = small()
    state = state_of(x, labels, photons, 0.8, dark=2.0)
    prior, gain = state.prior, photons / state.prior.summed_reflectance
    counts = torch.arange(20.0)[:, None]
    masks = torch.from_numpy(MASKS[:1]).float().expand(20, -1)
    state.update(masks, counts, 0.5)
    mean = (x[prior.order].astype(float) @ MASKS[0] * gain + 2.0) * 0.5
    variance = float((prior.components.double() @ torch.from_numpy(MASKS[0])).square().sum())
    usual = mean.mean()
    size = usual**2 / (variance * (gain * 0.5) ** 2)
    logs = nbinom.logpmf(counts.numpy(), size, size / (size + mean))
    exact = np.exp(logs - logsumexp(logs, axis=1, keepdims=True))
    np.testing.assert_allclose(state.weights, exact, rtol=2e-3)
    kept = state.rows_of(torch.arange(20) % 7 == 2)
    torch.testing.assert_close(kept.scene, state.scene[[2, 9, 16]])
    torch.testing.assert_close(kept.class_probabilities, state.class_probabilities[[2, 9, 16]])

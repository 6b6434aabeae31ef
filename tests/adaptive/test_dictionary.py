"""Laws of masks of a dictionary: tables are the posterior, and the choice is that of made masks."""

import numpy as np
import pytest
import torch
from scipy.special import logsumexp
from scipy.stats import poisson

import deepfsi
from conftest import generator
from deepfsi import Design, InputError
from deepfsi.adaptive import dictionary as tables
from deepfsi.adaptive import posterior
from deepfsi.adaptive.dictionary import MaskDictionary
from deepfsi.adaptive.posterior import AdaptivePosterior, ScenePrior
from deepfsi.evaluation import page_data
from deepfsi.physics.noise import Poisson
from shared.design_files import assert_refused, looks_at

PIXELS, SCENES, CLASSES, LOOKS, PHOTONS = 12, 60, 3, 6, 300.0
SHARE = 1 / LOOKS
RANDOM = np.random.default_rng(4)
LABELS = np.arange(SCENES) % CLASSES
X = 0.1 + 0.5 * RANDOM.random((CLASSES, PIXELS))[LABELS] + 0.4 * RANDOM.random((SCENES, PIXELS))
X = X.astype(np.float32)
EVERY = MaskDictionary.drawn(
    (torch.rand(64, PIXELS, generator=generator(1)) < 0.5), 40, generator(2)
)


def prior_with(spread=0.0) -> ScenePrior:
    return ScenePrior(X, LABELS, CLASSES, PIXELS, spread=spread)


def state_of(prior, dictionary=EVERY, exposures=5, **optics):
    look = posterior.LookOptics(PHOTONS, **optics)
    return tables.DictionaryPosterior(dictionary, prior, exposures, look, share=SHARE)


def exposed(state, looks=LOOKS, seed=3):
    """Masks (looks, b, N) and counts (looks, b) of exposures of the first scenes."""
    random, masks, counts = generator(seed), [], []
    for _ in range(looks):
        look = state.look_at(torch.from_numpy(X[: len(state)]), SHARE, random)
        state.update(look.masks, look.counts, SHARE)
        masks.append(look.masks)
        counts.append(look.counts[:, 0])
    return torch.stack(masks), torch.stack(counts)


@pytest.mark.parametrize("dark", [0.0, 60.0])
def test_tables_give_the_exact_posterior_of_scenes_that_are_known(dark):
    """Poisson's law of all looks, of each scene; the odds of classes are sums of it."""
    prior = prior_with()
    state = state_of(prior, dark=dark)
    masks, counts = exposed(state)
    scenes = X[prior.order].astype(float)
    gain = PHOTONS / float(prior.summed_reflectance) * SHARE
    light = np.einsum("kbn,sn->kbs", masks.numpy(), scenes) * gain + dark * SHARE
    logs = poisson.logpmf(counts.numpy()[..., None], light).sum(axis=0)
    exact = np.exp(logs - logsumexp(logs, axis=1, keepdims=True))
    np.testing.assert_allclose(state.weights.numpy(), exact, atol=2e-4)
    assert exact.max() > 2 / SCENES  # the counts told something


def test_one_look_tells_what_it_tells_of_masks_that_are_made():
    """To a power: what a look says of scenes near those of the prior is lost for the next looks."""
    prior = prior_with(spread=0.7)
    state = state_of(prior)
    made = AdaptivePosterior(prior, len(state), posterior.LookOptics(PHOTONS))
    masks = EVERY.masks[: len(state)]
    counts = Poisson().draw(made.expected(masks, torch.from_numpy(X[:5]), SHARE), generator(5))
    for each in (state, made):
        each.update(masks, counts, SHARE)
    expected = (made.log_weights * tables.POWER).softmax(dim=1)
    torch.testing.assert_close(state.weights, expected, atol=1e-4, rtol=1e-3)
    assert state.weights.amax() > 1.8**tables.POWER / SCENES


@pytest.mark.parametrize("spread", [0.0, 0.7])
def test_masks_are_compared_by_the_variance_of_roots_between_classes_over_that_within(
    spread, monkeypatch
):
    """Of all scenes by their weights, with photon noise 1 and that of scenes near them."""
    monkeypatch.setattr(tables, "COMPARED_SCENES", (SCENES, SCENES))
    prior = prior_with(spread)
    many = MaskDictionary.drawn(
        torch.rand(3000, PIXELS, generator=generator(1)) < 0.5, 1100, generator(2)
    )
    state = state_of(prior, many, exposures=1, dark=60.0)
    assert [len(part) for part in state.tables.parts] == [550, 550]
    weights = RANDOM.dirichlet(np.repeat([1, 1, 0.1], SCENES // CLASSES))
    state.log_weights.copy_(torch.from_numpy(np.log(weights))[None] - 3)
    shown, labels = many.masks.double().numpy(), prior.labels.numpy()
    gain = PHOTONS / float(prior.summed_reflectance) * SHARE
    light = shown @ X[prior.order].T * gain + 60.0 * SHARE  # (P, n)
    roots = 2 * np.sqrt(light + 3 / 8)
    near = (shown @ prior.components.double().numpy().T) ** 2 * bool(spread)
    noise = 1 + near.sum(axis=1) * gain**2 / light.mean(axis=1)
    classes = [(weights[labels == k].sum(), roots[:, labels == k], weights[labels == k])
               for k in range(CLASSES)]  # fmt: skip
    means = np.stack([own @ part / share for share, own, part in classes])
    within = sum(own**2 @ part - share * mean**2
                 for (share, own, part), mean in zip(classes, means, strict=True))  # fmt: skip
    shares = np.array([share for share, *_ in classes])
    between = shares @ (means - shares @ means) ** 2
    wanted = between / (within + noise)
    for look in range(3):
        part = state.tables.parts[look % 2]
        found = state._odds(state.log_weights[0].numpy(), look % 2)
        np.testing.assert_allclose(found, wanted[part], rtol=2e-3, atol=1e-6)
        best = state.next_masks(SHARE, generator())[0]
        assert torch.equal(best, many.masks[part[found.argmax()]])
        state.update(best[None], torch.zeros(1, 1), SHARE)
        state.log_weights.copy_(torch.from_numpy(np.log(weights))[None])
    excluded = np.where(labels == 0, -1e4, 0).astype(np.float32)
    assert np.isfinite(state._odds(excluded, 0)).all()


def test_scenes_are_compared_as_often_as_they_are_likely():
    """Sixteen at equal steps, each to less than one; over looks in the mean, to a hundredth."""
    state = state_of(prior_with())
    weights = RANDOM.dirichlet(np.ones(SCENES) / 2)
    often = []
    for state._looks in range(400):
        state._odds(np.log(weights).astype(np.float32), 0)
        often.append(np.bincount(state._draw(), minlength=SCENES))
    assert (np.abs(often - 16 * weights) < 1.001).all()
    np.testing.assert_allclose(np.mean(often, axis=0), 16 * weights, atol=0.01)
    one = MaskDictionary(torch.ones(1, 2))
    for scenes, drawn in ((30_599, 16), (30_600, 17), (60_000, 32)):
        x, labels = RANDOM.random((scenes, 2), np.float32), np.arange(scenes) % CLASSES
        assert len(state_of(ScenePrior(x, labels, CLASSES), one, 1)._draw()) == drawn


@pytest.fixture(scope="module")
def ready(digits):
    settings = {"design": "adaptive", "masks": 12, "photons": 1e3}
    return deepfsi.learn(digits, **settings, training={"dictionary": 300})


def test_a_file_gives_the_same_choices(ready, digits, tmp_path):
    """Of the coefficients of 8 bits that the file has: the first mask is that before, too."""
    ready.save(tmp_path / "a.safetensors")
    again = Design.load(tmp_path / "a.safetensors")
    again.save(tmp_path / "b.safetensors")
    once = Design.load(tmp_path / "b.safetensors")
    looks = [looks_at(each, digits.x_test[0], 1e3) for each in (ready, again, once)]
    assert np.array_equal(looks[0][0][0], looks[1][0][0])
    for one, other in zip(looks[1], looks[2], strict=True):
        np.testing.assert_array_equal(one, other)
    masks = ready.prior_exposure.dictionary.masks
    assert torch.equal(masks, again.prior_exposure.dictionary.masks)
    assert len(masks) == len(masks.unique(dim=0)) == 300
    assert set(masks.unique().tolist()) == {0, 1}


def test_damaged_dictionaries_and_pages_with_one_are_refused(ready, tmp_path):
    def cut(header, arrays):
        arrays["dictionary"] = arrays["dictionary"][:, :-1].contiguous()

    def lost(header, arrays):
        del arrays["dictionary"]

    def unasked(header, arrays):
        del header["settings"]["dictionary"]

    for change in (cut, lost, unasked):
        assert_refused(ready, tmp_path, change)
    with pytest.raises(InputError, match="a page makes its masks"):
        page_data.check_playable(ready)


def test_a_dictionary_is_of_adaptive_masks_and_one_detector(digits):
    for settings, words in (
        ({"design": "pca"}, "no use for `dictionary`"),
        ({"design": "adaptive", "camera": "dmd-2x2"}, "one detector and one arm"),
    ):
        with pytest.raises(InputError, match=words):
            deepfsi.learn(digits, **settings, masks=4, photons=1e3, training={"dictionary": 10})
    for optics in ({"arms": 2}, {"detectors": torch.zeros(X.shape[1], dtype=torch.long)}):
        with pytest.raises(InputError, match="one detector and one arm"):
            state_of(prior_with(), **optics)

"""Laws of masks of a dictionary: tables are the posterior, and the choice is that of made masks."""

import numpy as np
import pytest
import torch
from scipy.special import logsumexp
from scipy.stats import poisson

import deepfsi
from conftest import generator
from deepfsi import Design
from deepfsi.adaptive import choice, posterior
from deepfsi.adaptive import dictionary as tables
from deepfsi.adaptive.dictionary import MaskDictionary
from deepfsi.adaptive.posterior import AdaptivePosterior, ScenePrior
from deepfsi.base.errors import InputError
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
def test_a_dictionary_that_holds_the_mask_that_would_be_made_gives_it(spread, monkeypatch):
    """After no look, and where scenes are known after every look: the information is the same."""
    monkeypatch.setattr(tables, "COMPARED_SCENES", (SCENES, SCENES))
    prior = prior_with(spread)
    made = AdaptivePosterior(prior, 5, posterior.LookOptics(PHOTONS))
    random = generator(6)
    for look in range(1 if spread else LOOKS):
        every = made.candidates().flatten(0, 1)
        dictionary = MaskDictionary.drawn(torch.cat([every]), len(every), random)
        state = state_of(prior, dictionary)
        state.log_weights.copy_(made.log_weights)
        best = made.next_masks(SHARE, random)
        chosen = state.next_masks(SHARE, random)
        gains = [scored(made, torch.stack([a, b])) for a, b in zip(best, chosen, strict=True)]
        for row, (own, other) in enumerate(gains):
            assert other[row] > own[row] - 1e-4
        if look == 0:
            assert torch.equal(best, chosen)
        counts = Poisson().draw(made.expected(best, torch.from_numpy(X[:5]), SHARE), random)
        made.update(best, counts, SHARE)


def scored(state, masks):
    """Information (M, b) of the counts behind masks (M, N), all scenes compared."""
    prior = state.prior
    mean, parts = prior.light(masks)
    light = mean[:, None] + parts @ prior.coefficients.T
    counts = (light.clamp(min=0) * (state.gain * SHARE))[None, :, None]
    members = torch.nn.functional.one_hot(prior.labels, CLASSES) * state.weights[..., None]
    usual = (counts * state.weights[:, None, None]).sum(dim=-1, keepdim=True)
    nearby = (parts.square().sum(dim=1) * bool(prior.spread))[None, :, None, None]
    unknown = nearby * (state.gain * SHARE) ** 2 / usual
    return choice.information(counts.expand(len(state), -1, -1, -1), members, unknown).T


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


def test_damaged_dictionaries_are_refused(ready, tmp_path):
    def cut(header, arrays):
        arrays["dictionary"] = arrays["dictionary"][:, :-1].contiguous()

    def lost(header, arrays):
        del arrays["dictionary"]

    def unasked(header, arrays):
        del header["settings"]["dictionary"]

    for change in (cut, lost, unasked):
        assert_refused(ready, tmp_path, change)


def test_a_page_has_no_dictionary(ready, digits):
    with pytest.raises(InputError, match="a page makes its masks"):
        page_data.check_playable(ready)


def test_a_dictionary_is_of_adaptive_masks_and_one_detector(digits):
    for settings, words in (
        ({"design": "pca"}, "no use for `dictionary`"),
        ({"design": "adaptive", "camera": "dmd-2x2"}, "one detector and one arm"),
    ):
        with pytest.raises(InputError, match=words):
            deepfsi.learn(digits, **settings, masks=4, photons=1e3, training={"dictionary": 10})

"""Laws of light that is shared among exposures: the budget is their mean, and none takes more."""

from dataclasses import replace

import numpy as np
import pytest

import deepfsi
from deepfsi import InputError, evaluate
from deepfsi.adaptive.exposure import AdaptiveExposure, sharing_threshold

PHOTONS, DRAWS, SHARING_SCENES = 1e3, 2, 256


@pytest.fixture(scope="module")
def shared(digits):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deepfsi.adaptive.exposure.SHARING_SCENES", SHARING_SCENES)
        words = {"design": "adaptive", "masks": 16, "exposure": {"cap": 2}}
        return deepfsi.learn(digits, photons=PHOTONS, **words)


@pytest.fixture(scope="module")
def tested(digits, shared):
    [result] = evaluate(shared, digits, PHOTONS, draws=DRAWS)
    return result


def confidences(seed, exposures=500, stops=12):
    rng = np.random.default_rng(seed)
    return rng.random((exposures, stops)) ** (1 / np.arange(1, stops + 1))


@pytest.mark.parametrize("seed", range(2))
def test_the_threshold_takes_the_light_asked_for_and_rises_with_it(seed):
    seen = confidences(seed)
    used = np.cumsum(np.full(12, 1 / 6))  # 2 together
    found = [sharing_threshold(used, seen, light) for light in np.linspace(0.2, 2, 10)]
    for threshold, light in zip(found, np.linspace(0.2, 2, 10), strict=True):
        ends = np.argmax(np.c_[seen[:, :-1] > threshold, np.ones(len(seen))], axis=1)
        taken = used[ends].mean()
        assert light - used[-1] / len(seen) < taken <= light + 1e-12  # one exposure apart
    assert found == sorted(found)


def test_test_scenes_take_the_budget_in_the_mean_and_at_most_the_cap(digits, shared, tested):
    """Light of an exposure lies within (1/8, 2), so that its deviation is 0.94 at most.

    The threshold is of few training scenes, and the mean of the tests has a deviation, too.
    """
    error = 0.94 * (1 / len(digits.x_test) + 1 / SHARING_SCENES) ** 0.5
    assert tested.score("mean_light") == pytest.approx(1, abs=4 * error)
    assert sum(shared.exposure.settings.shares) == pytest.approx(2)


def test_a_file_and_a_camera_know_the_rule(shared, tmp_path):
    path = tmp_path / "shared.safetensors"
    shared.save(path)
    again = deepfsi.load_design(path)
    assert isinstance(again.exposure, AdaptiveExposure)
    assert again.exposure.settings == shared.exposure.settings
    assert again.info["stopping"] == {
        "threshold": shared.exposure.settings.until,
        "photons": PHOTONS,
    }


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"design": "deepfsi"}, "is of exposures that may end early"),
        ({"exposure": {"cap": 9}}, "the first of 8 looks takes 1.12 of the budget"),
    ],
)
def test_what_cannot_share_is_one_line(digits, settings, words):
    asked = {"design": "adaptive", "masks": 8, "photons": PHOTONS, "exposure": {"cap": 2}}
    with pytest.raises(InputError, match=words) as refused:
        deepfsi.learn(digits, **asked | settings)
    assert "\n" not in str(refused.value)


def test_few_scenes_say_too_little_of_the_mean(digits):
    few = replace(digits, x_train=digits.x_train[:40], y_train=digits.y_train[:40])
    with pytest.raises(InputError, match="40 training scenes say too little"):
        deepfsi.learn(few, design="adaptive", masks=8, photons=PHOTONS, exposure={"cap": 2})

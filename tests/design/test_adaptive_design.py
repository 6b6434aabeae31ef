"""Laws of designs of adaptive masks: damaged files, tests, and what refuses them."""

from dataclasses import replace

import pytest

from deepfsi import Camera, evaluate, learn
from deepfsi.base.errors import InputError

LOOKS, PHOTONS, HELD_OUT = 6, 1e4, 200


@pytest.fixture(scope="module")
def few(digits):
    test = {"x_test": digits.x_test[:60], "y_test": digits.y_test[:60]}
    return replace(digits, x_train=digits.x_train[:600], y_train=digits.y_train[:600], **test)


@pytest.fixture(scope="module")
def adaptive(few):
    return learn(few.hold_out(HELD_OUT), design="adaptive", masks=LOOKS, photons=PHOTONS)


def test_answers_are_good_and_better_with_more_light(adaptive, few):
    dim, bright = evaluate(adaptive, few, [1e2, 1e4], draws=2)
    assert dim.accuracy + 0.2 < bright.accuracy
    assert bright.accuracy > 0.8


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"camera": "paper"}, "one device, not column"),
        ({"camera": Camera(noise="gaussian", sigma=2.0)}, "photon counts"),
        ({"masks": 65}, "1 to 64"),
        ({"camera": Camera(device="dlp7000", exposure="1ms"), "masks": 50}, "give at most [0-9]+ "),
    ],
)
def test_what_adaptive_masks_cannot_do_is_refused(few, settings, words):
    with pytest.raises(InputError, match=words):
        learn(few, **({"design": "adaptive", "masks": LOOKS, "photons": PHOTONS} | settings))

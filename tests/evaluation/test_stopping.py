"""Early stopping: the same photons, an honest choice, and what is saved."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from conftest import generator, quick
from deepfsi import evaluate
from deepfsi.base.errors import InputError
from deepfsi.evaluation.stopping import stop

HELD_OUT = 400
PHOTONS = 2e5
TRAINED = {
    "masks": 10, "nested": 2, "photons": PHOTONS, "epochs": 25, "hidden": (48,), "lr": 1e-2,
    "mask_lr": 0.1, "scale": "common", "rails": "single", "light": "free-dwell",
}  # fmt: skip


@pytest.fixture(scope="module")
def nested(digits):
    return quick(digits.hold_out(HELD_OUT), **TRAINED)


@pytest.fixture(scope="module")
def stopped(nested, digits):
    return stop(nested, digits, PHOTONS, held_out=HELD_OUT, draws=2)


@pytest.mark.parametrize(("light", "rails"), [("free-dwell", "dual"), ("equal-dwell", "single")])
def test_above_a_threshold_of_one_nothing_stops_and_accuracy_is_that_of_the_whole(
    digits, light, rails
):
    settings = {**TRAINED, "light": light, "rails": rails, "epochs": 2}
    design = quick(digits.hold_out(HELD_OUT), **settings)
    found = stop(design, digits, PHOTONS, held_out=HELD_OUT, threshold=1.0, draws=2, seed=4)
    [whole] = evaluate(design, digits, PHOTONS, draws=2, seed=4)
    assert found.stops[-1] == 1
    assert found.used.mean == pytest.approx(1)
    assert found.stopped == found.whole
    assert found.whole.mean == pytest.approx(whole.accuracy, abs=1e-12)
    assert (found.whole.low, found.whole.high) == pytest.approx((whole.low, whole.high))


def test_the_loop_at_the_camera_gives_what_the_study_says(nested, digits):
    """Counts of whole exposures, given to the rule mask by mask: nothing is drawn again."""
    found = stop(nested, digits, PHOTONS, held_out=HELD_OUT, threshold=0.9, draws=1, seed=7)
    scanner = nested.scanner()
    scenes = torch.from_numpy(digits.x_test) / nested.summed_reflectance
    counts = scanner.read(scanner.rates(scenes) * PHOTONS, generator(7))[:, 0].numpy()
    right, used, ends = [], [], []
    for exposure, label in zip(counts, digits.y_test, strict=True):
        for shown in found.rule.after:
            chances, enough = found.rule.classify(nested, exposure[:shown], PHOTONS)
            if enough:
                break
        right.append(chances.argmax() == label)
        used.append(nested.first(shown).exposure.used)
        ends.append(shown)
    assert np.mean(right) == pytest.approx(found.stopped.mean)
    assert np.mean(used) == pytest.approx(found.used.mean)
    for shown, share in zip(found.rule.after, found.stops, strict=True):
        assert np.mean(np.equal(ends, shown)) == pytest.approx(share)


def test_the_choice_does_not_look_at_the_test_scenes(nested, digits, stopped):
    rng = np.random.default_rng(0)
    labels = replace(digits, y_test=rng.permutation(digits.y_test))
    scenes = replace(digits, x_test=np.ascontiguousarray(digits.x_test[::-1]))
    for other in (labels, scenes):
        again = stop(nested, other, PHOTONS, held_out=HELD_OUT, draws=2)
        assert again.rule == stopped.rule
        assert again.validation == stopped.validation
    assert stop(nested, labels, PHOTONS, held_out=HELD_OUT).stopped.mean < 0.3
    assert stopped.validation["stopped"] >= stopped.validation["whole"]
    assert stopped.validation["used"] < 1


@pytest.mark.parametrize("share", [0.5, 0.7])
def test_a_mean_light_is_that_of_the_held_out_scenes_and_nearly_of_the_tests(nested, digits, share):
    """Shares of an exposure lie in (0, 1): their deviation is 0.5 at most, of both sets."""
    found = stop(nested, digits, PHOTONS, held_out=HELD_OUT, mean_light=share * PHOTONS, draws=2)
    error = 0.5 * (1 / HELD_OUT + 1 / len(digits.x_test)) ** 0.5
    assert share - 1 / HELD_OUT < found.validation["used"] <= share
    assert found.used.mean == pytest.approx(share, abs=4 * error)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"mean_light": 2 * PHOTONS}, "above 0 and at most that"),
        ({"mean_light": PHOTONS / 2, "threshold": 0.9}, "a threshold is given, or found"),
        ({"mean_light": PHOTONS * 1e-6}, "the first stop alone"),
    ],
    ids=["more than the whole", "and a threshold", "less than the first"],
)
def test_a_mean_light_that_cannot_be_is_one_line(nested, digits, settings, words):
    with pytest.raises(InputError, match=words):
        stop(nested, digits, PHOTONS, held_out=HELD_OUT, **settings)


def test_the_interval_of_the_light_used_is_normal_over_images(nested, digits):
    """One draw of each image: the stops are independent, and their shares give the spread."""
    found = stop(nested, digits, PHOTONS, held_out=HELD_OUT, threshold=0.9, draws=1)
    used = nested.exposure.stops.used
    shares, images = np.array(found.stops), len(digits.y_test)
    variance = (shares @ used**2 - (shares @ used) ** 2) * images / (images - 1)
    assert variance > 0
    assert found.used.high - found.used.low == pytest.approx(2 * 1.96 * (variance / images) ** 0.5)


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"held_out": 200}, "`hold_out=200`"),
        ({"threshold": 1.5}, "give 0 to 1"),
        ({"draws": 0}, "noise draws"),
    ],
)
def test_what_cannot_stop_is_refused(nested, digits, made, settings, match):
    with pytest.raises(InputError, match=match):
        stop(nested, digits, PHOTONS, **{"held_out": HELD_OUT, **settings})
    with pytest.raises(InputError, match="`nested`"):
        stop(made("deepfsi", "free-dwell", "single"), digits, PHOTONS, held_out=HELD_OUT)

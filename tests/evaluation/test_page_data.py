"""What a page to play with holds of a design, and which designs it cannot play."""

import base64
import zlib
from dataclasses import replace

import numpy as np
import pytest
import torch

from conftest import synthetic
from deepfsi import learn
from deepfsi.base import InputError
from deepfsi.evaluation import check_playable, playable
from deepfsi.exposure import ScenePrior
from deepfsi.exposure.patches import PatchExposure


def test_what_a_page_cannot_play_is_refused(made):
    good = made("deepfsi", "column", "dual")
    with pytest.raises(InputError, match="own in it: give a design with the package's own"):
        check_playable(replace(good, classifier=torch.nn.Linear(7, 10)))
    other = replace(
        good, info={"job": {"camera": {"light": "column", "noise": "shared.noises:photons"}}}
    )
    with pytest.raises(InputError, match=r"for shared\.noises:photons noise"):
        check_playable(other)
    read = {"light": "column", "noise": "camera", "dark": 5, "sigma": 2}
    noises = {
        "read noise of 2 counts": read,
        "for gaussian noise": {**read, "noise": "gaussian", "dark": 0},
    }
    for words, camera in noises.items():
        with pytest.raises(InputError, match=words):
            check_playable(replace(good, info={"job": {"camera": camera}}))
    check_playable(replace(good, info={"job": {"camera": {**read, "sigma": 0}}}))
    with pytest.raises(InputError, match="of image patches"):
        check_playable(replace(good, exposure=PatchExposure(4)))
    check_playable(good)


def test_a_design_that_does_not_say_what_it_was_learned_for(made, digits):
    """Nothing is marked then; a budget beyond the slider is not measured."""
    design = made("deepfsi", "column", "dual")
    unknown = playable(replace(design, info={}), digits)
    assert unknown["budget"] is None
    assert unknown["rules"] == []
    far = playable(
        replace(made("deepfsi", "column", "dual"), info={"job": {"photons": 1e8}}), digits
    )
    assert far["budget"] == {"low": 1e8, "high": 1e8}
    assert len(far["curve"]) == len(unknown["curve"]) == 13


def test_a_page_knows_scenes_of_each_class_by_lot():
    rng = np.random.default_rng(0)
    labels = np.repeat(np.arange(4), [1, 20, 300, 79])
    prior = ScenePrior(rng.random((400, 6)).astype(np.float32), labels, 4, spread=0.5)
    few, again, other = prior.few(100, 1), prior.few(100, 1), prior.few(100, 2)
    assert few.sizes == [1, 5, 75, 19]
    assert torch.equal(few.coefficients, again.coefficients)
    assert not torch.equal(few.coefficients, other.coefficients)
    assert torch.equal(few.mean, prior.mean)
    assert torch.equal(few.components, prior.components)
    assert (few.summed_reflectance, few.spread) == (prior.summed_reflectance, prior.spread)
    step = prior.coefficients.abs().amax(dim=0) / 127
    far = (few.coefficients[:, None] - prior.coefficients).abs()
    found = (far <= 0.501 * step).all(dim=2).nonzero()[:, 1]
    assert len(found) == 100  # each is one of them, and no other
    assert torch.equal(few.labels, prior.labels[found])
    assert prior.few(10**6).sizes == prior.sizes


def test_the_first_scene_is_nearest_to_its_class(digits):
    """Of scenes of two classes, all but one of them between the two."""
    x = np.full((40, 4), 0.5, np.float32)
    x[::2, :2], x[1::2, 2:] = 1.0, 1.0
    tests = 0.5 * x[:10] + 0.5 * x.mean(axis=0)
    tests[3] = np.maximum(x[3], 0.51)  # not one that was trained on
    data = replace(
        synthetic((2, 2), scenes=40, classes=2),
        x_train=x, y_train=np.arange(40) % 2, x_test=tests, y_test=np.arange(10) % 2,
    )  # fmt: skip
    held = playable(learn(data, design="adaptive", masks=2, photons=1e3), data)["scenes"]
    chosen = np.array(held["labels"])[held["clearest"]]
    assert chosen == 1
    packed = held["levels"]
    planes = np.frombuffer(zlib.decompress(base64.b64decode(packed["planes"])), np.uint8)
    levels = planes.reshape(2, -1).T.copy().view("<u2").reshape(packed["shape"])[held["clearest"]]
    scene = held["low"] + levels / 65535 * (held["high"] - held["low"])
    np.testing.assert_allclose(scene, tests[3], atol=1e-4)


def test_the_flattest_training_scene_is_the_one_of_the_least_spread(made, digits):
    """The page says where what is drawn is flatter than that."""
    held = playable(made("deepfsi", "column", "dual"), digits)["scenes"]
    spreads = [np.sqrt(((scene - scene.mean()) ** 2).mean()) for scene in digits.x_train]
    assert held["flattest"] == pytest.approx(min(spreads), rel=1e-5)

"""A design tells the scenes that it was trained on from others, in every test of it."""

from dataclasses import replace

import numpy as np
import pytest

import deepfsi
from deepfsi import load_dataset, load_design
from deepfsi.designfile.provenance import scene_hashes, was_trained_on
from shared.jobs import learn
from shared.pictures import save_images

DESIGNS = {
    "learned": {"masks": 4, "epochs": 1},
    "adaptive": {"masks": 2, "design": "adaptive", "light": "free-dwell"},
}


@pytest.fixture(scope="module", params=[None, (0.3, 1.0)], ids=["as they are", "dim black"])
def data(request, tmp_path_factory):
    """Pictures of one's own: 16 x 16 pixels of noise, brought to 8 x 8 by the data set."""
    rng, folder = np.random.default_rng(11), tmp_path_factory.mktemp("own") / "mine"
    for label in ("ash", "oak"):
        save_images(folder / label, rng.integers(0, 256, (30, 16, 16), np.uint8))
    return load_dataset(folder, size=8, rescale=request.param)


@pytest.fixture(scope="module", params=DESIGNS)
def design(request, data, tmp_path_factory):
    made = learn(data, photons=1e4, **DESIGNS[request.param])
    return load_design(made.save(tmp_path_factory.mktemp("design") / "one.safetensors"))


def test_exactly_the_training_scenes_are_known(design, data):
    known = [was_trained_on(design.training_scenes, scene_hashes(x, data.image_shape))
             for x in (data.x_train, data.x_test)]  # fmt: skip
    assert all(known[0])
    assert not any(known[1])


def test_a_new_scene_is_taken_for_one_of_n_at_the_stated_rate():
    """n / 2³² each: 7.5e4 new scenes and 7.5e4 that were trained on give 1.3 such in the mean."""
    scenes = np.random.default_rng(2).random((150_000, 9), np.float32)
    hashes = scene_hashes(scenes, (3, 3))
    known = np.unique(np.array([int(h, 16) for h in hashes[::2]], np.uint32).view(np.int32))
    mean = 75_000**2 / 2**32
    assert all(was_trained_on(known, hashes[::2]))
    assert sum(was_trained_on(known, hashes[1::2])) <= mean + 5 * mean**0.5
    bits = np.unpackbits(np.frombuffer(bytes.fromhex("".join(hashes)), np.uint8)).reshape(-1, 32)
    assert abs(bits.mean(axis=0) - 0.5).max() < 5 * 0.5 / 150_000**0.5


def test_scenes_that_were_trained_on_are_left_out_of_a_test(design, data):
    arrays = {"x": (data.x_train[:20], data.x_test), "y": (data.y_train[:20], data.y_test)}
    mixed = replace(data, **{f"{k}_test": np.concatenate(parts) for k, parts in arrays.items()})
    [result], [expected] = (deepfsi.evaluate(design, d, 1e4, draws=2) for d in (mixed, data))
    said = "20 of the 32 test scenes were trained on, and are left out"
    assert result == replace(expected, covers=f"{expected.covers}; {said}")
    own = replace(data, x_test=data.x_train, y_test=data.y_train)
    [result] = deepfsi.evaluate(design, own, 1e4, draws=1)
    assert result.images == len(data.x_train)
    assert result.covers.endswith("no number here says how good the design is")

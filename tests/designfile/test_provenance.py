"""A design tells the scenes that it was trained on from others, in every test of it."""

from dataclasses import replace

import numpy as np
import pytest

import deepfsi
from deepfsi import InputError, load_dataset, load_design
from deepfsi.designfile import TrainingScenes, provenance, scene_hashes
from shared.design_files import rewrite
from shared.jobs import learn
from shared.pictures import save_images

DESIGNS = {
    "learned": {"masks": 4, "epochs": 1},
    "adaptive": {"masks": 2, "design": "adaptive", "light": "free-dwell"},
}


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """A folder of one's own: 16 x 16 pixels of noise, brought to 8 x 8 by the data set."""
    rng = np.random.default_rng(11)
    folder = tmp_path_factory.mktemp("own") / "mine"
    for label in ("ash", "oak"):
        save_images(folder / label, rng.integers(0, 256, (30, 16, 16), np.uint8))
    return folder


@pytest.fixture(scope="module", params=[None, (0.3, 1.0)], ids=["as they are", "dim black"])
def data(request, pictures):
    return load_dataset(pictures, size=8, rescale=request.param)


@pytest.fixture(scope="module", params=DESIGNS)
def design(request, data, tmp_path_factory):
    """A design of its file."""
    made = learn(data, photons=1e4, **DESIGNS[request.param])
    return load_design(made.save(tmp_path_factory.mktemp("design") / "one.safetensors"))


def test_exactly_the_training_scenes_are_known(design, data):
    known = design.training_scenes
    assert known.contains(scene_hashes(data.x_train, data.image_shape)).all()
    assert not known.contains(scene_hashes(data.x_test, data.image_shape)).any()


def test_a_new_scene_is_taken_for_one_of_n_at_the_stated_rate():
    """n / 2³² each: 7.5e4 new scenes and 7.5e4 that were trained on give 1.3 such in the mean."""
    scenes = np.random.default_rng(2).random((150_000, 9), np.float32)
    hashes = scene_hashes(scenes, (3, 3))
    known = TrainingScenes(
        np.unique(np.array([int(h, 16) for h in hashes[::2]], np.uint32).view(np.int32))
    )
    mean = 75_000**2 / 2**32
    assert known.contains(hashes[::2]).all()
    assert known.contains(hashes[1::2]).sum() <= mean + 5 * mean**0.5
    bits = np.unpackbits(np.frombuffer(bytes.fromhex("".join(hashes)), np.uint8)).reshape(-1, 32)
    assert abs(bits.mean(axis=0) - 0.5).max() < 5 * 0.5 / 150_000**0.5


def test_scenes_that_were_trained_on_are_left_out_of_a_test(design, data):
    mixed = replace(
        data,
        x_test=np.concatenate([data.x_train[:20], data.x_test]),
        y_test=np.concatenate([data.y_train[:20], data.y_test]),
    )
    [found] = deepfsi.evaluate(design, mixed, 1e4, draws=2)
    [expected] = deepfsi.evaluate(design, data, 1e4, draws=2)
    assert (
        found.covers
        == f"{expected.covers}; 20 of the 32 test scenes were trained on, and are left out"
    )
    assert replace(found, covers=expected.covers) == expected
    own = replace(data, x_test=data.x_train, y_test=data.y_train)
    [found] = deepfsi.evaluate(design, own, 1e4, draws=1)
    assert found.images == len(data.x_train)
    assert found.covers.endswith(provenance.NO_MEASURE)


def test_hashes_that_are_none_are_refused(design, tmp_path):
    path = design.save(tmp_path / "bad.safetensors")

    def reverse(header, tensors):
        tensors[provenance.SCENE_HASHES] = tensors[provenance.SCENE_HASHES].flip(0)

    rewrite(path, reverse)
    with pytest.raises(InputError, match="not a whole deepfsi design file"):
        load_design(path)

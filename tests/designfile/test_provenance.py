"""A design tells the scenes that it was trained on from others, in every test of it."""

from dataclasses import replace

import numpy as np
import pytest

import deepfsi
from deepfsi import InputError, load_dataset, load_design
from deepfsi.datasets import write_pictures
from deepfsi.designfile import TrainingScenes, new_scenes, scene_hashes
from deepfsi.designfile.provenance import NO_MEASURE, SCENE_HASHES
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


def test_they_are_known_again_from_a_picture_of_8_bits(design, data, tmp_path):
    """As `data export` writes scenes; reflectances are then off by up to half a level."""
    for part, trained in (("x_train", True), ("x_test", False)):
        scenes = getattr(data, part).reshape(-1, *data.image_shape)
        write_pictures({f"{k:03}.png": x for k, x in enumerate(scenes)}, tmp_path / part)
        shown = deepfsi.datasets.read_display(tmp_path / part)
        found = design.training_scenes.contains(scene_hashes(shown.x, data.image_shape))
        assert (found == trained).all()


def test_rounding_of_floats_changes_no_hash(data):
    """Away from the middle between two levels, where 1e-6 of a level decides."""
    x = np.rint(data.x_train * 255) / np.float32(255)
    for off in (-1e-6, 1e-6):
        assert scene_hashes(x + np.float32(off), data.image_shape) == scene_hashes(
            x, data.image_shape
        )


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
    assert found.covers.endswith(NO_MEASURE)


@pytest.mark.parametrize("design", ["learned"], indirect=True)
def test_pictures_that_were_trained_on_are_told_apart(design, data, pictures):
    found = deepfsi.predict(design, pictures, 1e4)
    score = found.score
    assert (score.new.answers, score.trained_on.answers, score.unknown.answers) == (12, 48, 0)
    new = [each for each in found.pictures if not each.trained_on]
    assert score.new.right == sum(each.predicted == each.label for each in new)
    first, second = score.lines("picture")
    assert first.startswith(f"right: {score.new.right} of 12 new pictures (")
    assert second.startswith("48 of these 60 pictures were trained on")
    assert found.as_dict()["score"]["new"]["scenes"] == 12
    assert found.as_csv().splitlines()[0] == "picture,class,confidence,label,trained_on"


def test_scenes_that_were_held_out_are_known_too(data):
    """Thresholds and temperatures are of them; to validate on them is asked for."""
    kept = data.hold_out(12)
    known = TrainingScenes.of(kept)
    assert known.contains(scene_hashes(kept.x_test, kept.image_shape)).all()
    assert new_scenes(known, kept) == (kept, None)
    assert new_scenes(known, data) == (data, None)


def test_a_file_of_an_older_version_does_not_know(design, data, pictures, tmp_path):
    path = design.save(tmp_path / "old.safetensors")
    rewrite(path, lambda header, tensors: tensors.pop(SCENE_HASHES))
    old = load_design(path)
    assert old.training_scenes is None
    [now], [then] = (deepfsi.evaluate(each, data, 1e4, draws=1) for each in (design, old))
    assert now == then
    [line] = deepfsi.predict(old, pictures, 1e4).score.lines("picture")
    assert line.endswith("whether the design was trained on them is not known")


def test_hashes_that_are_none_are_refused(design, tmp_path):
    path = design.save(tmp_path / "bad.safetensors")

    def reverse(header, tensors):
        tensors[SCENE_HASHES] = tensors[SCENE_HASHES].flip(0)

    rewrite(path, reverse)
    with pytest.raises(InputError, match="not a whole deepfsi design file"):
        load_design(path)

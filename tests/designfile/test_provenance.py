"""A design tells the scenes that it was trained on from others, in every test of it."""

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

import deepfsi
from deepfsi import load_dataset, load_design
from deepfsi.datasets.display import read_display
from deepfsi.designfile.design_file import DesignFile
from deepfsi.designfile.provenance import SCENE_ARRAYS, TrainingScenes, scene_hashes, was_trained_on
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
def design(request, data, tmp_path_factory, all_trained_once):
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
    training = TrainingScenes(known)
    assert all(was_trained_on(training, hashes[::2]))
    assert sum(was_trained_on(training, hashes[1::2])) <= mean + 5 * mean**0.5
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


def written(picture, kind):
    """A picture of 32 x 32 pixels as a user may give it again."""
    image = Image.fromarray(picture)
    if kind == "cut":
        return image.crop((1, 0, 32, 31))
    if kind == "resized":
        return image.resize((50, 50), Image.Resampling.BICUBIC)
    content = io.BytesIO()
    image.save(content, "JPEG", quality=50)
    return Image.open(io.BytesIO(content.getvalue()))


def test_pictures_of_the_training_are_recognised_when_they_are_cut_or_written_again(tmp_path):
    """Of drawn pictures 9 of 10, and 1 of 100 new ones: 5 of 200 are 1.9 deviations more."""
    rng = np.random.default_rng(3)
    drawn = gaussian_filter(rng.standard_normal((360, 32, 32)), (0, 2, 2), mode="wrap")
    drawn = np.uint8(127 + 100 * np.tanh(drawn / drawn.std()))
    for label, rows in (("ash", drawn[:80]), ("oak", drawn[80:160])):
        save_images(tmp_path / "own" / label, rows)
    data = load_dataset(tmp_path / "own", size=16)
    design = learn(data, photons=1e4, masks=4, epochs=1)
    design = load_design(design.save(tmp_path / "one.safetensors"))
    assert design.training_scenes.thumbnails.nbytes <= 256 * len(data.x_train)
    training = {row.tobytes() for row in data.x_train}
    for kind in ("cut", "resized", "compressed", "new"):
        again = tmp_path / kind
        again.mkdir()
        for number, picture in enumerate(drawn[160:] if kind == "new" else drawn[:160]):
            image = Image.fromarray(picture) if kind == "new" else written(picture, kind)
            image.save(again / f"{number:03}.png")
        scenes = deepfsi.predict(design, again, photons=1e4).scenes
        found = [scene.trained_on for scene in scenes]
        if kind == "new":
            assert sum(found) <= 5
        else:
            exact = read_display(tmp_path / "own", shape=(16, 16)).x.reshape(160, -1)
            known = [row.tobytes() in training for row in exact]
            assert sum(known) == len(data.x_train)
            assert np.mean([f for f, k in zip(found, known, strict=True) if k]) >= 0.9
            assert sum(f for f, k in zip(found, known, strict=True) if not k) <= 2


def test_a_file_without_thumbnails_opens_and_a_damaged_one_is_refused(design, tmp_path):
    """As older versions wrote it; and with thumbnails of another number or shape of scenes."""
    path = design.save(tmp_path / "whole.safetensors")
    file = DesignFile.read(path)
    old = {name: array for name, array in file.arrays.items() if name not in SCENE_ARRAYS[1:]}
    path.write_bytes(replace(file, arrays=old).to_bytes())
    assert load_design(path).training_scenes.thumbnails is None
    whole = file.arrays["training_thumbnails"]
    for small in (whole[1:], whole[:, 1:], whole[..., None], whole.astype(np.float32)):
        path.write_bytes(replace(file, arrays={**file.arrays, SCENE_ARRAYS[1]: small}).to_bytes())
        with pytest.raises(deepfsi.InputError, match="is not a whole deepfsi design file"):
            load_design(path)

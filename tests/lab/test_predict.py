"""New pictures get the preprocessing that their design remembers, and exact counts."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.stats import binom

import deepfsi
from deepfsi import InputError
from deepfsi.datasets.catalog import DIM_BLACK
from shared.jobs import learn


@pytest.fixture(scope="module")
def design(digits):
    return learn(digits, photons=1e4, masks=12, epochs=20)


@pytest.fixture
def raw(tmp_path, digits):
    """All test scenes as pictures before they are mapped to 0.3 .. 1, all of one folder."""
    low, high = DIM_BLACK
    (tmp_path / "raw").mkdir()
    for place, x in enumerate(digits.x_test.reshape(-1, 8, 8)):
        levels = np.rint((x - low) / (high - low) * 255).astype(np.uint8)
        Image.fromarray(levels).save(tmp_path / "raw" / f"{place:04}.png")
    return tmp_path / "raw"


def test_new_pictures_are_classified_as_often_as_the_test_scenes(design, digits, raw):
    """One exposure of the same scenes: what differs is their rounding to 8 bits, and the noise."""
    found = deepfsi.predict(design, raw, 1e4, seed=3)
    right = np.mean([
        each.predicted == digits.classes[label]
        for each, label in zip(found.scenes, digits.y_test, strict=True)
    ])  # fmt: skip
    [expected] = deepfsi.evaluate(design, digits, 1e4, draws=20)
    p, n = expected.accuracy, len(digits.y_test)
    assert abs(right - p) < 4 * np.sqrt(p * (1 - p) / n), "four standard deviations of one exposure"
    assert "then mapped from [0, 1] to [0.3, 1]" in found.preprocessing


def test_light_is_that_of_the_camera_unless_it_is_told(digits, raw, design):
    """Of a camera whose light was not trained for, the lowest that was."""
    told = deepfsi.predict(design, raw, 1e4, seed=3)
    assert deepfsi.predict(design, raw, seed=3) == told
    lab = deepfsi.Camera(exposure="10ms", flux=3e6, dark=200)
    made = learn(digits, camera=lab, masks=4, epochs=1)
    assert deepfsi.predict(made, raw).photons == pytest.approx(3e4)
    dim = learn(digits, camera=lab, photons=1e3, masks=4, epochs=1)
    assert deepfsi.predict(dim, raw).photons == 1e3
    dark_free = deepfsi.Camera(exposure="10ms", flux=3e6)
    several = learn(digits, camera=dark_free, photons=1e3, span=100, masks=4, epochs=1)
    assert deepfsi.predict(several, raw).photons == pytest.approx(3e4)
    with pytest.raises(InputError, match="does not know what to do to pictures"):
        deepfsi.predict(replace(design, info={"job": design.info["job"]}), raw, 1e4)
    camera = {"camera": design.info["job"]["camera"]}
    silent = replace(design, info=design.info | {"job": camera})
    with pytest.raises(InputError, match="give `photons`"):
        deepfsi.predict(silent, raw)


def test_arrays_are_predicted_as_the_scenes_and_pictures_that_they_are(design, digits, raw):
    """Floats as the data set has them; whole numbers get what pictures of files get."""
    found = deepfsi.predict(design, digits.x_test, 1e4)
    square = digits.x_test.reshape(-1, *design.image_shape)
    assert found.scenes == deepfsi.predict(design, square, 1e4).scenes
    assert [each.name for each in found.scenes[:2]] == ["0", "1"]
    files = sorted(raw.iterdir())
    levels = np.stack([np.asarray(Image.open(file)) for file in files])
    answers = []
    for given in (raw, levels, levels.reshape(len(levels), -1)):
        found = deepfsi.predict(design, given, 1e4)
        mapped = "divided by 255, then mapped from [0, 1] to [0.3, 1]"
        assert found.preprocessing.endswith(mapped)
        answers.append([(one.predicted, one.probability, one.trained_on) for one in found.scenes])
    assert answers[0] == answers[1] == answers[2]


@pytest.mark.parametrize(
    ("pictures", "photons", "match"),
    [
        (np.zeros((3, 5)), 1e4, "the pictures are of 5 pixels and the design's scenes of 8x8"),
        (np.full((2, 8, 8), 7.0), 1e4, "pictures"),
        ("a.png", 1e4, r"pictures are of 9x8 pixels and the design's scenes of 8x8"),
    ],
)
def test_what_cannot_be_predicted_is_one_line(
    design, tmp_path, monkeypatch, pictures, photons, match
):
    monkeypatch.chdir(tmp_path)
    Image.fromarray(np.zeros((9, 8), np.uint8)).save("a.png")
    with pytest.raises(InputError, match=match) as error:
        deepfsi.predict(design, pictures, photons)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("kind", ["deepfsi", "adaptive"])
def test_pictures_unlike_the_training_are_marked(digits, kind):
    """Inverted, black and white ones are; of sound ones 1 in 200, twice as often at most."""
    words = {"masks": 12, "epochs": 20} if kind == "deepfsi" else {"design": kind, "masks": 12}
    design = learn(digits, photons=1e4, camera="dmd", **words)
    low, high = float(digits.x_train.min()), float(digits.x_train.max())
    few = digits.x_test[:60]
    for x in (low + high - few, 0 * few, 0 * few + 1):
        found = deepfsi.predict(design, x, 1e4, seed=1)
        assert np.mean([scene.unlike for scene in found.scenes]) > 0.9
        assert found.as_dict()["pictures"][0]["unlike"]
    sound = deepfsi.predict(design, digits.x_test, 1e4, seed=1)
    unlike = sum(scene.unlike for scene in sound.scenes)
    assert unlike <= binom.ppf(0.999, len(digits.x_test), 0.01)
    dim = deepfsi.predict(design, digits.x_test, 1e4, camera="dmd", seed=1, dark=3e3)
    assert sum(scene.unlike for scene in dim.scenes) <= binom.ppf(0.999, len(digits.x_test), 0.01)

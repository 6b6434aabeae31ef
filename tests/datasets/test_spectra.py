"""Hyperspectral images become scenes with honest splits."""

import numpy as np
import pytest
from dataset_samples import IMAGE, LABELS, fields, numbered, refused
from scipy.ndimage import distance_transform_cdt

from deepfsi.datasets import SpectralImage


def pixels(x):
    """Rows and columns of the scenes of a numbered cube."""
    return [(int(i), int(j)) for i, j in np.rint(x[:, :2] * 400 - 100)]


@pytest.mark.parametrize("split", ["random", "blocks"])
def test_each_labelled_pixel_is_a_scene(split):
    data = IMAGE.dataset(split, bands=8)
    assert data.image_shape == (8,)
    assert data.classes == ("1", "2", "3", "4")
    assert data.x_train.dtype == np.float32
    assert data.y_train.dtype == np.int64
    for x, y in ((data.x_train, data.y_train), (data.x_test, data.y_test)):
        assert np.allclose(x[:, 3], 130 / 400)
        assert np.allclose(x[:, 4], (20 * (y + 1) + 100) / 400)
        assert not x[:, 5:].any(), "the padding is dark"
        assert [LABELS[i, j] - 1 for i, j in pixels(x)] == y.tolist()
    assert pixels(data.x_test) == sorted(pixels(data.x_test))
    assert pixels(data.x_train) != sorted(pixels(data.x_train)), "shuffled"
    assert not set(pixels(data.x_train)) & set(pixels(data.x_test))
    assert data.preprocessing.startswith(
        "Spectra mapped from [-100, 300] to [0, 1], 5 bands, padded with darkness to 8;"
    )
    assert data.hash == IMAGE.dataset(split, bands=8).hash
    assert data.hash != IMAGE.dataset(split, bands=8, seed=1).hash


def test_the_random_split_is_a_stratified_fifth():
    train, test = IMAGE.parts("random", 3)
    assert np.array_equal(train | test, LABELS > 0)
    for label in range(1, 5):
        share = test[label == LABELS].mean()
        assert share == pytest.approx(0.2, abs=1 / np.count_nonzero(label == LABELS))
    data = IMAGE.dataset("random", 3)
    assert sorted(pixels(data.x_train)) == [tuple(p) for p in np.argwhere(train).tolist()]


@pytest.mark.parametrize("seed", range(4))
def test_the_blocks_are_apart(seed):
    train, test = IMAGE.parts("blocks", seed)
    assert not (train & test).any()
    away = distance_transform_cdt(~test, metric="chessboard")
    assert away[train].min() == 2, "one pixel between them, and no more is lost"
    left_out = (LABELS > 0) & ~train & ~test
    assert (away[left_out] == 1).all()
    assert np.array_equal(np.unique(LABELS[train]), [1, 2, 3, 4])
    assert np.array_equal(np.unique(LABELS[test]), [1, 2, 3, 4])
    assert test.sum() == pytest.approx(0.2 * (LABELS > 0).sum(), rel=0.3)
    random = distance_transform_cdt(~IMAGE.parts("random", seed)[1], metric="chessboard")
    assert random[IMAGE.parts("random", seed)[0]].min() == 1


def test_a_class_in_one_block_is_trained_on():
    labels = fields()
    labels[:3, :3] = 5
    for seed in range(3):
        train, _ = SpectralImage("farm", numbered(labels), labels).parts("blocks", seed)
        assert (labels[train] == 5).any()


def test_the_map_and_the_scenes_agree():
    every = IMAGE.scenes(8)
    assert every.shape == (3600, 8)
    data = IMAGE.dataset(bands=8)
    for row, (i, j) in zip(data.x_test[:20], pixels(data.x_test[:20]), strict=True):
        assert np.array_equal(row, every[60 * i + j])


def test_reflectance_is_left_as_it_is():
    cube = np.random.default_rng(2).uniform(0.2, 0.7, (60, 60, 4))
    data = SpectralImage("farm", cube, LABELS).dataset()
    assert np.allclose(IMAGE.parts()[1][LABELS > 0].sum(), len(data.x_test))
    assert np.array_equal(data.x_test, cube[IMAGE.parts()[1]].astype(np.float32))
    assert data.preprocessing.startswith("Spectra, 4 bands; a random stratified fifth")
    counts = SpectralImage("farm", (cube * 1000).astype(np.uint16), LABELS).dataset()
    assert (counts.x_train.min(), counts.x_train.max()) == pytest.approx((0, 1), abs=0.01)


def test_classes_and_wavelengths():
    wavelengths = np.arange(400.0, 900, 100)
    names = ("oak", "ash", "elm", "yew", "fir")
    data = SpectralImage("farm", numbered(LABELS), LABELS, names, wavelengths).dataset(bands=8)
    assert data.classes == names[:4], "fir has no pixel"
    assert data.wavelengths is not None
    assert data.wavelengths[:5].tolist() == wavelengths.tolist()
    assert np.isnan(data.wavelengths[5:]).all()
    assert data.hold_out().wavelengths is data.wavelengths
    assert IMAGE.dataset().wavelengths is None
    gaps = np.where(LABELS == 2, 9, LABELS)
    assert SpectralImage("farm", numbered(LABELS), gaps).class_names == ("1", "3", "4", "9")


def bad(**changes):
    return SpectralImage(**{"name": "farm", "cube": numbered(LABELS), "labels": LABELS, **changes})


NAN = numbered(LABELS).astype(float)

NAN[3, 3, 3] = np.nan


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"cube": LABELS}, ("the cube is uint8 of shape (60, 60)", "(height, width, bands)")),
        ({"cube": numbered(LABELS) > 3}, ("the cube is bool",)),
        ({"cube": numbered(LABELS)[:, :, :0]}, ("(60, 60, 0)",)),
        ({"cube": NAN}, ("NaN",)),
        ({"labels": LABELS[:-1]}, ("label map is uint8 of shape (59, 60)", "(60, 60)")),
        ({"labels": LABELS / 2}, ("label map is float64",)),
        ({"labels": LABELS * 0}, ("0 classes",)),
        ({"labels": LABELS // 4}, ("1 classes", "two or more")),
        ({"classes": ("a", "b")}, ("1, 2, 3, 4 for 2 class names",)),
        ({"wavelengths": np.arange(4.0)}, ("4 wavelengths for 5 bands",)),
    ],
)
def test_images_that_do_not_fit(changes, parts):
    with refused("farm", *parts):
        bad(**changes)


def test_options_that_cannot_be():
    small = np.zeros((60, 60), np.uint8)
    small[:4, 0], small[9:20, 9:20] = 1, 2
    one_block = np.zeros((60, 60), np.uint8)
    one_block[:4, :2], one_block[:4, 2:4] = 1, 2
    for attempt, parts in (
        (lambda: IMAGE.parts("block"), ("unknown split 'block'", "'blocks'")),
        (lambda: IMAGE.parts("random", -1), ("seed -1",)),
        (lambda: IMAGE.scenes(4), ("5 bands cannot be padded to 4",)),
        (lambda: bad(labels=small).parts(), ("class '1' has 4 pixels", "5 or more")),
        (lambda: bad(labels=one_block).parts("blocks"), ("fewer than 5 blocks", "at random")),
        (lambda: bad(cube=np.full((60, 60, 3), 7)).scenes(), ("every value of the cube is 7",)),
    ):
        with refused(*parts):
            attempt()

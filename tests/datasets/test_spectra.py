"""Hyperspectral images of any file become scenes with honest splits."""

from pathlib import Path

import numpy as np
import pytest
from dataset_samples import CUBE, IMAGE, LABELS, fields, not_loaded, numbered, refused
from scipy.io import savemat
from scipy.ndimage import distance_transform_cdt

from deepfsi.datasets.load import load_dataset
from deepfsi.datasets.spectra import SpectralImage


def pixels(x):
    """Rows and columns of the scenes of a numbered cube."""
    return [(int(i), int(j)) for i, j in np.rint(x[:, :2] * 400 - 100)]


@pytest.mark.parametrize("split", ["random", "blocks"])
def test_each_labelled_pixel_is_a_scene(split):
    data = IMAGE.dataset(split, bands=8)
    assert data.image_shape == (8,)
    assert data.classes == ("1", "2", "3", "4")
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
    again, other = (IMAGE.dataset(split, bands=8, seed=seed).hash for seed in (0, 1))
    assert data.hash == again != other


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


def test_names_of_classes():
    names = ("oak", "ash", "elm", "yew", "fir")
    data = SpectralImage("farm", CUBE, LABELS, names).dataset(bands=8)
    assert data.classes == names[:4], "fir has no pixel"
    gaps = np.where(LABELS == 2, 9, LABELS)
    assert SpectralImage("farm", CUBE, gaps).class_names == ("1", "3", "4", "9")


def image(**changes):
    return SpectralImage(**{"name": "farm", "cube": CUBE, "labels": LABELS, **changes})


def zeros(*fields):
    """A label map of nothing but fields."""
    labels = np.zeros((60, 60), np.uint8)
    for number, field in enumerate(fields):
        labels[field] = number + 1
    return labels


SMALL = zeros(np.s_[:4, 0], np.s_[9:20, 9:20])
ONE_BLOCK = zeros(np.s_[:4, :2], np.s_[:4, 2:4])


@pytest.mark.parametrize(
    ("attempt", "parts"),
    [
        (lambda: image(cube=LABELS), ("cube is of shape (60, 60),", "(height, width, bands)")),
        (lambda: image(cube=np.where(CUBE == 300, np.nan, CUBE)), ("finite",)),
        (lambda: image(labels=LABELS[:-1]), ("map uint8 of shape (59, 60)", "(height, width)")),
        (lambda: image(labels=LABELS // 4), ("two classes or more",)),
        (lambda: IMAGE.parts("block"), ("unknown split 'block'", "'blocks'")),
        (lambda: image(labels=SMALL).parts(), ("class '1' has 4 pixels", "5 or more")),
        (lambda: image(labels=ONE_BLOCK).parts("blocks"), ("no choice of blocks", "at random")),
    ],
)
def test_images_that_do_not_fit_and_options_that_cannot_be(attempt, parts):
    with refused(*parts):
        attempt()


def test_files_side_by_side(tmp_path):
    savemat(tmp_path / "farm_corrected.mat", {"farm_corrected": CUBE, "note": "a word"})
    savemat(tmp_path / "farm_gt.mat", {"farm_gt": LABELS.astype(float)}, do_compression=True)
    np.save(tmp_path / "plot.npy", CUBE)
    np.save(tmp_path / "plot_gt.npy", LABELS)
    for name in ("farm_corrected.mat", "plot.npy"):
        data = load_dataset(tmp_path / name, split="blocks", seed=2)
        assert data.hash == IMAGE.dataset("blocks", 2).hash
        assert data.name == Path(name).stem
        assert load_dataset(tmp_path / name).hash == IMAGE.dataset().hash


@pytest.mark.parametrize(
    ("variables", "parts"),
    [
        ({"a": CUBE, "b": CUBE}, ("not one variable alone", "a, b: save it alone")),
        (
            {"a": LABELS, "word": "cube", "cell": np.array([CUBE], object)},
            ("in 3 dimensions", "but none"),
        ),
    ],
)
def test_files_that_do_not_serve(tmp_path, variables, parts):
    savemat(tmp_path / "a.mat", {"a": CUBE})
    not_loaded(tmp_path / "a.mat", "no label map beside it", "a_gt.mat or a_gt.npy")
    np.save(tmp_path / "a_gt.npy", LABELS)
    load_dataset(tmp_path / "a.mat")
    savemat(tmp_path / "a.mat", variables)
    not_loaded(tmp_path / "a.mat", *parts)
    np.save(tmp_path / "a.npy", CUBE[..., 0])
    not_loaded(tmp_path / "a.npy", "(60, 60)", "(height, width, bands)")

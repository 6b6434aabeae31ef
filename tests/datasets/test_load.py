"""Names, paths and tuples are told apart; digits."""

import zipfile

import numpy as np
import pytest
from dataset_samples import X, Y, refused

from deepfsi.base import closest_choice
from deepfsi.datasets import load_dataset

DIGITS_HASH = "a24eb6e0dbf2acc4009205dbb06c1c3e5d3f8a6db4843471cb6da068e8b9c8a2"


@pytest.mark.parametrize("arrays", [(X,), (X, Y, X)])
def test_a_tuple_of_the_wrong_length(arrays):
    with refused(f"tuple of {len(arrays)}", "(x, y, x_test, y_test)"):
        load_dataset(arrays)


@pytest.mark.parametrize(
    ("source", "parts"),
    [
        ("MNITS", ("unknown data set 'MNITS'", "did you mean 'mnist'?", "digits, mnist")),
        ("zzzz", ("unknown data set 'zzzz'", "give one of digits, mnist, fashion-mnist")),
        ("", ("unknown data set ''",)),
        ("no/such/folder", ("no folder and no file at 'no/such/folder'",)),
        ("scenes.npz", ("no folder and no file at 'scenes.npz'",)),
    ],
)
def test_unknown_source(source, parts, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with refused(*parts):
        load_dataset(source)


def test_closest():
    assert closest_choice("Hadamrad", ["raster", "hadamard"]).startswith(
        "did you mean 'hadamard'? "
    )
    assert closest_choice("xyz", ["raster", "hadamard"]) == "give one of raster, hadamard"


def test_size_is_for_folders_only(tmp_path):
    np.savez(tmp_path / "a.npz", x=X, y=Y)
    for source in ("digits", "mnist", tmp_path / "a.npz", (X, Y)):
        with refused("only images of a folder, a zip file, a .csv file or CIFAR-10"):
            load_dataset(source, size=8)


def test_digits():
    data = load_dataset("digits")
    assert data.x_train.shape == (1437, 64)
    assert data.x_test.shape == (360, 64)
    assert data.image_shape == (8, 8)
    assert data.classes == tuple("0123456789")
    assert data.x_train.min() == np.float32(0.3)
    assert data.x_train.max() == 1
    assert data.preprocessing == "Divided by 16, then mapped from [0, 1] to [0.3, 1]."
    assert np.bincount(data.y_test).min() >= 34, "stratified"
    plain = load_dataset("digits", rescale=(0, 1))
    assert set(np.unique(plain.x_train * 16)) == set(range(17))
    assert np.allclose(0.3 + 0.7 * plain.x_train, data.x_train)
    assert load_dataset("digits", seed=1).hash != data.hash == load_dataset("digits").hash
    assert data.hash == DIGITS_HASH, "records name the data by it"


@pytest.mark.parametrize("name", ["x.h5", "x.parquet", "x.pt", "x.tif", "x.tar.gz", "nosuffix"])
def test_a_file_of_another_kind_is_told_which_kinds_are_read(tmp_path, name):
    (tmp_path / name).write_bytes(b"PK\x03\x04" + bytes(10))
    with refused("is no data set that is read (it holds a zip file", ".npz file of arrays x and y"):
        load_dataset(tmp_path / name)


def test_the_data_of_a_cube_are_told_their_header(tmp_path):
    for name in ("cube.img", "cube.hdr", "other.raw", "other.raw.hdr"):
        (tmp_path / name).write_text("ENVI")
    for name, header in (("cube.img", "cube.hdr"), ("other.raw", "other.raw.hdr")):
        with refused("is the data file of an ENVI cube: give its header", header):
            load_dataset(tmp_path / name)


@pytest.mark.parametrize("name", ["a.npz", "a.npy", "a.mat", "a.zip", "a.csv"])
@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"<!DOCTYPE html><html>", "a web page"),
        (b"", "nothing"),
        (b"\x89PNG\r\n\x1a\n\0\0", "a PNG picture"),
        (b"version https://git-lfs.github.com/spec/v1\n", "Git LFS"),
    ],
)
def test_other_content_behind_a_name_is_named(tmp_path, name, content, said):
    (tmp_path / name).write_bytes(content)
    (tmp_path / "a_gt.npy").write_bytes(content)
    with refused(name if name != "a.npy" else "a", *([said] if name != "a.csv" else [])):
        load_dataset(tmp_path / name)


@pytest.mark.parametrize("name", ["a.npz", "a.zip"])
def test_a_cut_zip_file_is_named_so(tmp_path, name):
    with zipfile.ZipFile(tmp_path / name, "w") as file:
        file.writestr("x.npy", bytes(1000))
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:500])
    with refused(name, "it is cut or damaged"):
        load_dataset(tmp_path / name)


def test_an_npz_file_of_pictures_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as file:
        file.writestr("cat/000.png", b"\x89PNG")
    with refused("cannot read", "a.npz/cat/000.png", "numpy.savez"):
        load_dataset(tmp_path / "a.npz")
    (tmp_path / "b.npz").mkdir()
    with refused("b.npz has no sub-folders"):
        load_dataset(tmp_path / "b.npz")

"""Names, paths and tuples are told apart; digits."""

import io
import zipfile

import numpy as np
import pytest
from dataset_samples import X, Y, not_loaded

from deepfsi.datasets.load import load_dataset

DIGITS_HASH = "a24eb6e0dbf2acc4009205dbb06c1c3e5d3f8a6db4843471cb6da068e8b9c8a2"


ARRAYS = (X, Y)


def zipped(name, content):
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as file:
        file.writestr(name, content)
    return made.getvalue()


@pytest.mark.parametrize(
    ("source", "options", "parts"),
    [
        ("MNITS", {}, ("unknown data set 'MNITS'", "did you mean 'mnist'?", "digits, mnist")),
        ("zzzz", {}, ("unknown data set 'zzzz'", "give one of digits, mnist, fashion-mnist")),
        (
            "no/such/folder",
            {},
            ("unknown data set 'no/such/folder'", "or the path of a folder of images"),
        ),
        ("digits", {"size": 8}, ("digits takes no `size`",)),
        (ARRAYS, {"size": 8}, ("arrays takes no `size`",)),
        ("other.raw", {}, ("other.raw is no data set that is read", ".npz file of arrays")),
    ],
)
def test_sources_that_are_unknown_and_options_that_they_do_not_take(
    source, options, parts, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other.raw").write_text("ENVI")
    not_loaded(source, *parts, **options)


def test_digits():
    data = load_dataset("digits")
    assert data.x_train.shape == (1437, 64)
    assert data.preprocessing == "Divided by 16, then mapped from [0, 1] to [0.3, 1]."
    assert np.bincount(data.y_test).min() >= 34, "stratified"
    plain = load_dataset("digits", rescale=(0, 1))
    assert set(np.unique(plain.x_train * 16)) == set(range(17))
    assert np.allclose(0.3 + 0.7 * plain.x_train, data.x_train)
    assert load_dataset("digits", seed=1).hash != data.hash == load_dataset("digits").hash
    assert data.hash == DIGITS_HASH, "records name the data by it"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        *((name, b"<!DOCTYPE html><html>") for name in ("a.npz", "a.npy", "a.mat")),
        ("a.npz", zipped("x.npy", bytes(1000))[:500]),
        ("a.npz", zipped("cat/000.png", b"\x89PNG")),
    ],
)
def test_other_content_behind_a_name_is_refused(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    (tmp_path / "a_gt.npy").write_bytes(b"")
    not_loaded(tmp_path / name, "cannot read", name)

"""Every loader gives scenes in [0, 1] with fair splits; every bad input gives one clear line."""

from __future__ import annotations

import gzip
import hashlib
import http.server
import os
import pickle
import subprocess
import sys
import threading
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pooch
import pytest
from PIL import Image

from deepfsi.datasets import (
    Dataset,
    check,
    download,
    from_arrays,
    idx,
    list_datasets,
    load_dataset,
    pictures,
    store,
)
from deepfsi.datasets.arrays import draw_stratified
from deepfsi.errors import InputError, closest

Array = npt.NDArray[Any]

real_mnist = pytest.mark.skipif(
    not (Path(os.environ.get("DEEPFSI_DATA") or ".") / "mnist" / idx.IDX_FILES[0]).is_file(),
    reason="needs MNIST's files in $DEEPFSI_DATA/mnist",
)


DIGITS_HASH = "a24eb6e0dbf2acc4009205dbb06c1c3e5d3f8a6db4843471cb6da068e8b9c8a2"
MNIST_HASH = "49bd5a2700bc752110ee3797138b1924d711c3bd98a376b24e07fd7ad78585d1"


def scenes(n: int = 30, shape: tuple[int, ...] = (3, 4), classes: int = 3) -> tuple[Array, Array]:
    """Scenes whose first pixel tells which one it is, 0/n .. (n-1)/n, and labels in turn."""
    x = np.random.default_rng(1).random((n, *shape))
    x.reshape(n, -1)[:, 0] = np.arange(n) / n
    return x, np.arange(n) % classes


def numbers(x: Array, n: int = 30) -> list[int]:
    """Which scenes of `scenes` these are."""
    return [int(number) for number in np.round(x[:, 0] * n)]


def one_line(error: pytest.ExceptionInfo[InputError], *parts: str) -> None:
    message = str(error.value)
    assert "\n" not in message
    for part in parts:
        assert part in message


def save_images(folder: Path, images: Array, suffix: str = ".png") -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for i, image in enumerate(images):
        Image.fromarray(image).save(folder / f"{i:03}{suffix}")


@pytest.fixture
def images(tmp_path: Path) -> Path:
    """A folder with two classes of ten 6x8 grey images: dark cats, bright dogs."""
    rng = np.random.default_rng(2)
    save_images(tmp_path / "pets" / "cat", rng.integers(0, 100, (10, 6, 8), dtype=np.uint8))
    save_images(tmp_path / "pets" / "dog", rng.integers(150, 256, (10, 6, 8), dtype=np.uint8))
    return tmp_path / "pets"


@pytest.fixture
def split(images: Path, tmp_path: Path) -> Path:
    """A folder with its own split: 10 cats and 10 dogs to train on, one and three to test."""
    split = tmp_path / "split"
    split.mkdir()
    images.rename(split / "train")
    save_images(split / "test" / "dog", np.full((3, 6, 8), 200, np.uint8))
    save_images(split / "test" / "cat", np.full((1, 6, 8), 20, np.uint8))
    return split


# ---------------------------------------------------------------- the Dataset itself


def test_importing_is_light() -> None:
    heavy = "{'sklearn', 'scipy', 'spectral', 'PIL', 'pooch', 'requests', 'torch'}"
    code = f"import sys, deepfsi.datasets; print({heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_hash_follows_the_content() -> None:
    data = from_arrays(*scenes())
    same = from_arrays(*scenes())
    assert len(data.hash) == 64
    assert data.hash == same.hash
    moved = data.x_test.copy()
    moved[0, 0] += 2**-12
    others = [
        replace(data, x_test=moved),
        replace(data, y_train=data.y_train[::-1].copy()),
        replace(data, classes=("a", "b", "c")),
        replace(data, image_shape=(4, 3)),
        from_arrays(*scenes(), seed=1),
    ]
    assert len({data.hash, *(other.hash for other in others)}) == 6


def test_hold_out_takes_the_last_training_scenes() -> None:
    x, y = scenes()
    data = from_arrays(x, y, x[:6], y[:6])
    for count, expected in ((None, 5), (7, 7)):
        held = data.hold_out(count)
        assert np.array_equal(held.x_test, data.x_train[-expected:])
        assert np.array_equal(held.y_test, data.y_train[-expected:])
        assert np.array_equal(held.x_train, data.x_train[:-expected])
        assert np.array_equal(held.y_train, data.y_train[:-expected])
        assert held.hash != data.hash
        assert held.classes == data.classes
        assert held.image_shape == data.image_shape


@pytest.mark.parametrize("count", [0, -1, 30, 31])
def test_hold_out_of_nothing_or_everything(count: int) -> None:
    x, y = scenes()
    data = from_arrays(x, y, x, y)
    with pytest.raises(InputError) as error:
        data.hold_out(count)
    one_line(error, f"{count} of 30", "at least 1 and at most 29")


def test_hold_out_of_a_whole_class() -> None:
    x, y = scenes(classes=2)
    data = from_arrays(x, y, x, y)
    by_class = np.argsort(data.y_train, kind="stable")
    data = replace(data, x_train=data.x_train[by_class], y_train=data.y_train[by_class])
    with pytest.raises(InputError) as error:
        data.hold_out(15)
    one_line(error, "class '1' has none left")


# ---------------------------------------------------------------- arrays


def test_arrays_are_divided_into_stratified_parts_that_share_no_scene() -> None:
    x, y = scenes()
    data = from_arrays(x, y)
    assert data.x_train.shape == (24, 12)
    assert data.x_test.shape == (6, 12)
    assert data.x_train.dtype == data.x_test.dtype == np.float32
    assert data.y_train.dtype == data.y_test.dtype == np.int64
    assert data.pixels == 12
    assert data.image_shape == (3, 4)
    assert data.classes == ("0", "1", "2")
    assert np.bincount(data.y_train).tolist() == [8, 8, 8]
    assert np.bincount(data.y_test).tolist() == [2, 2, 2]
    train, test = numbers(data.x_train), numbers(data.x_test)
    assert sorted(train + test) == list(range(30))
    assert train != sorted(train)
    for part_x, part_y, part in (
        (data.x_train, data.y_train, train),
        (data.x_test, data.y_test, test),
    ):
        assert np.array_equal(part_x, x[part].reshape(-1, 12).astype(np.float32))
        assert np.array_equal(part_y, y[part])


@pytest.mark.parametrize("own_test", [False, True])
def test_the_seed_decides(own_test: bool) -> None:
    x, y = scenes()
    rest = (x, y) if own_test else ()
    first, again, other = (numbers(from_arrays(x, y, *rest, seed=s).x_train) for s in (3, 3, 4))
    assert first == again != other


def test_a_test_part_of_its_own_keeps_its_order_and_the_training_part_is_shuffled() -> None:
    x, y = scenes()
    data = load_dataset((x, y, x[:7], y[:7]))
    assert numbers(data.x_test) == list(range(7))
    assert data.y_test.tolist() == y[:7].tolist()
    order = numbers(data.x_train)
    assert sorted(order) == list(range(30)) != order
    assert data.y_train.tolist() == y[order].tolist()


def test_spectra_keep_their_bands() -> None:
    data = load_dataset(scenes(shape=(12,)))
    assert data.image_shape == (12,)
    assert data.pixels == 12


def test_bytes_are_divided_by_255() -> None:
    x = np.zeros((30, 2, 2), np.uint8)
    x[:, 0, 0], x[:, 0, 1] = 255, 51
    data = from_arrays(x, scenes()[1])
    assert data.x_train[0].tolist() == pytest.approx([1, 0.2, 0, 0])
    assert data.preprocessing == "Divided by 255."


def test_rescale_maps_the_ends_exactly_and_stays_in_range() -> None:
    x, y = scenes()
    x[:, 1, 0], x[:, 1, 1], x[:, 1, 2] = 0, 1, 0.5
    data = from_arrays(x, y, rescale=(0.3, 1))
    assert data.x_train[0, 4:7].tolist() == pytest.approx([0.3, 1, 0.65])
    assert data.x_train.max() == 1
    assert data.x_train.min() == np.float32(0.3)
    assert data.preprocessing == "As given, then mapped from [0, 1] to [0.3, 1]."
    assert x[0, 1, 0] == 0, "the caller's array is left alone"


def test_rounding_of_a_scaler_is_forgiven_and_removed() -> None:
    x, y = scenes()
    x[0, 1, 1], x[1, 1, 1] = 1 + 1e-15, -1e-17
    data = from_arrays(x, y, x, y)
    assert data.x_test.max() == 1
    assert data.x_test.min() >= 0


def test_string_labels_become_sorted_classes() -> None:
    x, y = scenes()
    words = np.array(["oak", "ash", "yew"])[y]
    for labels in (words, words.astype(object)):
        data = from_arrays(x, labels, x, labels)
        assert data.classes == ("ash", "oak", "yew")
        assert [data.classes[k] for k in data.y_test] == words.tolist()


def test_integer_labels_need_not_count_from_zero() -> None:
    x, y = scenes()
    data = from_arrays(x, y * 5 - 3, x, y * 5 - 3)
    assert data.classes == ("-3", "2", "7")
    assert data.y_test.tolist() == y.tolist()


def test_given_classes_fix_names_and_order() -> None:
    x, y = scenes()
    names = ("oak", "ash", "yew")
    for labels in (y, np.array(names)[y]):
        data = from_arrays(x, labels, x, labels, classes=names)
        assert data.classes == names
        assert data.y_test.tolist() == y.tolist()


def spoil(value: float) -> Array:
    x, _ = scenes()
    x[4, 1, 1] = value
    return x


X, Y = scenes()
BAD_ARRAYS: dict[str, tuple[tuple[Any, ...], tuple[str, ...]]] = {
    "NaN": ((spoil(np.nan), Y), ("arrays: x holds NaN",)),
    "infinite": ((spoil(np.inf), Y), ("arrays: x holds NaN or infinite",)),
    "negative": ((spoil(-0.25), Y), ("from -0.25", "[0, 1]")),
    "above one": ((spoil(1.5), Y), ("to 1.5", "[0, 1]")),
    "other integers": ((np.ones((30, 4), np.int64), Y), ("int64", "uint8")),
    "objects": ((np.full((30, 4), None), Y), ("object", "uint8")),
    "colour": ((np.ones((30, 4, 4, 3)), Y), ("(30, 4, 4, 3)", "(n, H, W)")),
    "no scenes": ((np.ones((0, 4)), Y[:0]), ("(0, 4)",)),
    "no pixels": ((np.ones((30, 0)), Y), ("(30, 0)",)),
    "dark": ((X * 0, Y), ("dark",)),
    "lengths": ((X, Y[:-1]), ("(29,)", "30 scenes")),
    "labels in two dimensions": ((X, Y[:, None]), ("(30, 1)", "30 scenes")),
    "labels not integers": ((X, Y / 2), ("float64", "integers or strings")),
    "objects as labels": ((X, Y.astype(object)), ("object", "integers or strings")),
    "one class": ((X, Y * 0), ("only one class", "two or more")),
    "few per class": ((X, np.r_[[9] * 4, [1] * 26]), ("class '9' has 4 scenes", "5 or more")),
    "no y_test": ((X, Y, X), ("only one of x_test and y_test",)),
    "no x_test": ((X, Y, None, Y), ("only one of x_test and y_test",)),
    "other pixels in test": ((X, Y, X[:, :2], Y), ("(3, 4) in x", "(2, 4) in x_test")),
    "unknown class in test": ((X, Y, X, Y + 1), ("y_test holds the label 3", "0, 1, 2")),
    "words in test": ((X, Y, X, Y.astype(str)), ("y_test holds the label '0'", "0, 1, 2")),
    "NaN in test": ((X, Y, spoil(np.nan), Y), ("x_test holds NaN",)),
    "lengths in test": ((X, Y, X, Y[:-1]), ("y_test has shape (29,)",)),
    "empty test": ((X, Y, X[:0], Y[:0]), ("x_test has shape (0, 3, 4)",)),
}


@pytest.mark.parametrize("case", BAD_ARRAYS)
def test_bad_arrays(case: str) -> None:
    arrays, parts = BAD_ARRAYS[case]
    with pytest.raises(InputError) as error:
        from_arrays(*arrays)
    one_line(error, *parts)


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({"rescale": (0.5, 0.5)}, "rescale (0.5, 0.5)"),
        ({"rescale": (-0.1, 1)}, "0 <= low < high <= 1"),
        ({"rescale": (0, 1.1)}, "0 <= low < high <= 1"),
        ({"rescale": (float("nan"), 1)}, "0 <= low < high <= 1"),
        ({"seed": -1}, "seed -1"),
        ({"seed": 2**32}, "2**32 - 1"),
        ({"seed": 0.5}, "seed 0.5"),
        ({"classes": ("a", "b")}, "label 2"),
        ({"classes": ("a", "b", "a")}, "its own name"),
        ({"classes": ("a", "b", "c", "d")}, "class 'd' has 0 scenes"),
    ],
)
def test_bad_options(options: dict[str, Any], part: str) -> None:
    with pytest.raises(InputError) as error:
        from_arrays(X, Y, **options)
    one_line(error, part)


def test_a_class_without_training_scenes_where_the_test_part_is_given() -> None:
    with pytest.raises(InputError) as error:
        from_arrays(X, Y, X, Y, classes=("a", "b", "c", "d"))
    one_line(error, "class 'd' has no training scenes")


@pytest.mark.parametrize("arrays", [(X,), (X, Y, X)])
def test_a_tuple_of_the_wrong_length(arrays: tuple[Array, ...]) -> None:
    with pytest.raises(InputError) as error:
        load_dataset(arrays)
    one_line(error, f"tuple of {len(arrays)}", "(x, y, x_test, y_test)")


# ---------------------------------------------------------------- names and paths


@pytest.mark.parametrize(
    ("source", "parts"),
    [
        ("MNITS", ("unknown data set 'MNITS'", "did you mean 'mnist'?", "digits, mnist")),
        ("zzzz", ("unknown data set 'zzzz'", "Known: digits, mnist, fashion-mnist")),
        ("", ("unknown data set ''",)),
        ("no/such/folder", ("no folder and no file at 'no/such/folder'",)),
        ("scenes.npz", ("no folder and no file at 'scenes.npz'",)),
    ],
)
def test_unknown_source(
    source: str, parts: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as error:
        load_dataset(source)
    one_line(error, *parts)


def test_closest() -> None:
    assert closest("Hadamrad", ["raster", "hadamard"]).startswith("did you mean 'hadamard'? ")
    assert closest("xyz", ["raster", "hadamard"]) == "Known: raster, hadamard"


def test_size_is_for_folders_only(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", x=X, y=Y)
    for source in ("digits", "mnist", tmp_path / "a.npz", (X, Y)):
        with pytest.raises(InputError) as error:
            load_dataset(source, size=8)
        one_line(error, "only images of a folder, a zip file or CIFAR-10")


# ---------------------------------------------------------------- digits


def test_digits() -> None:
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


# ---------------------------------------------------------------- folders of images


def test_image_folder(images: Path) -> None:
    data = load_dataset(images)
    assert data.name == "pets"
    assert data.classes == ("cat", "dog")
    assert data.x_train.shape == (16, 48)
    assert data.x_test.shape == (4, 48)
    assert data.image_shape == (6, 8)
    assert data.preprocessing == "Grey levels divided by 255."
    for x, y in ((data.x_train, data.y_train), (data.x_test, data.y_test)):
        assert np.array_equal(x.mean(axis=1) > 0.5, y == 1)
    first = np.asarray(Image.open(images / "cat" / "000.png"), dtype=np.float32).ravel() / 255
    assert (np.r_[data.x_train, data.x_test] == first).all(axis=1).sum() == 1
    assert data.y_train.tolist() != sorted(data.y_train), "shuffled"
    assert load_dataset(str(images), seed=1).hash != data.hash == load_dataset(str(images)).hash


def test_image_folder_with_its_own_split(split: Path) -> None:
    data = load_dataset(split)
    assert data.x_train.shape == (20, 48)
    assert data.y_test.tolist() == [0, 1, 1, 1]
    assert data.x_test[:, 0] == pytest.approx([20 / 255] + [200 / 255] * 3)
    assert data.y_train.tolist() != sorted(data.y_train), "shuffled"

    save_images(split / "test" / "eel", np.full((1, 6, 8), 20, np.uint8))
    with pytest.raises(InputError) as error:
        load_dataset(split)
    one_line(error, "label 'eel'", "'cat', 'dog'")


def test_classes_may_be_called_train_and_test(images: Path) -> None:
    (images / "cat").rename(images / "train")
    (images / "dog").rename(images / "test")
    assert load_dataset(images).classes == ("test", "train")


def test_size_averages_over_areas(images: Path) -> None:
    save_images(images / "cat", np.full((1, 3, 3), 40, np.uint8))
    with pytest.raises(InputError) as error:
        load_dataset(images)
    one_line(error, "000.png is 3x3", "001.png is 6x8", "size")
    data = load_dataset(images, size=(3, 2))
    assert data.image_shape == (3, 2)
    assert data.preprocessing == "Grey levels, averaged to 3x2 pixels, divided by 255."
    full = np.asarray(Image.open(images / "cat" / "001.png"), dtype=float)
    blocks = full.reshape(3, 2, 2, 4).mean(axis=(1, 3)).ravel() / 255
    distance = np.abs(np.r_[data.x_train, data.x_test] - blocks).max(axis=1)
    assert distance.min() < 1 / 255
    assert load_dataset(images, size=4).image_shape == (4, 4)


@pytest.mark.parametrize("size", [0, -3, (4, 0), (4,), (4, 4, 4)])
def test_bad_size(images: Path, size: Any) -> None:
    with pytest.raises(InputError) as error:
        load_dataset(images, size=size)
    one_line(error, f"size {size}", "at least 1")


def test_colours_turn_grey(images: Path) -> None:
    green = np.zeros((1, 6, 8, 3), np.uint8)
    green[..., 1] = 255
    save_images(images / "cat", green)
    data = load_dataset(images)
    flat = np.ptp(np.r_[data.x_train, data.x_test], axis=1) == 0
    assert np.r_[data.x_train, data.x_test][flat][:, 0] == pytest.approx([150 / 255])


def test_other_files_are_left_alone(images: Path) -> None:
    before = load_dataset(images).hash
    (images / "cat" / "notes.txt").write_text("not an image")
    (images / "cat" / "._000.png").write_text("what a Mac leaves on a stick")
    (images / "README.md").write_text("pets")
    (images / ".cache").mkdir()
    assert load_dataset(images).hash == before
    (images / "cat" / "000.png").rename(images / "cat" / "000.PNG")
    assert load_dataset(images).hash == before


def test_empty_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        load_dataset(tmp_path)
    one_line(error, str(tmp_path), "no sub-folders")


def test_class_folder_without_images(images: Path) -> None:
    (images / "eel").mkdir()
    (images / "eel" / "notes.txt").write_text("none yet")
    with pytest.raises(InputError) as error:
        load_dataset(images)
    one_line(error, str(images / "eel"), "no images")


def test_folder_with_one_class(images: Path) -> None:
    for path in (images / "dog").iterdir():
        path.unlink()
    (images / "dog").rmdir()
    with pytest.raises(InputError) as error:
        load_dataset(images)
    one_line(error, "only one class, cat")


def test_class_with_few_images(images: Path) -> None:
    save_images(images / "eel", np.full((2, 6, 8), 20, np.uint8))
    with pytest.raises(InputError) as error:
        load_dataset(images)
    one_line(error, "class 'eel' has 2 scenes")


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".gif", ".tif", ".bmp", ".webp", ".pgm"])
def test_damaged_images(images: Path, suffix: str) -> None:
    noise = np.random.default_rng(3).integers(0, 256, (1, 64, 64), dtype=np.uint8)
    save_images(images / "dog", noise, suffix)
    path = images / "dog" / f"000{suffix}"
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], whole[:9], b"", b"not an image at all"):
        path.write_bytes(content)
        with pytest.raises(InputError) as error:
            load_dataset(images, size=8)
        one_line(error, str(path), "cannot read")


@pytest.mark.parametrize(("dtype", "suffix"), [("u2", ".png"), ("u2", ".tif"), ("f4", ".tif")])
def test_images_of_more_than_8_bits(images: Path, dtype: str, suffix: str) -> None:
    save_images(images / "cat", np.full((1, 6, 8), 1, dtype), suffix)
    with pytest.raises(InputError) as error:
        load_dataset(images)
    one_line(error, f"000{suffix} has more than 8 bits")


def test_a_bomb_among_images(images: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    for side, part in ((11, "decompression bomb"), (30, "decompression bomb")):
        save_images(images / "dog", np.full((1, side, side), 9, np.uint8))
        with pytest.raises(InputError) as error:
            load_dataset(images, size=2)
        one_line(error, "dog/000.png", "cannot read", part)


def test_images_that_need_too_much_memory(images: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "MAX_PIXELS", 20 * 48 - 1)
    with pytest.raises(InputError) as error:
        load_dataset(images)
    one_line(error, "20 images of 6x8 pixels need", "smaller size")
    monkeypatch.setattr(pictures, "MAX_PIXELS", 20 * 48)
    load_dataset(images)
    with pytest.raises(InputError) as error:
        load_dataset(images, size=10**9)
    one_line(error, "20 images of 1000000000x1000000000")


def test_only_formats_that_are_listed_are_decoded(images: Path) -> None:
    Image.new("L", (8, 6)).save(images / "cat" / "000.png", format="ICO")
    with pytest.raises(InputError) as error:
        load_dataset(images)
    one_line(error, "cat/000.png", "no image")


def test_some_training_images(split: Path) -> None:
    whole = load_dataset(split)
    data = load_dataset(split, images=6)
    assert np.bincount(data.y_train).tolist() == [3, 3]
    assert np.array_equal(data.x_test, whole.x_test)
    assert set(map(bytes, data.x_train)) <= set(map(bytes, whole.x_train))
    assert data.preprocessing == ("6 training images drawn by class; grey levels divided by 255.")
    assert data.hash == load_dataset(split, images=6).hash
    assert data.hash != load_dataset(split, images=6, seed=1).hash
    assert load_dataset(split, images=20).hash == whole.hash


@pytest.mark.parametrize("count", [0, 1, 21, -4])
def test_a_bad_number_of_images(split: Path, count: int) -> None:
    with pytest.raises(InputError) as error:
        load_dataset(split, images=count)
    one_line(error, f"{count} of 20 training images", "2 (one of each class) to 20")


def test_shares_of_unequal_classes() -> None:
    labels = np.repeat([0, 1, 2], [80, 15, 5])
    drawn = draw_stratified(labels, 20, 0, "a")
    assert np.bincount(labels[drawn]).tolist() == [16, 3, 1]
    assert len(set(drawn)) == 20
    assert set(labels[draw_stratified(labels, 3, 0, "a")]) == {0, 1, 2}


def test_options_that_other_sources_lack(images: Path) -> None:
    for options, parts in (
        ({"images": 10}, ("10 training images", "own train and test folders")),
        ({"split": "blocks"}, ("a split was given", "hyperspectral")),
    ):
        with pytest.raises(InputError) as error:
            load_dataset(images, **options)
        one_line(error, "pets", *parts)
    with pytest.raises(InputError) as error:
        load_dataset("digits", images=10)
    one_line(error, "digits: a number of images was given", "CIFAR-10")


# ---------------------------------------------------------------- zip files of images


def pack(folder: Path, archive: Path, root: str = "", **options: Any) -> Path:
    with zipfile.ZipFile(archive, "w", **options) as file:
        for path in sorted(folder.rglob("*")):
            file.write(path, root + str(path.relative_to(folder)))
    return archive


@pytest.mark.parametrize("root", ["", "pets/", "a/b/"])
@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_a_zip_file_is_like_its_folder(
    images: Path, tmp_path: Path, root: str, method: int
) -> None:
    (images / "cat" / "notes.txt").write_text("not an image")
    (images / "README.md").write_text("pets")
    path = pack(images, tmp_path / "zipped.zip", root, compression=method)
    with zipfile.ZipFile(path, "a") as file:
        file.writestr("__MACOSX/cat/._000.png", b"what a Mac adds")
        file.writestr(".DS_Store", b"and this")
    data = load_dataset(path)
    assert data.hash == load_dataset(images).hash
    assert data.name == "zipped"
    assert load_dataset(path, size=(3, 2)).hash == load_dataset(images, size=(3, 2)).hash
    assert sorted(tmp_path.iterdir()) == sorted([images, path]), "never unpacked"


@pytest.mark.parametrize("root", ["", "split/"])
def test_a_zip_file_with_its_own_split(split: Path, tmp_path: Path, root: str) -> None:
    path = pack(split, tmp_path / "split.zip", root)
    for options in ({}, {"images": 6}):
        assert load_dataset(path, **options).hash == load_dataset(split, **options).hash


def test_a_zip_file_of_windows(images: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as file:
        for image in images.rglob("*.png"):
            info = zipfile.ZipInfo("x")
            info.filename = "\\".join(image.relative_to(images).parts)
            file.writestr(info, image.read_bytes())
    assert load_dataset(path).hash == load_dataset(images).hash


@pytest.mark.parametrize(
    "name", ["/cat/0.png", "../cat/0.png", "cat/../../0.png", "C:/cat/0.png", "cat/a\nb.png", "/"]
)
def test_a_zip_file_with_a_trick_in_a_name(images: Path, tmp_path: Path, name: str) -> None:
    path = pack(images, tmp_path / "a.zip")
    with zipfile.ZipFile(path, "a") as file:
        info = zipfile.ZipInfo("x")
        info.filename = name
        file.writestr(info, (images / "cat" / "000.png").read_bytes())
    with pytest.raises(InputError) as error:
        load_dataset(path)
    one_line(error, str(path), "no honest zip file", ascii(name))


def test_a_zip_file_with_a_name_twice(images: Path, tmp_path: Path) -> None:
    path = pack(images, tmp_path / "a.zip")
    with zipfile.ZipFile(path, "a") as file, pytest.warns(UserWarning, match="Duplicate"):
        file.write(images / "cat" / "000.png", "cat/000.png")
    with pytest.raises(InputError) as error:
        load_dataset(path)
    one_line(error, "cat/000.png twice")


def peak_memory(code: str) -> float:
    """Peak resident memory in MB of a Python process that runs this code."""
    code += "\nprint(open('/proc/self/status').read())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return int(done.stdout.split("VmHWM:")[1].split()[0]) / 1e3


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads Linux's /proc")
def test_bombs_in_a_zip_file_cost_no_memory(images: Path, tmp_path: Path) -> None:
    honest = pack(images, tmp_path / "honest.zip")
    plain = peak_memory(f"import deepfsi; deepfsi.load_dataset({str(honest)!r})")

    declared = pack(images, tmp_path / "declared.zip", compression=zipfile.ZIP_DEFLATED)
    with zipfile.ZipFile(declared, "a") as file, file.open("cat/zeros.png", "w") as entry:
        for _ in range(300):
            entry.write(bytes(2**20))
    lying = tmp_path / "lying.zip"
    size = (300 * 2**20).to_bytes(4, "little")
    assert declared.read_bytes().count(size) >= 1
    lying.write_bytes(declared.read_bytes().replace(size, (1000).to_bytes(4, "little")))
    huge = pack(images, tmp_path / "huge.zip")
    with zipfile.ZipFile(huge, "a") as file:
        file.writestr("cat/huge.png", HUGE_PNG)
    for path, part in ((declared, "unpacks to 315 MB"), (lying, "cannot read"), (huge, "bomb")):
        attempt = (
            "import deepfsi\ntry: deepfsi.load_dataset(%r, size=8)\n"
            "except deepfsi.InputError as error: assert %r in str(error), error\n"
            "else: assert False"
        )
        assert peak_memory(attempt % (str(path), part)) < plain + 40


def png_of(height: int, width: int) -> bytes:
    """The head of a PNG file that declares a size, and a little of its data."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        length = len(content).to_bytes(4, "big")
        return length + kind + content + zlib.crc32(kind + content).to_bytes(4, "big")

    sides = width.to_bytes(4, "big") + height.to_bytes(4, "big")
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", sides + bytes([8, 0, 0, 0, 0]))
        + chunk(b"IDAT", zlib.compress(bytes(10_000)))
        + chunk(b"IEND", b"")
    )


HUGE_PNG = png_of(60_000, 60_000)


def test_zip_files_that_cannot_be_read(images: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    whole = pack(images, path).read_bytes()
    entry = whole.index(b"\x89PNG")
    for content, part in (
        (b"", "as a zip file"),
        (b"no zip file", "as a zip file"),
        (whole[: len(whole) // 2], "as a zip file"),
        (whole[: entry + 30] + b"\0\0\0" + whole[entry + 33 :], "000.png (Bad CRC-32"),
    ):
        path.write_bytes(content)
        with pytest.raises(InputError) as error:
            load_dataset(path)
        one_line(error, str(path), part)
    for method in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        pack(images, path, compression=method)
        with pytest.raises(InputError) as error:
            load_dataset(path)
        one_line(error, "cat/000.png", "unusual way")
    encrypted = bytearray(whole)
    at = whole.index(b"PK\x01\x02", whole.index(b"cat/000.png", entry + 50) - 60)
    encrypted[at + 8] |= 1
    path.write_bytes(encrypted)
    with pytest.raises(InputError) as error:
        load_dataset(path)
    one_line(error, "cat/000.png", "encrypted")


def test_zip_files_without_classes(images: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("a.png", HUGE_PNG)
    with pytest.raises(InputError) as error:
        load_dataset(path)
    one_line(error, str(path), "no sub-folders")
    pack(images, path)
    with zipfile.ZipFile(path, "a") as file:
        file.writestr("eel/notes.txt", "none yet")
    with pytest.raises(InputError) as error:
        load_dataset(path)
    one_line(error, f"{path}/eel", "no images")


# ---------------------------------------------------------------- .npz files


def test_npz(tmp_path: Path) -> None:
    path = tmp_path / "leaves.npz"
    np.savez(path, x=X, y=Y)
    data = load_dataset(path)
    assert data.name == "leaves"
    assert data.hash == from_arrays(X, Y).hash != load_dataset(path, seed=5).hash
    np.savez_compressed(path, x=X, y=Y, x_test=X[:5], y_test=Y[:5])
    assert numbers(load_dataset(str(path)).x_test) == list(range(5))


@pytest.mark.parametrize(
    ("arrays", "parts"),
    [
        ({"X": X, "labels": Y}, ("holds X, labels", "give x and y")),
        ({}, ("holds nothing", "give x and y")),
        ({"x": X, "y": Y, "X_test": X, "Y_test": Y}, ("X_test", "no other names")),
        ({"x": X, "y": Y, "x_test": X}, ("only one of x_test and y_test",)),
        ({"x": X, "y": Y[:4]}, ("(4,)", "30 scenes")),
        ({"x": X[0, 0], "y": Y}, ("scenes: x has shape (4,)",)),
        ({"x": spoil(-1), "y": Y}, ("scenes: x reaches from -1",)),
        ({"x": X, "y": Y.astype(object)}, ("cannot read", "Object arrays", "plain arrays")),
    ],
)
def test_bad_npz(arrays: dict[str, Array], parts: tuple[str, ...], tmp_path: Path) -> None:
    np.savez(tmp_path / "scenes.npz", allow_pickle=True, **arrays)
    with pytest.raises(InputError) as error:
        load_dataset(tmp_path / "scenes.npz")
    one_line(error, "scenes", *parts)


def test_damaged_npz(tmp_path: Path) -> None:
    path = tmp_path / "scenes.npz"
    np.savez_compressed(path, x=X, y=Y)
    whole = path.read_bytes()
    flipped = whole[:400] + bytes(255 - b for b in whole[400:420]) + whole[420:]
    for content, part in (
        (whole[: len(whole) // 2], "no .npz file, or not all of one"),
        (b"", "no .npz file"),
        (pickle.dumps({"x": X, "y": Y}), "no .npz file"),
        (flipped, "cannot read"),
        (whole.replace(b"PK\x01\x02", b"PK\x09\x09"), "cannot read"),
        (b"\x80\x04" + whole, "cannot read"),
    ):
        path.write_bytes(content)
        with pytest.raises(InputError) as error:
            load_dataset(path)
        one_line(error, "scenes.npz", part)


def test_no_pickle_is_ever_opened(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
            return (Path.touch, (tmp_path / "sprung",))

    trap = np.full(30, None)
    trap[0] = Trap()
    np.savez(tmp_path / "trap.npz", allow_pickle=True, x=X, y=trap)
    with pytest.raises(InputError):
        load_dataset(tmp_path / "trap.npz")
    assert not (tmp_path / "sprung").exists()


# ---------------------------------------------------------------- idx files, mirrors, cache


def idx_file(array: Array) -> bytes:
    header = bytes([0, 0, 8, array.ndim]) + np.array(array.shape, ">u4").tobytes()
    return gzip.compress(header + array.astype(np.uint8).tobytes(), mtime=0)


TINY_IMAGES = np.random.default_rng(4).integers(0, 256, (24, 28, 28), dtype=np.uint8)
TINY_LABELS = np.arange(24) % 10
TINY = dict(
    zip(
        idx.IDX_FILES,
        (
            idx_file(TINY_IMAGES[:20]),
            idx_file(TINY_LABELS[:20]),
            idx_file(TINY_IMAGES[20:]),
            idx_file(TINY_LABELS[20:]),
        ),
        strict=True,
    )
)


class Mirrors:
    """Two folders served on this machine as the mirrors of a tiny MNIST; counts the requests."""

    def __init__(self, folder: Path) -> None:
        self.first, self.second = folder / "first", folder / "second"
        self.first.mkdir()
        self.second.mkdir()
        self.requests: list[str] = []
        requests = self.requests

        class Handler(http.server.SimpleHTTPRequestHandler):
            def __init__(self, *args: Any) -> None:
                super().__init__(*args, directory=str(folder))

            def log_request(self, *_: object) -> None:
                requests.append(self.path)

            def log_message(self, *_: object) -> None: ...

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.urls = tuple(
            f"http://127.0.0.1:{self.server.server_port}/{mirror}/"
            for mirror in ("first", "second")
        )
        threading.Thread(target=self.server.serve_forever, args=(0.01,), daemon=True).start()


def fill(folder: Path, **spoilt: bytes) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for file, content in (TINY | spoilt).items():
        (folder / file).write_bytes(content)


@pytest.fixture
def mirrors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Mirrors]:
    """A tiny MNIST with empty mirrors and an empty cache, `tmp_path / "cache"`."""
    (tmp_path / "served").mkdir()
    served = Mirrors(tmp_path / "served")
    hashes = tuple(f"sha256:{hashlib.sha256(content).hexdigest()}" for content in TINY.values())
    tiny = idx.ORIGINALS["mnist"]._replace(mirrors=served.urls, hashes=hashes)
    monkeypatch.setitem(idx.ORIGINALS, "mnist", tiny)
    monkeypatch.setattr(pooch, "os_cache", lambda _: tmp_path / "cache")
    monkeypatch.delenv("DEEPFSI_DATA", raising=False)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    yield served
    served.server.shutdown()
    served.server.server_close()


def assert_tiny(data: Dataset) -> None:
    assert data.image_shape == (32, 32)
    assert data.classes == tuple("0123456789")
    framed = np.zeros((24, 32, 32))
    framed[:, 2:-2, 2:-2] = TINY_IMAGES / 255
    expected = (0.3 + 0.7 * framed).reshape(24, 1024)
    assert np.allclose(data.x_train, expected[:20], atol=1e-6), "in the order of the files"
    assert np.allclose(data.x_test, expected[20:], atol=1e-6)
    assert data.x_train.dtype == np.float32
    assert data.y_train.dtype == np.int64
    assert np.array_equal(np.r_[data.y_train, data.y_test], TINY_LABELS)
    assert data.x_train.max() <= 1
    assert data.x_train.min() == np.float32(0.3)


def test_files_are_downloaded_once(
    mirrors: Mirrors,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pooch.get_logger(), "handlers", [caplog.handler])
    fill(mirrors.first)
    assert_tiny(load_dataset("mnist"))
    assert mirrors.requests == [f"/first/{file}" for file in TINY]
    assert_tiny(load_dataset("mnist"))
    assert len(mirrors.requests) == 4
    assert download("mnist") == tmp_path / "cache" / "mnist"
    assert not caplog.records


def test_the_next_mirror_is_tried(mirrors: Mirrors) -> None:
    fill(mirrors.second)
    fill(mirrors.first, **{idx.IDX_FILES[0]: b"damaged on the way"})
    (mirrors.first / idx.IDX_FILES[1]).unlink()
    assert_tiny(load_dataset("mnist"))
    assert [path.split("/")[1] for path in mirrors.requests] == [
        *("first", "second"),
        *("first", "second"),
        *("first", "first"),
    ]


def test_no_mirror_gives_a_file(mirrors: Mirrors, tmp_path: Path) -> None:
    fill(mirrors.first, **{idx.IDX_FILES[2]: b"damaged"})
    with pytest.raises(InputError) as error:
        load_dataset("mnist")
    host = f"127.0.0.1:{mirrors.server.server_port}"
    one_line(
        error,
        f"mnist: cannot download {idx.IDX_FILES[2]}",
        f"{host} (wrong hash) or {host} (HTTPError)",
        "set DEEPFSI_DATA",
    )
    kept = sorted(path.name for path in (tmp_path / "cache" / "mnist").iterdir())
    assert kept == sorted(idx.IDX_FILES[:2]), "nothing half-written"


def test_no_connection(mirrors: Mirrors) -> None:
    mirrors.server.shutdown()
    mirrors.server.server_close()
    with pytest.raises(InputError) as error:
        download("mnist")
    one_line(error, "mnist", "127.0.0.1", "(ConnectionError)", "set DEEPFSI_DATA")


def test_a_damaged_file_in_the_cache_is_downloaded_again(mirrors: Mirrors, tmp_path: Path) -> None:
    fill(mirrors.first)
    fill(tmp_path / "cache" / "mnist", **{idx.IDX_FILES[3]: b"damaged"})
    assert_tiny(load_dataset("mnist"))
    assert mirrors.requests == [f"/first/{idx.IDX_FILES[3]}"]


def test_deepfsi_data_comes_first_and_needs_the_folder(
    mirrors: Mirrors, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path / "mine"))
    fill(tmp_path / "mine")
    with pytest.raises(InputError):
        load_dataset("mnist")
    assert mirrors.requests, "files directly in DEEPFSI_DATA are not used"
    mirrors.requests.clear()
    fill(tmp_path / "mine" / "mnist")
    assert_tiny(load_dataset("mnist"))
    assert download("mnist") == tmp_path / "mine" / "mnist"
    assert not mirrors.requests


def test_a_damaged_file_in_deepfsi_data(
    mirrors: Mirrors, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path))
    fill(tmp_path / "mnist", **{idx.IDX_FILES[1]: idx_file(TINY_LABELS[1:21])})
    with pytest.raises(InputError) as error:
        load_dataset("mnist")
    one_line(error, str(tmp_path / "mnist" / idx.IDX_FILES[1]), "sha256", "original")
    assert [result.ok for result in check("mnist")] == [True, False, True, True]


def test_deepfsi_data_that_is_no_folder(
    mirrors: Mirrors, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path / "mistyped"))
    with pytest.raises(InputError) as error:
        load_dataset("mnist")
    one_line(error, "DEEPFSI_DATA", "mistyped", "no folder")


@pytest.mark.parametrize(
    "content",
    [
        gzip.compress(gzip.decompress(TINY[idx.IDX_FILES[0]])[:-1]),
        gzip.compress(gzip.decompress(TINY[idx.IDX_FILES[0]]) + b"x"),
        gzip.compress(gzip.decompress(TINY[idx.IDX_FILES[0]])[:10]),
        gzip.compress(b"\0\0\x0d" + gzip.decompress(TINY[idx.IDX_FILES[0]])[3:]),
        TINY[idx.IDX_FILES[1]],
        TINY[idx.IDX_FILES[0]][:-20],
        b"\x1f\x8b\x08\0\0\0\0\0\0\0 not deflated at all",
        b"not gzipped",
        b"",
    ],
    ids=["short", "long", "header", "type", "labels", "cut", "deflate", "no gzip", "empty"],
)
def test_bad_idx(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "images.gz"
    path.write_bytes(content)
    with pytest.raises(InputError) as error:
        idx._read_idx(path, 3)
    one_line(error, str(path), "replace it with the original")


def test_check_and_list(mirrors: Mirrors, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    where = {info.name: info.where for info in list_datasets()}
    assert where.pop("digits") == "embedded"
    assert len(where) == 7
    assert set(where.values()) == {"not here"}
    assert [(result.file, result.ok) for result in check("mnist")] == [
        (file, False) for file in idx.IDX_FILES
    ]
    assert "No such file" in check("mnist")[0].detail
    assert check("digits")[0].ok

    fill(tmp_path / "cache" / "mnist")
    assert list_datasets()[1].where == str(tmp_path / "cache" / "mnist")
    assert all(result.ok for result in check("mnist"))
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path))
    fill(tmp_path / "mnist")
    assert list_datasets()[1].where == str(tmp_path / "mnist")
    assert not mirrors.requests


def test_list_tells_the_truth_about_digits() -> None:
    data, info = load_dataset("digits"), list_datasets()[0]
    assert info.images == len(data.x_train) + len(data.x_test)
    assert (info.pixels, info.classes) == (data.pixels, len(data.classes))


@pytest.mark.parametrize("action", [check, download])
def test_unknown_name_to_check_or_download(action: Callable[[str], object]) -> None:
    with pytest.raises(InputError) as error:
        action("fashion")
    one_line(error, "unknown data set 'fashion'", "'fashion-mnist'?")


def test_digits_need_no_download() -> None:
    with pytest.raises(InputError) as error:
        download("digits")
    one_line(error, "digits", "embedded")


def test_a_slow_download_shows_its_progress(capsys: pytest.CaptureFixture[str]) -> None:
    progress = store._Progress("images.gz")
    progress.total = 4_000_000
    progress.update(1_000_000)
    progress.close()
    assert capsys.readouterr().err == ""
    progress.due -= 3
    progress.update(1_000_000)
    progress.close()
    progress.close()
    assert capsys.readouterr().err == "\rimages.gz: 2.0 of 4.0 MB\n"


def test_progress_that_breaks_off_ends_its_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def break_off(*_: object, progressbar: store._Progress) -> None:
        progressbar.due -= 3
        progressbar.update(10)
        raise ConnectionError

    monkeypatch.setattr(pooch, "retrieve", break_off)
    with pytest.raises(InputError):
        store.retrieve("mnist", "images.gz", "sha256:0", ("http://here/",))
    assert capsys.readouterr().err.endswith("MB\n")


@real_mnist
def test_mnist() -> None:
    data = load_dataset("mnist")
    assert data.x_train.shape == (60_000, 1024)
    assert data.x_test.shape == (10_000, 1024)
    assert data.image_shape == (32, 32)
    assert data.hash == MNIST_HASH
    assert data.y_train[:5].tolist() == [5, 0, 4, 1, 9]
    assert data.y_test[:3].tolist() == [7, 2, 1]
    counts = [5923, 6742, 5958, 6131, 5842, 5421, 5918, 6265, 5851, 5949]
    assert np.bincount(data.y_train).tolist() == counts
    assert data.x_train.min() == np.float32(0.3)
    assert data.x_train.max() == 1
    inside = (data.x_train.mean(dtype=float) - 0.3) / 0.7 * (32 / 28) ** 2
    assert inside == pytest.approx(0.1307, abs=1e-4)
    assert (data.x_train.reshape(-1, 32, 32)[:, :2] == np.float32(0.3)).all()
    held = data.hold_out()
    assert held.x_test.shape == (10_000, 1024)
    assert held.y_test[-1] == data.y_train[-1]
    assert all(result.ok for result in check("mnist"))
    info = list_datasets()[1]
    assert (info.images, info.pixels, info.classes) == (70_000, 1024, 10)
    assert info.where == str(Path(os.environ["DEEPFSI_DATA"]) / "mnist")

"""Arrays become scenes in [0, 1] with fair splits; bad ones give one clear line."""

import io
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_samples import X, Y, numbers, refused, scenes

from deepfsi.base import InputError
from deepfsi.datasets import arrays, from_arrays, load_dataset
from deepfsi.datasets.arrays import draw_stratified


def test_arrays_are_divided_into_stratified_parts_that_share_no_scene():
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
def test_the_seed_decides(own_test):
    x, y = scenes()
    rest = (x, y) if own_test else ()
    first, again, other = (numbers(from_arrays(x, y, *rest, seed=s).x_train) for s in (3, 3, 4))
    assert first == again != other


def test_a_test_part_of_its_own_keeps_its_order_and_the_training_part_is_shuffled():
    x, y = scenes()
    data = load_dataset((x, y, x[:7], y[:7]))
    assert numbers(data.x_test) == list(range(7))
    assert data.y_test.tolist() == y[:7].tolist()
    order = numbers(data.x_train)
    assert sorted(order) == list(range(30)) != order
    assert data.y_train.tolist() == y[order].tolist()


def test_spectra_keep_their_bands():
    data = load_dataset(scenes(shape=(12,)))
    assert data.image_shape == (12,)
    assert data.pixels == 12


def test_bytes_are_divided_by_255():
    x = np.zeros((30, 2, 2), np.uint8)
    x[:, 0, 0], x[:, 0, 1] = 255, 51
    data = from_arrays(x, scenes()[1])
    assert data.x_train[0].tolist() == pytest.approx([1, 0.2, 0, 0])
    assert data.preprocessing == "Uint8 values from 0 to 255, divided by 255."


@pytest.mark.parametrize(
    ("dtype", "largest", "white"),
    [
        ("u2", 200, 255), ("u2", 255, 255), ("u2", 256, 1023), ("u2", 3971, 4095),
        ("u2", 16383, 16383), ("u2", 65535, 65535), ("i2", 4096, 16383), ("i8", 255, 255),
        ("i8", 1, 1), ("u4", 2**20, 2**24 - 1), ("i8", 2**32 - 1, 2**32 - 1), ("i1", 127, 255),
    ],
)  # fmt: skip
def test_integers_are_divided_by_the_fewest_bits_that_hold_them(dtype, largest, white):
    x = np.zeros((30, 2, 2), dtype)
    x[:, 0, 0] = largest
    x[0, 0, 1] = largest // 3
    data = from_arrays(x, Y)
    every = np.r_[data.x_train, data.x_test]
    assert every[:, 0] == pytest.approx(largest / white)
    assert every.max(axis=0)[1] == pytest.approx(largest // 3 / white)
    assert data.white == white
    assert f"from 0 to {largest:.4g}, " in data.preprocessing
    assert white == 1 or f"divided by {white} ({white.bit_length()} bits)" in data.preprocessing


def test_training_and_test_scenes_share_one_white():
    x = np.full((30, 4), 200, np.uint16)
    data = from_arrays(x, Y, 5 * x[:3], Y[:3])
    assert data.x_train.max() == pytest.approx(200 / 1023)
    assert data.x_test.max() == pytest.approx(1000 / 1023)


def test_a_white_that_is_told_holds(tmp_path):
    x = np.full((30, 4), 900, np.uint16)
    np.savez(tmp_path / "dim.npz", x=x, y=Y)
    for source in ((x, Y), tmp_path / "dim.npz"):
        data = load_dataset(source, white=4095)
        assert data.x_train.max() == pytest.approx(900 / 4095)
        assert data.white == 4095
        with refused("up to 900, above white, 899"):
            load_dataset(source, white=899)
    with refused("digits: a white was given"):
        load_dataset("digits", white=16)


def test_truth_values_are_black_and_white():
    data = from_arrays(X > 0.5, Y)
    assert set(np.unique(data.x_train)) == {0, 1}
    assert data.white is None


@pytest.mark.parametrize("dtype", ["u1", "u2", "i8", "f4", "f8", "?"])
def test_colours_of_arrays_turn_grey_by_their_luma(dtype):
    white = {"f4": 1, "f8": 1, "?": 1, "u1": 255}.get(dtype, 4095)
    x = np.zeros((30, 2, 2, 3), dtype)
    x[:, 0, 0], x[:, 0, 1, 0], x[:, 1, 0, 1], x[:, 1, 1, 2] = white, white, white, white
    data = from_arrays(x, Y)
    assert data.image_shape == (2, 2)
    assert data.x_train[0] == pytest.approx([1, 0.299, 0.587, 0.114], abs=0.5 / min(white, 255))
    assert "colours turned to grey" in data.preprocessing
    seen = np.concatenate([x, np.full((30, 2, 2, 1), white, dtype)], axis=3)
    assert from_arrays(seen, Y).hash == data.hash, "transparency is left out"
    assert from_arrays(x[..., :1], Y).image_shape == (2, 2)


def test_rescale_maps_the_ends_exactly_and_stays_in_range():
    x, y = scenes()
    x[:, 1, 0], x[:, 1, 1], x[:, 1, 2] = 0, 1, 0.5
    data = from_arrays(x, y, rescale=(0.3, 1))
    assert data.x_train[0, 4:7].tolist() == pytest.approx([0.3, 1, 0.65])
    assert data.x_train.max() == 1
    assert data.x_train.min() == np.float32(0.3)
    assert data.preprocessing == (
        "Float64 values from 0 to 1, as given, then mapped from [0, 1] to [0.3, 1]."
    )
    assert x[0, 1, 0] == 0, "the caller's array is left alone"


def test_rounding_of_a_scaler_is_forgiven_and_removed():
    x, y = scenes()
    x[0, 1, 1], x[1, 1, 1] = 1 + 1e-15, -1e-17
    data = from_arrays(x, y, x, y)
    assert data.x_test.max() == 1
    assert data.x_test.min() >= 0


def test_string_labels_become_sorted_classes():
    x, y = scenes()
    words = np.array(["oak", "ash", "yew"])[y]
    for labels in (words, words.astype(object)):
        data = from_arrays(x, labels, x, labels)
        assert data.classes == ("ash", "oak", "yew")
        assert [data.classes[k] for k in data.y_test] == words.tolist()


def test_integer_labels_need_not_count_from_zero():
    x, y = scenes()
    data = from_arrays(x, y * 5 - 3, x, y * 5 - 3)
    assert data.classes == ("-3", "2", "7")
    assert data.y_test.tolist() == y.tolist()


def test_given_classes_fix_names_and_order():
    x, y = scenes()
    names = ("oak", "ash", "yew")
    for labels in (y, np.array(names)[y]):
        data = from_arrays(x, labels, x, labels, classes=names)
        assert data.classes == names
        assert data.y_test.tolist() == y.tolist()


def spoil(value):
    x, _ = scenes()
    x[4, 1, 1] = value
    return x


BAD_ARRAYS: dict[str, tuple[tuple[Any, ...], tuple[str, ...]]] = {
    "NaN": ((spoil(np.nan), Y), ("arrays: x holds NaN",)),
    "infinite": ((spoil(np.inf), Y), ("arrays: x holds NaN or infinite",)),
    "negative": ((spoil(-0.25), Y), ("from -0.25", "[0, 1]")),
    "above one": ((spoil(1.5), Y), ("to 1.5", "[0, 1]")),
    "negative integers": ((X.astype(int) - 3, Y), ("from -3", "subtract the offset")),
    "huge integers": ((np.full((30, 4), 2**40), Y), ("2**32 - 1",)),
    "objects": ((np.full((30, 4), None), Y), ("object", "integers")),
    "complex": ((X * 1j, Y), ("complex128", "integers")),
    "colours first": ((np.ones((30, 3, 8, 8)), Y), ("(30, 3, 8, 8)", "(n, H, W, 3)")),
    "bytes and floats": (
        ((255 * X).astype(np.uint8), Y, X, Y),
        ("x uint8 and arrays: x_test float64", "one type"),
    ),
    "no scenes": ((np.ones((0, 4)), Y[:0]), ("(0, 4)",)),
    "no pixels": ((np.ones((30, 0)), Y), ("(30, 0)",)),
    "dark": ((X * 0, Y), ("dark",)),
    "lengths": ((X, Y[:-1]), ("(29,)", "30 scenes")),
    "labels in two dimensions": ((X, Y.reshape(15, 2)), ("(15, 2)", "30 scenes")),
    "values of other scenes": ((X, Y[:-1] / 2), ("(29,)", "30 scenes")),
    "values without a limit": ((X, np.where(Y, np.inf, 1.0)), ("finite",)),
    "one value of all": ((X, Y * 0.0), ("the same of all",)),
    "values in one part": ((X, Y / 2, X, np.ones((30, 2))), ("2 of a test scene",)),
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
def test_bad_arrays(case):
    arrays, parts = BAD_ARRAYS[case]
    with refused(*parts):
        from_arrays(*arrays)


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
def test_bad_options(options, part):
    with refused(part):
        from_arrays(X, Y, **options)


def test_a_class_without_training_scenes_where_the_test_part_is_given():
    with refused("class 'd' has no training scenes"):
        from_arrays(X, Y, X, Y, classes=("a", "b", "c", "d"))


def test_shares_of_unequal_classes():
    labels = np.repeat([0, 1, 2], [80, 15, 5])
    drawn = draw_stratified(labels, 20, 0, "a")
    assert np.bincount(labels[drawn]).tolist() == [16, 3, 1]
    assert len(set(drawn)) == 20
    assert set(labels[draw_stratified(labels, 3, 0, "a")]) == {0, 1, 2}


def test_npz(tmp_path):
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
def test_bad_npz(arrays, parts, tmp_path):
    np.savez(tmp_path / "scenes.npz", allow_pickle=True, **arrays)
    with refused("scenes", *parts):
        load_dataset(tmp_path / "scenes.npz")


def test_an_npz_file_larger_than_the_memory_is_refused_unread(tmp_path, monkeypatch):
    path = tmp_path / "scenes.npz"
    np.savez_compressed(path, x=np.zeros((4, 10_000)), y=[0, 0, 1, 1])
    assert path.stat().st_size < 10_000
    monkeypatch.setattr("deepfsi.base.numeric.arrays.free_memory", lambda: 1e5)
    monkeypatch.setattr(np, "load", None)
    with pytest.raises(InputError, match=r"need 0\.00032 GB of memory"):
        load_dataset(path)


def test_an_npz_file_that_claims_too_much_is_one_line(tmp_path):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f8", "fortran_order": False, "shape": (10**14,)}
    )
    with zipfile.ZipFile(tmp_path / "scenes.npz", "w") as members:
        for name in ("x", "y"):
            members.writestr(f"{name}.npy", header.getvalue())
    with pytest.raises(InputError, match="cannot read"):
        load_dataset(tmp_path / "scenes.npz")


def test_damaged_npz(tmp_path):
    path = tmp_path / "scenes.npz"
    np.savez_compressed(path, x=X, y=Y)
    whole = path.read_bytes()
    flipped = whole[:400] + bytes(255 - b for b in whole[400:420]) + whole[420:]
    for content, part in (
        (whole[: len(whole) // 2], "as a zip file"),
        (b"", "as a zip file"),
        (pickle.dumps({"x": X, "y": Y}), "as a zip file"),
        (flipped, "cannot read"),
        (whole.replace(b"PK\x01\x02", b"PK\x09\x09"), "cannot read"),
    ):
        path.write_bytes(content)
        with refused("scenes.npz", part):
            load_dataset(path)


def test_no_pickle_is_ever_opened(tmp_path):
    class Trap:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "sprung",))

    trap = np.full(30, None)
    trap[0] = Trap()
    np.savez(tmp_path / "trap.npz", allow_pickle=True, x=X, y=trap)
    with pytest.raises(InputError):
        load_dataset(tmp_path / "trap.npz")
    assert not (tmp_path / "sprung").exists()


def test_arrays_that_memory_does_not_hold_are_refused_before_they_are_copied(monkeypatch):
    x, y = np.full((20, 4, 5), 9, np.uint8), np.arange(20) % 2
    monkeypatch.setattr(arrays, "free_memory", lambda: 8 * x.size - 1)
    with pytest.raises(InputError, match=r"20 scenes of \(4, 5\) values need .* GB are free"):
        from_arrays(x, y)
    monkeypatch.setattr(arrays, "free_memory", lambda: 8 * x.size)
    assert from_arrays(x, y).pixels == 20


@pytest.mark.parametrize(
    ("y", "said"),
    [
        (Y.astype(float), "whole numbers written as floats (0, 1, 2): if they are classes, give"),
        (Y.astype(np.float16)[:, None], "whole numbers written as floats"),
        (np.eye(3)[Y], "a single 1 in each row, as of classes in one-hot form"),
        (np.ma.masked_equal(Y, 1), "y hides 10 values under a mask"),
        (np.ma.masked_less(Y / 7, 0.1), "y hides 10 values under a mask"),
    ],
)
def test_labels_as_other_programs_save_them_are_no_values(y, said):
    with refused(said):
        from_arrays(X, y)


def test_values_stay_values():
    """Names make whole numbers values; so do fractions, and numbers of too few scenes each."""
    named = from_arrays(X, Y.astype(float), values=["row"])
    assert (named.values, named.classes) == (("row",), ())
    for y in (Y + 0.5, np.arange(30.0), np.stack([Y, 2 - Y], axis=1) * 1.0, np.eye(3)[Y] * 0.5):
        assert from_arrays(X, y).values


@pytest.mark.parametrize("y", [Y[:, None], Y[None], [f"{k} " for k in Y], Y.astype(">u2")])
def test_vectors_of_labels_are_read_as_matlab_has_them(y):
    assert from_arrays(X, y).hash == from_arrays(X, Y).hash


def test_a_mask_of_scenes_is_refused():
    with refused("x hides 1 values under a mask"):
        from_arrays(np.ma.masked_equal(X, X.max()), Y)

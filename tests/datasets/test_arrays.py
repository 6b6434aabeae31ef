"""Arrays become scenes in [0, 1] with fair splits; bad ones give one clear line."""

from pathlib import Path

import numpy as np
import pytest
import torch
from dataset_samples import X, Y, not_loaded, numbers, refused

from deepfsi import InputError
from deepfsi.datasets import arrays
from deepfsi.datasets.arrays import from_arrays
from deepfsi.datasets.load import load_dataset


def test_arrays_are_divided_into_stratified_parts_that_share_no_scene():
    data = from_arrays(X, Y)
    assert data.x_train.shape == (24, 12)
    assert data.x_train.dtype == data.x_test.dtype == np.float32
    assert data.y_train.dtype == data.y_test.dtype == np.int64
    assert data.pixels == 12
    assert data.image_shape == (3, 4)
    assert np.bincount(data.y_train).tolist() == [8, 8, 8]
    assert np.bincount(data.y_test).tolist() == [2, 2, 2]
    train, test = numbers(data.x_train), numbers(data.x_test)
    assert sorted(train + test) == list(range(30))
    assert train != sorted(train)
    for part_x, part_y, part in (
        (data.x_train, data.y_train, train),
        (data.x_test, data.y_test, test),
    ):
        assert np.array_equal(part_x, X[part].reshape(-1, 12).astype(np.float32))
        assert np.array_equal(part_y, Y[part])


def test_a_test_part_of_its_own_keeps_its_order_and_the_training_part_is_shuffled():
    data = load_dataset((X, Y, X[:7], Y[:7]))
    assert load_dataset((X, Y, X[:7], Y[:7]), seed=1).hash != data.hash
    assert numbers(data.x_test) == list(range(7))
    assert data.y_test.tolist() == Y[:7].tolist()
    order = numbers(data.x_train)
    assert sorted(order) == list(range(30)) != order
    assert data.y_train.tolist() == Y[order].tolist()


@pytest.mark.parametrize(
    ("dtype", "largest", "white"),
    [
        ("u2", 200, 255), ("u2", 255, 255), ("u2", 256, 1023), ("u2", 3971, 4095),
        ("u2", 16383, 16383), ("u2", 65535, 65535), ("i2", 4096, 16383), ("i8", 255, 255),
        ("i8", 1, 1), ("u4", 2**20, 2**24 - 1), ("i8", 2**32 - 1, 2**32 - 1), ("i1", 127, 255),
        ("u1", 200, 255), ("?", 1, 1),
    ],
)  # fmt: skip
def test_integers_are_divided_by_the_fewest_bits_that_hold_them(dtype, largest, white):
    """Bytes always by 255, and truth values are black and white."""
    x = np.zeros((30, 2, 2), dtype)
    x[:, 0, 0] = largest
    x[0, 0, 1] = largest // 3
    data = from_arrays(x, Y)
    every = np.r_[data.x_train, data.x_test]
    assert every[:, 0] == pytest.approx(largest / white)
    assert every.max(axis=0)[1] == pytest.approx(largest // 3 / white)
    assert data.white == (None if dtype in ("u1", "?") else white)
    bits = f" ({white.bit_length()} bits)" if data.white else ""
    done = "as given" if white == 1 else f"divided by {white}{bits}"
    assert f"from 0 to {largest:.4g}, {done}" in data.preprocessing


def test_a_white_that_is_told_holds(tmp_path):
    x = np.full((30, 4), 900, np.uint16)
    np.savez(tmp_path / "dim.npz", x=x, y=Y)
    source = tmp_path / "dim.npz"
    data = load_dataset(source, white=4095)
    assert data.x_train.max() == pytest.approx(900 / 4095)
    assert data.white == 4095
    not_loaded(source, "to 900; values are allowed from 0 to 899", white=899)
    not_loaded("digits", "digits takes no `white`", white=16)


def test_rescale_maps_the_ends_exactly_and_stays_in_range():
    """Also values that the rounding of a scaler has moved out of [0, 1]."""
    x = X.copy()
    x[:, 1, 0], x[:, 1, 1], x[:, 1, 2] = -1e-17, 1 + 1e-15, 0.5
    data = from_arrays(x, Y, rescale=(0.3, 1))
    assert data.x_train[0, 4:7].tolist() == pytest.approx([0.3, 1, 0.65])
    assert data.x_train.max() == from_arrays(x, Y).x_test.max() == 1
    assert data.x_train.min() == np.float32(0.3)
    assert from_arrays(x, Y).x_test.min() >= 0
    assert data.preprocessing.endswith(", then mapped from [0, 1] to [0.3, 1].")
    assert x[0, 1, 2] == 0.5, "the caller's array is left alone"


WORDS = np.array(["oak", "ash", "yew"])


@pytest.mark.parametrize(
    ("labels", "options", "classes", "first"),
    [
        (WORDS[Y], {}, ("ash", "oak", "yew"), WORDS),
        (WORDS[Y].astype(object), {}, ("ash", "oak", "yew"), WORDS),
        (Y * 5 - 3, {}, ("-3", "2", "7"), ("-3", "2", "7")),
        (Y, {"classes": tuple(WORDS)}, tuple(WORDS), WORDS),
        (WORDS[Y], {"classes": tuple(WORDS)}, tuple(WORDS), WORDS),
    ],
)
def test_classes_are_sorted_labels_or_those_that_are_given(labels, options, classes, first):
    data = from_arrays(X, labels, X, labels, **options)
    assert data.classes == classes
    assert [data.classes[k] for k in data.y_test] == [first[k] for k in Y]


def spoil(value):
    x = X.copy()
    x[4, 1, 1] = value
    return x


def given(*arrays, **options):
    return arrays, options


BAD_ARRAYS = {
    "NaN": (given(spoil(np.nan), Y), ("arrays: x reaches from nan",)),
    "negative": (given(spoil(-0.25), Y), ("from -0.25", "from 0 to 1:")),
    "huge integers": (given(np.full((30, 4), 2**40), Y), ("4294967295",)),
    "objects": (given(np.full((30, 4), None), Y), ("object", "integers")),
    "colours first": (given(np.ones((30, 3, 8, 8)), Y), ("(30, 3, 8, 8)", "turn RGB to grey")),
    "bytes and floats": (
        given((255 * X).astype(np.uint8), Y, X, Y),
        ("x uint8 and arrays: x_test float64", "one type"),
    ),
    "no scenes": (given(np.ones((0, 4)), Y[:0]), ("(0, 4)",)),
    "dark": (given(X * 0, Y), ("dark",)),
    "masked": (given(np.ma.masked_greater(X, 0.9), Y), ("hides values under a mask",)),
    "one-hot": (given(X, np.eye(3)[Y]), ("y.argmax(axis=1)",)),
    "lengths": (given(X, Y[:-1]), ("(29,)", "30 scenes")),
    "values without a limit": (given(X, np.where(Y, np.inf, 1.0)), ("finite",)),
    "one value of all": (given(X, Y * 0.0), ("that differ",)),
    "values in one part": (given(X, Y / 2, X, np.ones((30, 2))), ("other numbers of values",)),
    "whole floats": (given(X, Y.astype(float)), ("whole numbers written as floats: if",)),
    "objects as labels": (given(X, Y.astype(object)), ("object", "an integer or a string")),
    "one class": (given(X, Y * 0), ("classes are 0; give", "two classes or more")),
    "few per class": (given(X, np.r_[[9] * 4, [1] * 26]), ("class '9' has 4 scenes", "5 or more")),
    "no y_test": (given(X, Y, X), ("y is object",)),
    "other pixels in test": (given(X, Y, X[:, :2], Y), ("(3, 4) in x", "(2, 4) in x_test")),
    "unknown class in test": (given(X, Y, X, Y + 1), ("holds the label 3", "0, 1, 2")),
    "no range": (given(X, Y, rescale=(0.5, 0.5)), ("rescale (0.5, 0.5)",)),
    "too few names": (given(X, Y, classes=("a", "b")), ("label 2",)),
    "a name twice": (given(X, Y, classes=("a", "b", "a")), ("its own name",)),
    "too many names": (given(X, Y, classes=tuple("abcd")), ("class 'd' has 0 scenes",)),
}


@pytest.mark.parametrize("case", BAD_ARRAYS)
def test_bad_arrays(case):
    (parts_of_data, options), words = BAD_ARRAYS[case]
    with refused(*words):
        from_arrays(*parts_of_data, **options)


def test_shares_of_unequal_classes():
    labels = np.repeat([0, 1, 2], [80, 15, 5])
    drawn, _ = arrays.draw_stratified(labels, 20, 0, "a")
    assert np.bincount(labels[drawn]).tolist() == [16, 3, 1]
    assert len(set(drawn)) == 20
    assert set(labels[arrays.draw_stratified(labels, 3, 0, "a")[0]]) == {0, 1, 2}


@pytest.mark.parametrize(
    ("arrays", "parts"),
    [
        ({"X": X, "labels": Y}, ("holds X, labels", "give x and y")),
        ({"x": X, "y": Y, "X_test": X, "Y_test": Y}, ("X_test", "no other names")),
    ],
)
def test_bad_npz(arrays, parts, tmp_path):
    np.savez(tmp_path / "scenes.npz", **arrays)
    not_loaded(tmp_path / "scenes.npz", "scenes", *parts)


def test_an_npz_file_larger_than_the_memory_is_refused_unread(tmp_path, monkeypatch):
    path = tmp_path / "scenes.npz"
    np.savez_compressed(path, x=np.zeros((4, 10_000)), y=[0, 0, 1, 1])
    assert path.stat().st_size < 10_000
    monkeypatch.setattr("deepfsi.base.arrays.free_memory", lambda: 1e5)
    not_loaded(path, "need 0.00032 GB of memory")


def test_no_pickle_is_ever_opened(tmp_path):
    class Trap:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "sprung",))

    trap = np.full(30, None)
    trap[0] = Trap()
    np.savez(tmp_path / "trap.npz", allow_pickle=True, x=X, y=trap)
    not_loaded(tmp_path / "trap.npz", "cannot read", "Object arrays", "plain arrays")
    assert not (tmp_path / "sprung").exists()


def test_values_stay_values():
    """Names make whole numbers values; so do fractions, and numbers of too few scenes each."""
    named = from_arrays(X, Y.astype(float), values=["row"])
    assert (named.values, named.classes) == (("row",), ())
    for y in (Y + 0.5, np.arange(30.0), np.stack([Y, 2 - Y], axis=1) * 1.0, np.eye(3)[Y] * 0.5):
        assert from_arrays(X, y).values


@pytest.mark.parametrize("y", [Y[:, None], Y[None], [f"{k} " for k in Y], Y.astype(">u2")])
def test_vectors_of_labels_are_read_as_matlab_has_them(y):
    assert from_arrays(X, y).hash == from_arrays(X, Y).hash


def test_tensors_of_a_network_are_arrays():
    """They need gradients, are bfloat16 or sparse; one without values is refused."""
    x, y = torch.rand(60, 8, 8), np.arange(60) % 2
    for scenes in (x.requires_grad_(), x.bfloat16(), x.detach().flatten(1).to_sparse()):
        assert len(from_arrays(scenes, y).x_train) == 48
        assert len(arrays.as_test_part(scenes, y, (8, 8), ("0", "1")).x_test) == 60
    with pytest.raises(InputError, match="x is no array"):
        from_arrays(x.to("meta"), y)

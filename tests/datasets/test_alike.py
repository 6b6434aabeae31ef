"""Copies of a picture are one group, and go to one part; different pictures are their own."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

import deepfsi
from deepfsi.datasets.alike import deal, groups_of_alike
from deepfsi.training.characterisation import folds_of
from shared.pictures import copies_of, save_images


@pytest.fixture(scope="module")
def digits():
    return deepfsi.load_dataset("digits", rescale=(0.0, 1.0))


@pytest.fixture(scope="module")
def copied(digits):
    """Six digits of two classes, each with eight copies: pictures, labels and originals."""
    rows = np.concatenate([np.flatnonzero(digits.y_train == label)[:3] for label in (2, 7)])
    originals = ndimage.zoom(digits.x_train[rows].reshape(-1, 8, 8), (1, 3, 3), order=1)
    return copies_of(originals, 8, seed=4), np.repeat([0, 1], 24), np.repeat(range(6), 8)


def test_copies_are_one_group_and_different_pictures_are_none(digits, copied):
    x, labels, original = copied
    groups = groups_of_alike(x, labels)
    for number in range(6):
        assert np.unique(groups[original == number], return_counts=True)[1].max() >= 7
    assert 6 <= len(np.unique(groups)) <= 9
    for count in (100, 1000):
        own = groups_of_alike(digits.x_train[:count].reshape(-1, 8, 8), digits.y_train[:count])
        assert np.array_equal(own, np.arange(count))


def test_parts_have_whole_groups_and_of_each_class_its_share():
    rng = np.random.default_rng(0)
    groups = np.concatenate([rng.integers(0, 40, 300), np.full(60, 40), np.full(30, 41)])
    labels = np.concatenate([np.arange(40) % 2, [0, 2]])[groups]  # the third class is one group
    part = deal(groups, labels, 5, seed=1)
    assert all(len(np.unique(part[groups == group])) == 1 for group in range(42))
    assert set(part[labels == 2]) == {-1}
    for label in (0, 1):
        sizes = np.bincount(part[labels == label], minlength=5)
        assert sizes.argmin() == 0
        assert sizes[0] > 0.7 * 0.2 * 150


def test_copies_are_split_and_left_out_together(copied, tmp_path):
    """No picture of a test or of a fold has a copy in the training."""
    x, labels, _ = copied
    for label in (0, 1):
        save_images(tmp_path / "own" / "ab"[label], np.rint(255 * x[labels == label]).astype("u1"))
    data = deepfsi.load_dataset(tmp_path / "own")
    assert "48 pictures are" in data.preprocessing
    assert "groups of alike ones (one of " in data.preprocessing
    assert (np.bincount(data.y_test, minlength=2) > 0).all()
    known = {row.round(6).tobytes(): group for row, group in zip(
        x.reshape(48, -1).astype(np.float32), groups_of_alike(x, labels), strict=True)}  # fmt: skip
    # files hold whole levels: the nearest picture tells the group
    table = np.stack([np.frombuffer(row, np.float32) for row in known])
    numbers = list(known.values())

    def groups(rows):
        return {numbers[np.square(table - row).sum(axis=1).argmin()] for row in rows}

    assert not groups(data.x_train) & groups(data.x_test)
    folds = folds_of(data)
    assert len(folds) >= 2
    for fold in folds:
        assert not groups(fold.x_train) & groups(fold.x_test)
        assert len(groups(fold.x_test)) == len(fold.x_test)
    whole = replace(data, drawn=True)
    for fold in whole.folds(2):
        assert not groups(fold.x_train) & groups(fold.x_test)

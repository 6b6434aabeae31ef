"""A data set names its content by a hash, and holds out its last training scenes."""

from dataclasses import replace

import numpy as np
import pytest
from dataset_samples import X, Y, refused, scenes

from deepfsi.datasets.arrays import from_arrays


def test_hash_follows_the_content():
    data = from_arrays(*scenes())
    moved = data.x_test.copy()
    moved[0, 0] += 2**-12
    others = [
        replace(data, x_test=moved),
        replace(data, y_train=data.y_train[::-1].copy()),
        replace(data, classes=("a", "b", "c")),
        replace(data, image_shape=(4, 3)),
        from_arrays(*scenes(), seed=1),
    ]
    assert data.hash == from_arrays(*scenes()).hash
    assert len({data.hash, *(other.hash for other in others)}) == 6


def test_hold_out_takes_the_last_training_scenes():
    data = from_arrays(X, Y, X[:6], Y[:6])
    for count, expected in ((None, 5), (7, 7)):
        held = data.hold_out(count)
        assert np.array_equal(np.r_[held.x_train, held.x_test], data.x_train)
        assert np.array_equal(np.r_[held.y_train, held.y_test], data.y_train)
        assert len(held.x_test) == expected
        assert held.hash != data.hash
        assert (held.classes, held.image_shape) == (data.classes, data.image_shape)


@pytest.mark.parametrize(
    ("count", "said"),
    [
        *((count, f"{count} of 30 training scenes") for count in (0, -1, 30, 31)),
        (10, "leave some of each class"),
    ],
)
def test_hold_out_of_nothing_or_everything_or_a_whole_class(count, said):
    data = from_arrays(X, Y, X, Y)
    by_class = np.argsort(data.y_train, kind="stable")
    data = replace(data, x_train=data.x_train[by_class], y_train=data.y_train[by_class])
    with refused(said):
        data.hold_out(count)


def test_folds_test_each_scene_once_by_data_that_lack_it():
    """Of every class each fold has its share, and the scenes are those of the whole."""
    rng = np.random.default_rng(0)
    labels = np.repeat([0, 1, 2], [31, 14, 7])
    data = from_arrays(rng.random((52, 6)), labels, name="few")
    parts = data.folds(5)
    whole = np.sort(np.concatenate([data.x_train, data.x_test]), axis=0)
    assert (np.sort(np.concatenate([part.x_test for part in parts]), axis=0) == whole).all()
    sizes = np.array([np.bincount(part.y_test, minlength=3) for part in parts])
    assert (np.ptp(sizes, axis=0) <= 1).all()
    assert np.ptp(sizes.sum(axis=1)) <= 1
    for part in parts:
        trained = {scene.tobytes() for scene in part.x_train}
        assert len(trained) == 52 - len(part.x_test)
        assert not trained & {scene.tobytes() for scene in part.x_test}
        part.hold_out()  # classes are mixed in the order of the training scenes
    assert len({part.hash for part in parts}) == 5
    again = data.folds(5)
    assert [part.hash for part in again] == [part.hash for part in parts]
    valued = from_arrays(rng.random((30, 6)), rng.random(30), values=["light"]).folds(3)
    assert [len(part.x_test) for part in valued] == [10, 10, 10]


def test_only_a_test_part_that_was_drawn_has_folds():
    data = from_arrays(X, Y)
    for own in (from_arrays(X, Y, X[:20], Y[:20]), data.hold_out(), data.folds(2)[0]):
        with refused("a test part of its own"):
            own.folds(2)
    for count in (1, 0, 10_000):
        with refused("folds of"):
            data.folds(count)

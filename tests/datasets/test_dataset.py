"""A data set names its content by a hash, and holds out its last training scenes."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from dataset_samples import refused, scenes

from deepfsi.datasets import from_arrays


def test_importing_is_light():
    heavy = "{'sklearn', 'scipy', 'spectral', 'PIL', 'pooch', 'requests', 'torch'}"
    code = f"import sys, deepfsi.datasets; print({heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_hash_follows_the_content():
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


def test_hold_out_takes_the_last_training_scenes():
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
def test_hold_out_of_nothing_or_everything(count):
    x, y = scenes()
    data = from_arrays(x, y, x, y)
    with refused(f"{count} of 30", "at least 1 and at most 29"):
        data.hold_out(count)


def test_hold_out_of_a_whole_class():
    x, y = scenes(classes=2)
    data = from_arrays(x, y, x, y)
    by_class = np.argsort(data.y_train, kind="stable")
    data = replace(data, x_train=data.x_train[by_class], y_train=data.y_train[by_class])
    with refused("class '1' has none left"):
        data.hold_out(15)

"""The pickles of CIFAR-10 are read, and hostile ones give an error."""

import os
import pickle

import numpy as np
import pytest
from dataset_samples import PYTHON, RECORDS, refused

from deepfsi.datasets.pickles import read_batch


def test_pickles_that_this_python_writes():
    batch = {b"data": RECORDS[0, :, 1:].copy(), b"labels": RECORDS[0, :, 0].tolist()}
    for protocol in (3, 4):
        pixels, labels = read_batch(pickle.dumps(batch, protocol), "a")
        assert np.array_equal(pixels, RECORDS[0, :, 1:])
        assert labels == RECORDS[0, :, 0].tolist()
    with refused():  # bytes then need codecs.encode, which the official archive does not
        read_batch(pickle.dumps(batch, 2), "a")


class Call:
    """Calls something when it is unpickled."""

    def __init__(self, function, *arguments):
        self.call = (function, arguments)

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_hostile_pickles(tmp_path, protocol):
    sprung = tmp_path / "sprung"
    traps = (
        Call(os.mkdir, str(sprung)),
        Call(eval, f"__import__('os').mkdir({str(sprung)!r})"),
        Call(np.memmap, str(sprung), "u1", "w+", 0, (4,)),
        Call(np.ndarray, (2**50,)),
        Call(getattr, "a", "upper"),
    )
    for trap in traps:
        for batch in ({b"data": trap, b"labels": []}, trap, {b"x": [trap]}):
            with refused("batch_1 is no batch of CIFAR-10", "replace it"):
                read_batch(pickle.dumps(batch, protocol), "batch_1")
            assert not sprung.exists()


@pytest.mark.parametrize(
    "batch",
    [
        {b"data": np.zeros((2, 3072)), b"labels": [0, 1]},
        {b"data": np.full((2, 3072), None), b"labels": [0, 1]},
        {b"data": np.zeros((2, 3072), np.uint8, order="F"), b"labels": [0, 1]},
        {b"data": np.zeros((2, 3072), np.uint8), b"labels": [0]},
        {b"data": np.zeros((2, 3072), np.uint8), b"labels": [0, 0.5]},
        {b"data": np.zeros((2, 3072), np.uint8), b"labels": "ab"},
        {b"data": np.zeros((2, 9), np.uint8), b"labels": [0, 1]},
        {b"data": b"", b"labels": [0, 1]},
        {b"labels": [0, 1]},
        [1, 2],
    ],
)
def test_pickles_of_something_else(batch):
    with refused("batch_1 is no batch"):
        read_batch(pickle.dumps(batch, 4), "batch_1")


@pytest.mark.parametrize("content", [b"", b"\x80\x02", PYTHON["data_batch_1"][:5000], b"GIF89a"])
def test_damaged_pickles(content):
    with refused("batch_1 is no batch"):
        read_batch(content, "batch_1")

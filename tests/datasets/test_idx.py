"""The idx files of MNIST, tiny and real."""

import os
from pathlib import Path

import numpy as np
import pytest

from deepfsi.datasets import check, list_datasets, load_dataset

real_mnist = pytest.mark.skipif(
    not (
        Path(os.environ.get("DEEPFSI_DATA") or ".") / "mnist" / "train-images-idx3-ubyte.gz"
    ).is_file(),
    reason="needs MNIST's files in $DEEPFSI_DATA/mnist",
)

MNIST_HASH = "49bd5a2700bc752110ee3797138b1924d711c3bd98a376b24e07fd7ad78585d1"


@real_mnist
def test_mnist():
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

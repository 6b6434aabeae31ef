"""Scenes, pictures and files that the tests of the data sets share."""

from __future__ import annotations

import gzip
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from deepfsi.datasets import idx
from deepfsi.errors import InputError


@contextmanager
def refused(*parts):
    """Expect an `InputError` of one line that has these parts."""
    with pytest.raises(InputError) as error:
        yield
    message = str(error.value)
    assert "\n" not in message
    for part in parts:
        assert part in message


Array = npt.NDArray[Any]


def scenes(n=30, shape=(3, 4), classes=3):
    """Scenes whose first pixel tells which one it is, 0/n .. (n-1)/n, and labels in turn."""
    x = np.random.default_rng(1).random((n, *shape))
    x.reshape(n, -1)[:, 0] = np.arange(n) / n
    return x, np.arange(n) % classes


def numbers(x, n=30):
    """Which scenes of `scenes` these are."""
    return [int(number) for number in np.round(x[:, 0] * n)]


X, Y = scenes()


def idx_file(array):
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

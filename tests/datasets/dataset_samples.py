"""Scenes, pictures and files that the tests of the data sets share."""

from contextlib import contextmanager

import numpy as np
import pytest

from deepfsi import InputError, load_dataset
from deepfsi.datasets.spectra import SpectralImage


@contextmanager
def refused(*parts):
    """Expect an `InputError` of one line that has these parts."""
    with pytest.raises(InputError) as error:
        yield
    message = str(error.value)
    assert "\n" not in message
    for part in parts:
        assert part in message


def not_loaded(source, *parts, **options):
    """Expect that a source is refused in one line that has these parts."""
    with refused(*parts):
        load_dataset(source, **options)


def scenes(n=30, shape=(3, 4), classes=3):
    """Scenes whose first pixel tells which one it is, 0/n .. (n-1)/n, and labels in turn."""
    x = np.random.default_rng(1).random((n, *shape))
    x.reshape(n, -1)[:, 0] = np.arange(n) / n
    return x, np.arange(n) % classes


def numbers(x, n=30):
    """Which scenes of `scenes` these are."""
    return [int(number) for number in np.round(x[:, 0] * n)]


X, Y = scenes()


# ---------------------------------------------------------------- a hyperspectral image


def fields(side=60, classes=4):
    """A label map of square fields with unlabelled paths between them."""
    labels = np.zeros((side, side), np.uint8)
    step = side // 4
    for i in range(4):
        for j in range(4):
            inside = slice(i * step, (i + 1) * step - 1), slice(j * step, (j + 1) * step - 1)
            labels[inside] = 1 + (i + j) % classes
    return labels


def numbered(labels, bands=5):
    """A cube whose first two bands tell the row and column, the last the class."""
    cube = np.full((*labels.shape, bands), 30, np.int16)
    cube[..., 0], cube[..., 1] = np.indices(labels.shape)
    cube[..., -1] = labels * 20
    cube[0, 0, 2], cube[-1, -1, 2] = -100, 300  # what becomes 0 and 1
    return cube


LABELS = fields()

CUBE = numbered(LABELS)

IMAGE = SpectralImage("farm", CUBE, LABELS)

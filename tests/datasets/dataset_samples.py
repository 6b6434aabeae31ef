"""Scenes, pictures and files that the tests of the data sets share."""

import gzip
from contextlib import contextmanager

import numpy as np
import pytest

from deepfsi.datasets import SpectralImage, cifar, idx
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

PARTS = (TINY_IMAGES[:20], TINY_LABELS[:20], TINY_IMAGES[20:], TINY_LABELS[20:])

TINY = dict(zip(idx.IDX_FILES, map(idx_file, PARTS), strict=True))

# ---------------------------------------------------------------- CIFAR-10, twenty images a batch

BATCH = 20

RECORDS = np.random.default_rng(8).integers(0, 256, (6, BATCH, 3073), dtype=np.uint8)

RECORDS[..., 0] = np.arange(BATCH) % 10

RECORDS[0, :, 0] = RECORDS[0, ::-1, 0]

BINARY = {
    f"{name}.bin": records.tobytes() for name, records in zip(cifar.BATCHES, RECORDS, strict=True)
}


def python_2_pickle(records):
    """A batch as the official archive has it: protocol 2, with Python 2's strings."""

    def string(content):
        return b"T" + len(content).to_bytes(4, "little") + content

    def number(value):
        return b"J" + value.to_bytes(4, "little", signed=True)

    n = len(records)
    dtype = b"cnumpy\ndtype\n(" + string(b"u1") + number(0) + number(1) + b"tR("
    dtype += number(3) + string(b"|") + b"NNN" + number(-1) + number(-1) + number(0) + b"tb"
    array = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(" + number(0) + b"t"
    array += string(b"b") + b"tR(" + number(1) + b"(" + number(n) + number(3072) + b"t" + dtype
    array += b"I00\n" + string(records[:, 1:].tobytes()) + b"tb"
    labels = b"](" + b"".join(number(int(label)) for label in records[:, 0]) + b"e"
    return (
        b"\x80\x02}("
        + (string(b"batch_label") + string(b"training batch 1 of 5"))
        + (string(b"labels") + labels)
        + (string(b"data") + array)
        + (string(b"filenames") + b"]" + b"u.")
    )


PYTHON = {
    name: python_2_pickle(records) for name, records in zip(cifar.BATCHES, RECORDS, strict=True)
}


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

IMAGE = SpectralImage("farm", numbered(LABELS), LABELS)

NM = np.linspace(400.02, 2498.96, 220).round(6)

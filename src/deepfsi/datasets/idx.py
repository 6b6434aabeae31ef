"""MNIST and Fashion-MNIST: the original gzipped idx files, checked by their hashes."""

import gzip
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from deepfsi.datasets.arrays import Range, assemble, draw_stratified
from deepfsi.datasets.dataset import Dataset, Reflectance
from deepfsi.datasets.store import FileCheck, check_files, find_folder, whole_files

IDX_FILES = (
    "train-images-idx3-ubyte.gz",
    "train-labels-idx1-ubyte.gz",
    "t10k-images-idx3-ubyte.gz",
    "t10k-labels-idx1-ubyte.gz",
)
"""Names of the files: training images and labels, test images and labels."""


UNFRAMED, FRAME = (28, 28), ((0, 0), (2, 2), (2, 2))
"""Pixels of an image as published, and those that are added in front of and behind each axis."""


class Original(NamedTuple):
    """A data set in MNIST's idx format, as its authors publish it."""

    classes: tuple[str, ...]
    mirrors: tuple[str, ...]
    hashes: tuple[str, ...]  # "algorithm:hex" of each of IDX_FILES


ORIGINALS = {
    name: Original(**{field: tuple(values) for field, values in fields.items()})
    for name, fields in tomllib.loads(
        files(__package__).joinpath("idx.toml").read_text("utf-8")
    ).items()
}
"""Data sets by name."""


def load_idx(name: str, rescale: Range, count: int | None = None, seed: int = 0) -> Dataset:
    """Load the original in its own split and order, framed to 32x32.

    Of the training images `count` are kept, of each class its share; all unless given.
    """
    folder = download(name)
    images, labels, images_test, labels_test = (_read_idx(folder / file) for file in IDX_FILES)
    if count is not None:
        kept = draw_stratified(labels, count, seed, name)
        images, labels = images[kept], labels[kept]
    drawn = "" if count is None else f"{count} training images drawn by class; "
    return assemble(
        name,
        (_framed(images), labels.astype(np.int64)),
        (_framed(images_test), labels_test.astype(np.int64)),
        classes=ORIGINALS[name].classes,
        described=f"{drawn}Padded from 28x28 to 32x32 with black, divided by 255",
        rescale=rescale,
    )


def _framed(images: npt.NDArray[np.uint8]) -> Reflectance:
    """Images (n, 28, 28) as reflectance (n, 32, 32)."""
    return np.divide(np.pad(images, FRAME), 255, dtype=np.float32)


def _read_idx(path: Path) -> npt.NDArray[np.uint8]:
    """Bytes of a gzipped idx file: the fourth says how many lengths follow, then the array."""
    content = gzip.decompress(path.read_bytes())
    start = 4 + 4 * content[3]
    lengths = np.frombuffer(content[4:start], ">u4")
    return np.frombuffer(content, np.uint8, offset=start).reshape(lengths)


def _hashes(name: str) -> dict[str, str]:
    return dict(zip(IDX_FILES, ORIGINALS[name].hashes, strict=True))


def where(name: str) -> Path | None:
    """First folder that has all four files."""
    return find_folder(name, IDX_FILES)


def check(name: str) -> list[FileCheck]:
    """Compare the four files with their hashes."""
    return check_files(name, _hashes(name))


def download(name: str) -> Path:
    """Folder of the four files, downloaded where they are missing, all whole."""
    return whole_files(name, _hashes(name), ORIGINALS[name].mirrors)

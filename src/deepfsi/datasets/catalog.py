"""Data sets that have a name: listing, download and check of their files.

- ``digits``: 8x8, embedded in scikit-learn;
- ``mnist``, ``fashion-mnist``: padded to 32x32; the original files, found in
  ``$DEEPFSI_DATA/NAME/`` or else downloaded once;
- ``cifar10``: 32x32, grey; the official binary archive, found in ``$DEEPFSI_DATA/cifar10/`` or
  else downloaded once. At 64x64 the whole of it takes 1 GB, and twice that while it is loaded;
- ``cifar10-jpeg``: its images decoded from lossy JPEG, in
  ``$DEEPFSI_DATA/cifar10/cifar10-jpeg.zip``;
- ``indian-pines``: 200 of 220 bands, each labelled pixel a scene, padded with darkness to 256
  bands; the corrected cube in ``$DEEPFSI_DATA/indian_pines/`` or in the package ``tensorly``.
"""

from pathlib import Path
from typing import NamedTuple

from deepfsi.base import InputError, check_choice
from deepfsi.datasets import cifar, idx, indian_pines
from deepfsi.datasets.store import FileCheck

CIFAR = ("cifar10", "cifar10-jpeg")
"""Names whose files are CIFAR-10's."""

FILES = (
    dict.fromkeys(idx.ORIGINALS, idx)
    | dict.fromkeys(CIFAR, cifar)
    | {indian_pines.NAME: indian_pines}
)
"""Module that finds, downloads and checks the files of each name."""

NAMES = ("digits", *FILES)


class DatasetInfo(NamedTuple):
    """Sizes of a named data set, and where it is."""

    name: str
    images: int
    pixels: int  # N
    classes: int
    where: str  # "embedded", its folder, or "not here"


def list_datasets() -> list[DatasetInfo]:
    """Data sets that have a name. Files are looked for, but not opened."""
    sizes = (
        dict.fromkeys(idx.ORIGINALS, (70_000, 1024, 10))
        | dict.fromkeys(CIFAR, (60_000, 1024, 10))
        | {indian_pines.NAME: (10_249, indian_pines.BANDS, 16)}
    )
    listed = (
        DatasetInfo(name, *sizes[name], str(files.where(name) or "not here"))
        for name, files in FILES.items()
    )
    return [DatasetInfo("digits", 1797, 64, 10, "embedded"), *listed]


def download(name: str) -> Path:
    """Make sure that the files of a data set are here, and undamaged."""
    # What ``$DEEPFSI_DATA`` holds is used. Otherwise the files that the cache lacks are downloaded
    # into it, each from the first mirror that gives it whole. Of names that cannot be downloaded,
    # this finds the files that are here. Gives their folder
    if name == "digits":
        raise InputError("digits is part of scikit-learn: there is nothing to download, load it")
    check_choice("data set", name, NAMES)
    return FILES[name].download(name)


def check(name: str) -> list[FileCheck]:
    """Compare the files of a data set with the hashes of the originals."""
    # They are in the folder where all are, or else where they belong. Where no hash is known, the
    # content is looked at instead
    check_choice("data set", name, NAMES)
    if name == "digits":
        return [FileCheck("digits", True, "embedded in scikit-learn")]
    return FILES[name].check(name)

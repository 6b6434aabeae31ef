"""CIFAR-10 in grey: the official binary archive, or a copy in JPEG that says so in its name.

A. Krizhevsky, "Learning Multiple Layers of Features from Tiny Images", technical report, University
of Toronto, 2009.
"""

import io
import tarfile
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from deepfsi.base import InputError
from deepfsi.datasets import pictures
from deepfsi.datasets.arrays import Options
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.pictures import Picture
from deepfsi.datasets.store import FileCheck, candidates, check_files, find_folder, whole_files

CLASSES = ("airplane", "automobile", "bird", "cat", "deer", "dog", "frog", "horse", "ship", "truck")
"""Names of the classes, in the order of the labels."""

MIRRORS = ("https://www.cs.toronto.edu/~kriz/",)

ARCHIVE = "cifar-10-binary.tar.gz"

HASHES = {ARCHIVE: "md5:c32a1d4ab5d03f1284b67883e8d87530"}
"""Hash of the archive, algorithm:hex."""

BATCHES = (*(f"data_batch_{i}.bin" for i in range(1, 6)), "test_batch.bin")
"""Files of the archive's folder, the test batch last."""

BATCH = 10_000
"""Images in a batch."""

SIDE = 32
"""Height and width of an image, pixels."""

JPEG_FILE = "cifar10-jpeg.zip"


def where(name: str) -> Path | None:
    """First folder that has the archive, or the zip file of JPEG images."""
    return find_folder("cifar10", (ARCHIVE if name == "cifar10" else JPEG_FILE,))


def download(name: str) -> Path:
    """Folder of the archive, downloaded where it is missing, and whole; or of the zip file."""
    if name == "cifar10":
        return whole_files(name, HASHES, MIRRORS)
    folder = where(name)
    if folder is None:
        raise InputError(
            "cifar10-jpeg is not here, and not to be downloaded: put a zip file of the JPEG images "
            f"as train/CLASS/ and test/CLASS/ at cifar10/{JPEG_FILE} in the folder that "
            "DEEPFSI_DATA names, or use the original, cifar10"
        )
    return folder


def check(name: str) -> list[FileCheck]:
    """Compare the archive with its hash, or count the images of the zip file."""
    if name == "cifar10":
        return check_files(name, HASHES)
    path = (where(name) or candidates("cifar10")[0]) / JPEG_FILE
    try:
        with pictures.open_listings(path) as listings:
            detail = _unlike(listings)
    except InputError as error:
        return [FileCheck(path.name, False, str(error))]
    said = detail or "every class has its images; no hash is known"
    return [FileCheck(path.name, not detail, said)]


def load_cifar(name: str, options: Options) -> Dataset:
    """Load grey CIFAR-10, or its copy in JPEG, in its own split; the training part is shuffled."""
    folder = download(name)
    if name == "cifar10":
        found = list_archive(folder / ARCHIVE)
        return pictures.from_listings(found, "CIFAR-10", options, bilinear=True)
    with pictures.open_listings(folder / JPEG_FILE) as listings:
        if detail := _unlike(listings):
            raise InputError(
                f"{folder / JPEG_FILE}: {detail}; replace it, or give its path to load it as any "
                "zip file"
            )
        return pictures.from_listings(listings, "JPEG-decoded CIFAR-10", options, bilinear=True)


def list_archive(path: Path) -> list[list[Picture]]:
    """Pictures of the archive's training and test part, in its order."""
    with tarfile.open(path, "r:gz") as archive:
        contents = {
            Path(member.name).name: file.read()
            for member in archive
            if (file := archive.extractfile(member)) is not None
        }
    train, test = b"".join(contents[name] for name in BATCHES[:-1]), contents[BATCHES[-1]]
    return [list_records(train, str(path)), list_records(test, str(path))]


def list_records(content: bytes, where: str) -> list[Picture]:
    """Pictures of records, each a label, then all reds, all greens and all blues."""
    records = np.frombuffer(content, np.uint8).reshape(-1, 1 + 3 * SIDE * SIDE)
    pixels = records[:, 1:].reshape(-1, 3, SIDE * SIDE).swapaxes(1, 2)
    return [
        Picture(CLASSES[label], where, partial(_as_ppm, colours))
        for label, colours in zip(records[:, 0], pixels, strict=True)
    ]


def _as_ppm(colours: npt.NDArray[np.uint8]) -> io.BytesIO:
    """Pixels (1024, 3) as an image file."""
    return io.BytesIO(b"P6 %d %d 255\n" % (SIDE, SIDE) + colours.tobytes())


def _unlike(listings: list[list[Picture]]) -> str:
    """Say how a listing differs from CIFAR-10's images of each class, if it does."""
    if len(listings) != 2:
        return "it has no train and test folders"
    counts = (5 * BATCH // len(CLASSES), BATCH // len(CLASSES))
    for part, found, count in zip(("train", "test"), listings, counts, strict=True):
        if Counter(picture.label for picture in found) != dict.fromkeys(CLASSES, count):
            return f"its {part} folder does not hold {count} images of each of {', '.join(CLASSES)}"
    return ""

"""CIFAR-10 in grey: the official archives, or a copy in JPEG that says so in its name.

A. Krizhevsky, "Learning Multiple Layers of Features from Tiny Images", technical report, University
of Toronto, 2009.
"""

import tarfile
import zlib
from collections import Counter
from pathlib import Path

import numpy as np
import numpy.typing as npt

from deepfsi.datasets import pictures
from deepfsi.datasets.arrays import Options, draw_stratified, split_arrays
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.decoding import Shape
from deepfsi.datasets.pickles import read_batch
from deepfsi.datasets.pictures import Picture
from deepfsi.datasets.store import FileCheck, cache, candidates, check_file, data_root, retrieve
from deepfsi.errors import InputError

CLASSES = ("airplane", "automobile", "bird", "cat", "deer", "dog", "frog", "horse", "ship", "truck")
"""Names of the classes, in the order of the labels."""

MIRRORS = ("https://www.cs.toronto.edu/~kriz/",)

HASHES = {
    "cifar-10-binary.tar.gz": "md5:c32a1d4ab5d03f1284b67883e8d87530",
    "cifar-10-python.tar.gz": "md5:c58f30108f718f92721af3b95e74349a",
}
"""Hashes of the official archives, algorithm:hex."""

UNPACKED = "cifar-10-batches-bin"
"""Folder in the binary archive."""

BATCHES = (*(f"data_batch_{i}" for i in range(1, 6)), "test_batch")
"""Names of the batches, the test batch last."""

BATCH = 10_000
"""Images in a batch."""

SIDE = 32
"""Height and width of an image, pixels."""

RECORD = 1 + 3 * SIDE * SIDE
"""Bytes of a binary record: label, red, green, blue."""

JPEG_FILE = "cifar10-jpeg.zip"


def where(name: str) -> Path | None:
    """Path of the archive, the unpacked folder, or the zip file of JPEG images."""
    wanted = (JPEG_FILE,) if name == "cifar10-jpeg" else (UNPACKED, *HASHES)
    root = data_root()
    folders = candidates("cifar10") if root is None else [*candidates("cifar10"), root]
    paths = (folder / file for folder in folders for file in wanted)
    return next((path for path in paths if path.exists()), None)


def load_cifar(name: str, options: Options) -> Dataset:
    """Load grey CIFAR-10, or its copy in JPEG, in its own split; the training part is shuffled."""
    shape, seed, images = pictures.as_shape(options.size), options.seed, options.images
    if shape is not None:
        pictures.check_total(6 * BATCH, shape)
    if name == "cifar10-jpeg":
        return _load_jpeg(options)
    pixels, labels = read_batches(download(name))
    n = len(labels) - BATCH
    train = np.arange(n) if images is None else draw_stratified(labels[:n], images, seed, name)
    return split_arrays(
        (_grey(pixels[train], shape), labels[train]),
        (_grey(pixels[n:], shape), labels[n:]),
        classes=CLASSES,
        name="CIFAR-10",
        seed=seed,
        rescale=options.rescale,
        values=pictures.describe(shape, True, images),
    )


def _grey(pixels: npt.NDArray[np.uint8], shape: Shape | None) -> npt.NDArray[np.uint8]:
    """Records (n, 3072) as grey images (n, H, W)."""
    from PIL import Image

    grey = np.empty((len(pixels), *(shape or (SIDE, SIDE))), np.uint8)
    for i, record in enumerate(pixels):
        colour = np.ascontiguousarray(record.reshape(3, SIDE, SIDE).transpose(1, 2, 0))
        grey[i] = pictures.resized(Image.fromarray(colour).convert("L"), shape, True)
    return grey


# ---------------------------------------------------------------- the official files


def download(name: str) -> Path:
    """Path of the files, downloaded where they are missing, all whole."""
    found = where(name)
    if name == "cifar10-jpeg":
        return _jpeg_path()
    if found is None:
        file = "cifar-10-binary.tar.gz"
        retrieve("cifar10", file, HASHES[file], MIRRORS)
        return cache("cifar10") / file
    for file, ok, detail in check(name):
        if not ok:
            raise InputError(f"{found.parent / file}: {detail}; replace it with the original")
    return found


def check(name: str) -> list[FileCheck]:
    """Compare an archive with its hash, or count what else there is."""
    found = where(name)
    if name == "cifar10-jpeg":
        return [_check_jpeg(found or candidates("cifar10")[0] / JPEG_FILE)]
    if found is None:
        found = candidates("cifar10")[0] / "cifar-10-binary.tar.gz"
    if found.name in HASHES:
        return [check_file(found, HASHES[found.name])]
    return [_check_size(found, f"{batch}.bin") for batch in BATCHES]


def _check_size(folder: Path, file: str) -> FileCheck:
    path = folder / file
    found = path.stat().st_size if path.is_file() else None
    expected = BATCH * RECORD
    detail = "missing" if found is None else f"{found} bytes"
    if found != expected:
        detail += f", not {expected} bytes"
    return FileCheck(f"{folder.name}/{file}", found == expected, detail)


def read_batches(path: Path) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64]]:
    """Pixels (n, 3072) and labels (n,) of an archive or folder, the test batch last.

    The pixels of an image are its reds, then its greens, then its blues.
    """
    batches = [decode_batch(content, where) for content, where in _contents(path)]
    pixels = np.concatenate([pixels for pixels, _ in batches])
    labels = np.concatenate([labels for _, labels in batches])
    if labels.max() >= len(CLASSES):
        raise InputError(f"{path} holds the label {labels.max()}; replace it with the original")
    return pixels, labels


def decode_batch(content: bytes, where: str) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64]]:
    """Pixels and labels of one batch, binary where its name ends in ``.bin``, else pickled."""
    if where.endswith(".bin"):
        if len(content) != BATCH * RECORD:
            raise InputError(
                f"{where} has {len(content)} bytes, not {BATCH * RECORD}; "
                "replace it with the original"
            )
        records = np.frombuffer(content, np.uint8).reshape(BATCH, RECORD)
        return records[:, 1:], records[:, 0].astype(np.int64)
    pixels, labels = read_batch(content, where)
    return pixels, np.array(labels, np.int64)


def _contents(path: Path) -> list[tuple[bytes, str]]:
    """Content and name of the six batches, in their order."""
    if path.is_dir():
        files = [path / f"{batch}.bin" for batch in BATCHES]
        return [(file.read_bytes(), str(file)) for file in files]
    found: dict[str, tuple[bytes, str]] = {}
    try:
        with tarfile.open(path, "r:gz") as archive:
            for member in archive:
                batch = Path(member.name).name
                if member.isfile() and batch.removesuffix(".bin") in BATCHES:
                    stream = archive.extractfile(member)
                    content = stream.read(2 * BATCH * RECORD) if stream else b""
                    found[batch.removesuffix(".bin")] = (content, f"{path}/{batch}")
    except (EOFError, OSError, tarfile.TarError, zlib.error) as error:
        raise InputError(f"cannot read {path} ({error}); replace it with the original") from error
    missing = [batch for batch in BATCHES if batch not in found]
    if missing:
        raise InputError(f"{path} lacks {', '.join(missing)}; replace it with the original")
    return [found[batch] for batch in BATCHES]


# ---------------------------------------------------------------- the copy in JPEG


def _load_jpeg(options: Options) -> Dataset:
    path = _jpeg_path()
    with pictures.open_listings(path) as listings:
        detail = _unlike(listings)
        if detail:
            raise InputError(
                f"{path}: {detail}; replace it, or give its path to load it as any zip file"
            )
        return pictures.from_listings(listings, "JPEG-decoded CIFAR-10", options, bilinear=True)


def _jpeg_path() -> Path:
    path = where("cifar10-jpeg")
    if path is None:
        raise InputError(
            "cifar10-jpeg is not here, and not to be downloaded: put a zip file of the JPEG images "
            f"as train/CLASS/ and test/CLASS/ at cifar10/{JPEG_FILE} in the folder that "
            "DEEPFSI_DATA names, or use the original, cifar10"
        )
    return path


def _check_jpeg(path: Path) -> FileCheck:
    try:
        with pictures.open_listings(path) as listings:
            detail = _unlike(listings)
    except InputError as error:
        return FileCheck(path.name, False, str(error))
    return FileCheck(
        path.name, not detail, detail or "every class has its images; no hash is known"
    )


def _unlike(listings: list[list[Picture]]) -> str:
    """Say how a listing differs from CIFAR-10's images of each class, if it does."""
    if len(listings) != 2:
        return "it has no train and test folders"
    counts = (5 * BATCH // len(CLASSES), BATCH // len(CLASSES))
    for part, found, count in zip(("train", "test"), listings, counts, strict=True):
        if Counter(picture.label for picture in found) != dict.fromkeys(CLASSES, count):
            return f"its {part} folder does not hold {count} images of each of {', '.join(CLASSES)}"
    return ""

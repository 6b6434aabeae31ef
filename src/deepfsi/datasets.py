"""Data sets: a name, a folder of images, an ``.npz`` file or arrays become one `Dataset`.

A `Dataset` holds scenes as reflectance in [0, 1], one row each, with integer labels, already
divided into a training and a test part. Where the source has no test part of its own, a seeded
stratified fifth of it is set aside. The training scenes are always in random order, so that the
last of them are a fair sample to validate on (`Dataset.hold_out`).
"""

from __future__ import annotations

import gzip
import hashlib
import json
import math
import os
import sys
import time
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias
from urllib.parse import urlsplit

import numpy as np
import numpy.typing as npt

from deepfsi.errors import InputError, closest

__all__ = [
    "Dataset",
    "DatasetInfo",
    "FileCheck",
    "check",
    "download",
    "from_arrays",
    "list_datasets",
    "load_dataset",
]

Reflectance: TypeAlias = npt.NDArray[np.float32]
Labels: TypeAlias = npt.NDArray[np.int64]
Range: TypeAlias = tuple[float, float]

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".gif", ".pgm", ".tif", ".tiff", ".webp")
SPLIT_MINIMUM = 5  # scenes per class: a fifth of fewer may be none
ROUNDING = 1e-6  # how far a float may lie outside [0, 1] after scaling done elsewhere
DIM_BLACK = (0.3, 1.0)  # black still reflects, so that every pixel sends photons

IDX_FILES = (
    "train-images-idx3-ubyte.gz",
    "train-labels-idx1-ubyte.gz",
    "t10k-images-idx3-ubyte.gz",
    "t10k-labels-idx1-ubyte.gz",
)


class Original(NamedTuple):
    """A data set in MNIST's idx format, as its authors publish it."""

    classes: tuple[str, ...]
    mirrors: tuple[str, ...]
    hashes: tuple[str, ...]  # "algorithm:hex" of each of IDX_FILES


ORIGINALS = {
    # Y. LeCun, L. Bottou, Y. Bengio, P. Haffner, "Gradient-based learning applied to document
    # recognition", Proc. IEEE 86(11), 1998
    "mnist": Original(
        classes=tuple("0123456789"),
        mirrors=(
            "https://ossci-datasets.s3.amazonaws.com/mnist/",
            "https://storage.googleapis.com/cvdf-datasets/mnist/",
        ),
        hashes=(
            "sha256:440fcabf73cc546fa21475e81ea370265605f56be210a4024d2ca8f203523609",
            "sha256:3552534a0a558bbed6aed32b30c495cca23d567ec52cac8be1a0730e8010255c",
            "sha256:8d422c7b0a1c1c79245a5bcf07fe86e33eeafee792b84584aec276f5a2dbc4e6",
            "sha256:f7ae60f92e00ec6debd23a6088c31dbd2371eca3ffa0defaefb259924204aec6",
        ),
    ),
    # H. Xiao, K. Rasul, R. Vollgraf, "Fashion-MNIST: a novel image dataset for benchmarking
    # machine learning algorithms", arXiv:1708.07747, 2017
    "fashion-mnist": Original(
        classes=(
            "T-shirt/top",
            "Trouser",
            "Pullover",
            "Dress",
            "Coat",
            "Sandal",
            "Shirt",
            "Sneaker",
            "Bag",
            "Ankle boot",
        ),
        mirrors=(
            "http://fashion-mnist.s3-website.eu-central-1.amazonaws.com/",
            "https://github.com/zalandoresearch/fashion-mnist/raw/master/data/fashion/",
        ),
        hashes=(
            "md5:8d4fb7e6c68d591d4c3dfef9ec88bf0d",
            "md5:25c81989df183df01b3e8a0aad5dffbe",
            "md5:bef4ecab320f06d8554ea6380940ec79",
            "md5:bb300cfdad3c16e7a12a480ee83cd310",
        ),
    ),
}
NAMES = ("digits", *ORIGINALS)


@dataclass(frozen=True, eq=False)
class Dataset:
    """Labelled scenes in a training and a test part.

    Attributes
    ----------
    name
        What the data set is called in tables and records.
    x_train, x_test
        Reflectance after preprocessing, dimensionless in [0, 1], (n, N) float32.
    y_train, y_test
        Class of each scene, 0 .. C-1, (n,) int64.
    image_shape
        (H, W) for images, (B,) for spectra of B bands; its product is N.
    classes
        The C class names, in the order of the labels.
    preprocessing
        What was done to the source's values, in one sentence.
    """

    name: str
    x_train: Reflectance
    y_train: Labels
    x_test: Reflectance
    y_test: Labels
    image_shape: tuple[int, ...]
    classes: tuple[str, ...]
    preprocessing: str

    @property
    def pixels(self) -> int:
        """Number of pixels (or bands) of a scene, N."""
        return int(self.x_train.shape[1])

    @cached_property
    def hash(self) -> str:
        """SHA-256 in hex over the arrays, their shapes and the class names."""
        arrays = (self.x_train, self.y_train, self.x_test, self.y_test)
        shapes = [array.shape for array in arrays]
        digest = hashlib.sha256(json.dumps([shapes, self.image_shape, self.classes]).encode())
        for array in arrays:
            digest.update(np.ascontiguousarray(array).data)
        return digest.hexdigest()

    def hold_out(self, count: int | None = None) -> Dataset:
        """Set the last training scenes aside for validation; the test scenes are left out.

        Parameters
        ----------
        count
            How many training scenes to set aside, at least 1; by default one sixth of them
            (10 000 of MNIST's 60 000). To hold nothing out, use the data set itself.

        Returns
        -------
        Dataset
            Its training part is the rest, its test part the validation scenes. Both are views.

        Raises
        ------
        InputError
            If `count` leaves nothing to validate on, or some class nothing to train on.
        """
        n = len(self.x_train)
        count = n // 6 if count is None else count
        if not 0 < count < n:
            raise InputError(
                f"{self.name}: {count} of {n} training scenes held out for validation; "
                f"hold out at least 1 and at most {n - 1}"
            )
        rest = n - count
        left = np.bincount(self.y_train[:rest], minlength=len(self.classes))
        if not left.all():
            raise InputError(
                f"{self.name}: with {count} of {n} training scenes held out, class "
                f"'{self.classes[left.argmin()]}' has none left to train on; hold out fewer"
            )
        return replace(
            self,
            x_train=self.x_train[:rest],
            y_train=self.y_train[:rest],
            x_test=self.x_train[rest:],
            y_test=self.y_train[rest:],
        )


def load_dataset(
    source: str | os.PathLike[str] | tuple[Any, ...],
    *,
    size: int | tuple[int, int] | None = None,
    seed: int = 0,
    rescale: Range | None = None,
) -> Dataset:
    """Load a data set by its name, from a path, or from arrays.

    Parameters
    ----------
    source
        One of

        - ``"digits"`` (8x8, embedded in scikit-learn), ``"mnist"`` or ``"fashion-mnist"`` (32x32):
          the original files, found in ``$DEEPFSI_DATA/NAME/`` or else downloaded once;
        - the path of a folder with one sub-folder of images for each class, or with such folders
          within its own ``train/`` and ``test/`` (anything else beside those two is ignored).
          Images are turned to grey; of an animation the first frame is used;
        - the path of an ``.npz`` file with `x`, `y` and, if it has its own test part, `x_test`,
          `y_test`, as in `from_arrays`;
        - a tuple ``(x, y)`` or ``(x, y, x_test, y_test)`` of arrays, as in `from_arrays`.

        A name goes before a folder of that name: write ``./mnist`` for the folder.
    size
        Side, or (H, W), in pixels, to which the images of a folder are brought by averaging over
        areas. Needed where they differ in size.
    seed
        Draws the test part where the source has none, and the order of the training scenes,
        0 .. 2**32 - 1. MNIST and Fashion-MNIST keep their own split and order, known to be random.
    rescale
        (low, high) to which [0, 1] is mapped. By default (0.3, 1) for the three named data sets,
        no change for others; (0, 1) is no change for all.

    Returns
    -------
    Dataset

    Raises
    ------
    InputError
        If `source` is unknown, missing, damaged or cannot be downloaded; if its scenes are not
        reflectance in [0, 1], differ in shape or are all dark; if there are fewer than two classes
        or too few scenes in one; or if an option cannot be used.
    """
    if isinstance(source, tuple):
        _check_no_size(size, "arrays")
        if len(source) not in (2, 4):
            raise InputError(
                f"a tuple of {len(source)} arrays was given; give (x, y) or (x, y, x_test, y_test)"
            )
        return from_arrays(*source, seed=seed, rescale=rescale)
    name = os.fspath(source)
    path = Path(name).expanduser()
    if name in NAMES:
        _check_no_size(size, name)
        rescale = rescale or DIM_BLACK
        return _load_digits(seed, rescale) if name == "digits" else _load_original(name, rescale)
    if name and path.is_dir():
        return _load_folder(path, size, seed, rescale)
    if path.is_file():
        _check_no_size(size, path.name)
        return _load_npz(path, seed, rescale)
    if path.suffix or len(path.parts) > 1:
        raise InputError(f"there is no folder and no .npz file at '{name}'")
    raise InputError(
        f"unknown data set '{name}': {closest(name, NAMES)}; "
        "or the path of a folder of images or an .npz file"
    )


def from_arrays(
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    x_test: npt.ArrayLike | None = None,
    y_test: npt.ArrayLike | None = None,
    *,
    classes: Sequence[str] | None = None,
    name: str = "arrays",
    seed: int = 0,
    rescale: Range | None = None,
) -> Dataset:
    """Make a data set of arrays in memory. The training scenes are shuffled with the seed.

    Parameters
    ----------
    x
        Scenes: (n, H, W) for images, (n, N) for spectra. Floats are reflectance in [0, 1];
        uint8 is divided by 255.
    y
        Labels, (n,) integers or strings. Their sorted values become the classes 0 .. C-1.
    x_test, y_test
        The test part, kept in its order. Without it, a stratified fifth of the scenes, drawn with
        the seed, is set aside.
    classes
        Class names. Integer labels then count into them from 0; string labels are among them.
    name
        What the data set is called.
    seed
        Draws the test part and the order of the training scenes, 0 .. 2**32 - 1.
    rescale
        (low, high) to which [0, 1] is mapped; by default no change.

    Returns
    -------
    Dataset

    Raises
    ------
    InputError
        If the arrays do not fit each other or the rules above; if there are fewer than two
        classes, none to learn from in one of them, or, where a test part is to be drawn, fewer
        than five scenes in one.
    """
    return _from_arrays(
        x,
        y,
        x_test,
        y_test,
        classes=classes,
        name=name,
        seed=seed,
        rescale=rescale,
        values="Divided by 255" if np.asarray(x).dtype == np.uint8 else "As given",
    )


def _from_arrays(
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    x_test: npt.ArrayLike | None = None,
    y_test: npt.ArrayLike | None = None,
    *,
    classes: Sequence[str] | None = None,
    name: str,
    seed: int,
    rescale: Range | None,
    values: str,
) -> Dataset:
    """`from_arrays`, where `values` says how the values given came about."""
    if not (isinstance(seed, int | np.integer) and 0 <= seed < 2**32):
        raise InputError(f"seed {seed!r}: give an integer from 0 to 2**32 - 1")
    scenes, labels = _scenes_and_labels(x, y, f"{name}: x", f"{name}: y")
    names, numbers = _classes(labels, classes, name)
    y_all = _class_numbers(labels, numbers, f"{name}: y")
    fewest = np.bincount(y_all, minlength=len(names)).argmin()
    count = np.count_nonzero(y_all == fewest)

    if x_test is None and y_test is None:
        if count < SPLIT_MINIMUM:
            raise InputError(
                f"{name}: class '{names[fewest]}' has {count} scenes; to draw a test part give "
                f"{SPLIT_MINIMUM} or more of each class, or a test part of your own"
            )
        from sklearn.model_selection import train_test_split

        train, test = train_test_split(
            np.arange(len(y_all)), test_size=0.2, stratify=y_all, random_state=seed
        )
        scenes_test, y_test_part = scenes[test], y_all[test]
    elif x_test is None or y_test is None:
        raise InputError(f"{name}: only one of x_test and y_test is there; give both or neither")
    else:
        if count == 0:
            raise InputError(f"{name}: class '{names[fewest]}' has no training scenes; give some")
        train = np.random.default_rng(seed).permutation(len(y_all))
        scenes_test, labels_test = _scenes_and_labels(
            x_test, y_test, f"{name}: x_test", f"{name}: y_test"
        )
        y_test_part = _class_numbers(labels_test, numbers, f"{name}: y_test")
        if scenes_test.shape[1:] != scenes.shape[1:]:
            raise InputError(
                f"{name}: a scene has shape {scenes.shape[1:]} in x but {scenes_test.shape[1:]} "
                "in x_test; bring both to one shape"
            )
    return _assemble(
        name, scenes[train], y_all[train], scenes_test, y_test_part, names, values, rescale
    )


def _scenes_and_labels(
    x: npt.ArrayLike, y: npt.ArrayLike, x_name: str, y_name: str
) -> tuple[Reflectance, npt.NDArray[Any]]:
    """Reflectance but for rounding, (n, H, W) or (n, N); labels, (n,) integers or strings."""
    scenes, labels = np.asarray(x), np.asarray(y)
    if scenes.ndim not in (2, 3) or scenes.size == 0:
        raise InputError(
            f"{x_name} has shape {scenes.shape}; give (n, H, W) for grey images, (n, N) for spectra"
        )
    if scenes.dtype == np.uint8:
        scenes = _unit(scenes)
    elif scenes.dtype.kind == "f":
        low, high = scenes.min(), scenes.max()
        if not (np.isfinite(low) and np.isfinite(high)):
            raise InputError(f"{x_name} holds NaN or infinite values; remove those scenes")
        if low < -ROUNDING or high > 1 + ROUNDING:
            raise InputError(
                f"{x_name} reaches from {low:.4g} to {high:.4g}; reflectance lies in [0, 1]: "
                "rescale it"
            )
        scenes = scenes.astype(np.float32)
    else:
        raise InputError(f"{x_name} is {scenes.dtype}; give floats in [0, 1], or uint8 (0 to 255)")

    if labels.dtype == object and all(isinstance(label, str) for label in labels.flat):
        labels = labels.astype(str)
    if labels.shape != scenes.shape[:1]:
        raise InputError(
            f"{y_name} has shape {labels.shape} for {len(scenes)} scenes; give one label for each"
        )
    if labels.dtype.kind not in "iuU":
        raise InputError(f"{y_name} is {labels.dtype}; give labels that are integers or strings")
    return scenes, labels


def _unit(values: npt.NDArray[np.uint8]) -> Reflectance:
    return np.divide(values, 255, dtype=np.float32)


def _classes(
    labels: npt.NDArray[Any], classes: Sequence[str] | None, name: str
) -> tuple[tuple[str, ...], dict[int | str, int]]:
    """Find the class names, and the class number of each label."""
    known = np.unique(labels).tolist()
    names = tuple(str(label) for label in known) if classes is None else tuple(classes)
    if len(names) < 2:
        raise InputError(f"{name}: only one class, {', '.join(names)}; give two or more")
    if len(set(names)) < len(names):
        raise InputError(f"{name}: classes {', '.join(names)}; give each its own name")
    if classes is not None:
        known = list(names if labels.dtype.kind == "U" else range(len(names)))
    return names, {label: number for number, label in enumerate(known)}


def _class_numbers(labels: npt.NDArray[Any], numbers: dict[int | str, int], what: str) -> Labels:
    unknown = set(labels.tolist()) - numbers.keys()
    if unknown:
        raise InputError(
            f"{what} holds the label {min(unknown)!r}; "
            f"the classes to train on are {', '.join(map(repr, numbers))}"
        )
    return np.array([numbers[label] for label in labels.tolist()], dtype=np.int64)


def _assemble(
    name: str,
    x_train: Reflectance,
    y_train: Labels,
    x_test: Reflectance,
    y_test: Labels,
    classes: tuple[str, ...],
    values: str,
    rescale: Range | None,
) -> Dataset:
    """Flatten and rescale, in place, scenes that are otherwise ready."""
    low, high = (0.0, 1.0) if rescale is None else rescale
    if not 0 <= low < high <= 1:
        raise InputError(f"rescale ({low}, {high}): give low and high with 0 <= low < high <= 1")
    if not x_train.any():
        raise InputError(f"{name}: every training scene is dark, all 0; give scenes with light")
    for x in (x_train, x_test):
        x *= high - low
        x += low
        np.clip(x, low, high, out=x)
    mapped = "" if (low, high) == (0, 1) else f", then mapped from [0, 1] to [{low:g}, {high:g}]"
    return Dataset(
        name=name,
        x_train=x_train.reshape(len(x_train), -1),
        y_train=y_train,
        x_test=x_test.reshape(len(x_test), -1),
        y_test=y_test,
        image_shape=x_train.shape[1:],
        classes=classes,
        preprocessing=f"{values}{mapped}.",
    )


def _check_no_size(size: object, name: str) -> None:
    if size is not None:
        raise InputError(
            f"{name}: a size was given; only a folder of images takes one, leave it out"
        )


def _load_digits(seed: int, rescale: Range) -> Dataset:
    from sklearn.datasets import load_digits

    digits = load_digits()
    return _from_arrays(
        digits.images / 16,
        digits.target,
        name="digits",
        seed=seed,
        rescale=rescale,
        values="Divided by 16",
    )


def _load_folder(
    folder: Path, size: int | tuple[int, int] | None, seed: int, rescale: Range | None
) -> Dataset:
    parts = [folder / "train", folder / "test"]
    if not (all(part.is_dir() for part in parts) and any(p.is_dir() for p in parts[0].iterdir())):
        parts = [folder]
    shape = size if size is None or isinstance(size, tuple) else (size, size)
    if shape is not None and not (len(shape) == 2 and min(shape) >= 1):
        raise InputError(f"size {size}: give one side or (H, W), in pixels, at least 1")

    listings = [_list_images(part) for part in parts]
    images = _read_images([path for listing in listings for path in listing], shape)
    labels = np.array([path.parent.name for listing in listings for path in listing])
    n = len(listings[0])
    own_split = len(listings) == 2
    resized = "" if shape is None else f", averaged to {shape[0]}x{shape[1]} pixels,"
    return _from_arrays(
        images[:n],
        labels[:n],
        images[n:] if own_split else None,
        labels[n:] if own_split else None,
        name=folder.resolve().name,
        seed=seed,
        rescale=rescale,
        values=f"Grey levels{resized} divided by 255",
    )


def _list_images(folder: Path) -> list[Path]:
    """List the images of all class folders, in the order of their names."""
    classes = sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))
    if not classes:
        raise InputError(f"{folder} has no sub-folders; put the images of each class into its own")
    images = []
    for name in classes:
        found = sorted(
            p
            for p in name.iterdir()
            if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(".")
        )
        if not found:
            raise InputError(
                f"the class folder {name} holds no images; add some ({' '.join(IMAGE_SUFFIXES)}) "
                "or remove it"
            )
        images += found
    return images


def _read_images(paths: list[Path], shape: tuple[int, int] | None) -> npt.NDArray[np.uint8]:
    """Grey images, (n, H, W), all of one shape."""
    images: list[npt.NDArray[np.uint8]] = []
    for path in paths:
        image = _read_grey(path, shape)
        if image.shape != (images or [image])[0].shape:
            raise InputError(
                f"images differ in size: {paths[0]} is {images[0].shape[0]}x{images[0].shape[1]}, "
                f"{path} is {image.shape[0]}x{image.shape[1]}; give a size to bring them to one"
            )
        images.append(image)
    return np.stack(images)


def _read_grey(path: Path, shape: tuple[int, int] | None) -> npt.NDArray[np.uint8]:
    from PIL import Image

    try:
        with Image.open(path) as image:
            mode = image.mode
            grey = image.convert("L")
    except Exception as error:  # Pillow's decoders raise almost anything on a damaged file
        raise InputError(f"cannot read the image {path} ({error}); replace or remove it") from error
    if mode[0] in "IF":  # convert("L") would clip these to 255
        raise InputError(f"{path} has more than 8 bits ({mode}); save it with 8, or give arrays")
    if shape is not None:
        grey = grey.resize(shape[::-1], Image.Resampling.BOX)
    return np.asarray(grey)


def _load_npz(path: Path, seed: int, rescale: Range | None) -> Dataset:
    if not zipfile.is_zipfile(path):
        raise InputError(f"{path} is no .npz file, or not all of one; write it with numpy.savez")
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (EOFError, OSError, ValueError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(
            f"cannot read {path} ({error}); "
            "write plain arrays of numbers or strings with numpy.savez"
        ) from error
    if not {"x", "y"} <= arrays.keys() <= {"x", "y", "x_test", "y_test"}:
        raise InputError(
            f"{path} holds {', '.join(arrays) or 'nothing'}; "
            "give x and y, optionally x_test and y_test, and no other names"
        )
    return from_arrays(**arrays, name=path.stem, seed=seed, rescale=rescale)


def _load_original(name: str, rescale: Range) -> Dataset:
    folder = download(name)
    images, labels, images_test, labels_test = (
        _read_idx(folder / file, dimensions)
        for file, dimensions in zip(IDX_FILES, (3, 1, 3, 1), strict=True)
    )
    frame = ((0, 0), (2, 2), (2, 2))
    return _assemble(
        name,
        _unit(np.pad(images, frame)),
        labels.astype(np.int64),
        _unit(np.pad(images_test, frame)),
        labels_test.astype(np.int64),
        ORIGINALS[name].classes,
        "Padded from 28x28 to 32x32 with black, divided by 255",
        rescale,
    )


def _read_idx(path: Path, dimensions: int) -> npt.NDArray[np.uint8]:
    """Read a gzipped idx file of unsigned bytes: magic, big-endian lengths, then the bytes."""
    try:
        content = gzip.decompress(path.read_bytes())
    except (EOFError, OSError, zlib.error) as error:
        raise InputError(f"cannot read {path} ({error}); replace it with the original") from error
    start = 4 + 4 * dimensions
    magic = bytes([0, 0, 8, dimensions])
    lengths = [int.from_bytes(content[i : i + 4], "big") for i in range(4, start, 4)]
    if content[:4] != magic or len(content) != start + math.prod(lengths):
        raise InputError(
            f"{path} is no idx file of {dimensions}-dimensional bytes, or not all of one; "
            "replace it with the original"
        )
    return np.frombuffer(content, np.uint8, offset=start).reshape(lengths)


class DatasetInfo(NamedTuple):
    """A named data set: how many images, pixels (N) and classes, and where it is."""

    name: str
    images: int
    pixels: int
    classes: int
    where: str  # "embedded", the folder of its files, or "not here"


class FileCheck(NamedTuple):
    """What a check of one file found."""

    file: str
    ok: bool
    detail: str


def list_datasets() -> list[DatasetInfo]:
    """List the data sets that have a name. Files are looked for, but not opened."""
    return [DatasetInfo("digits", 1797, 64, 10, "embedded")] + [
        DatasetInfo(name, 70_000, 1024, len(original.classes), str(_here(name) or "not here"))
        for name, original in ORIGINALS.items()
    ]


def download(name: str) -> Path:
    """Make sure that the original files of a data set are here, and undamaged.

    The files of ``$DEEPFSI_DATA/NAME/`` are used where all four are there. Otherwise those that
    the cache lacks are downloaded into it, each from the first mirror that gives it whole.

    Parameters
    ----------
    name
        ``"mnist"`` or ``"fashion-mnist"``.

    Returns
    -------
    Path
        The folder of the four files, every one checked by its hash.

    Raises
    ------
    InputError
        If there is nothing to download under this name, a file in ``$DEEPFSI_DATA`` is damaged,
        or no mirror gives a file.
    """
    original = _original(name)
    folder = _here(name)
    if folder is not None and folder != _cache(name):
        for file, ok, detail in check(name):
            if not ok:
                raise InputError(f"{folder / file}: {detail}; replace it with the original")
        return folder
    for file, known_hash in zip(IDX_FILES, original.hashes, strict=True):
        _retrieve(name, file, known_hash, original.mirrors)
    return _cache(name)


def check(name: str) -> list[FileCheck]:
    """Compare the files of a data set with the hashes of the originals.

    Parameters
    ----------
    name
        One of those that `list_datasets` gives.

    Returns
    -------
    list of FileCheck
        One for each file, in the folder where all are, or else where they belong.

    Raises
    ------
    InputError
        If the name is unknown.
    """
    if name == "digits":
        return [FileCheck("digits", True, "embedded in scikit-learn")]
    original = _original(name)
    folder = _here(name) or _candidates(name)[0]
    return [
        _check_file(folder / file, known_hash)
        for file, known_hash in zip(IDX_FILES, original.hashes, strict=True)
    ]


def _check_file(path: Path, known_hash: str) -> FileCheck:
    algorithm, _, expected = known_hash.partition(":")
    try:
        with path.open("rb") as file:
            found = hashlib.file_digest(file, algorithm).hexdigest()
    except OSError as error:
        return FileCheck(path.name, False, f"cannot be read from {path.parent} ({error.strerror})")
    if found != expected:
        return FileCheck(path.name, False, f"{algorithm} is {found}, not {expected}")
    return FileCheck(path.name, True, f"{algorithm} agrees")


def _original(name: str) -> Original:
    if name == "digits":
        raise InputError(
            "digits is embedded in scikit-learn: there is nothing to download, load it"
        )
    if name not in ORIGINALS:
        raise InputError(f"unknown data set '{name}': {closest(name, NAMES)}")
    return ORIGINALS[name]


def _cache(name: str) -> Path:
    import pooch

    return Path(pooch.os_cache("deepfsi")) / name


def _candidates(name: str) -> list[Path]:
    """List the folders where the files of a data set may be, first come first."""
    root = os.environ.get("DEEPFSI_DATA")
    if not root:
        return [_cache(name)]
    if not Path(root).is_dir():
        raise InputError(f"DEEPFSI_DATA is '{root}', which is no folder; correct or unset it")
    return [Path(root) / name, _cache(name)]


def _here(name: str) -> Path | None:
    """Find the first folder that has all files of a data set."""
    for folder in _candidates(name):
        if all((folder / file).is_file() for file in IDX_FILES):
            return folder
    return None


def _retrieve(name: str, file: str, known_hash: str, mirrors: tuple[str, ...]) -> None:
    """Bring one file into the cache, unless it is there whole, from the first mirror that can."""
    import pooch

    pooch.get_logger().setLevel("WARNING")
    failures = []
    for mirror in mirrors:
        progress = _Progress(file)
        try:
            pooch.retrieve(mirror + file, known_hash, file, _cache(name), progressbar=progress)
            return
        except (OSError, ValueError) as error:  # no connection, no such file; wrong hash
            reason = "wrong hash" if isinstance(error, ValueError) else type(error).__name__
            failures.append(f"{urlsplit(mirror).netloc} ({reason})")
        finally:
            progress.close()
    raise InputError(
        f"{name}: cannot download {file} from {' or '.join(failures)}; try again, or put the "
        f"original files into a folder {name} and set DEEPFSI_DATA to the folder that holds it"
    )


class _Progress:
    """The progress bar that pooch asks for: a line on stderr, from the third second on."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.total = self.done = 0
        self.due = time.monotonic() + 2
        self.shown = False

    def update(self, size: int) -> None:
        self.done += size
        if time.monotonic() >= self.due:
            print(
                f"\r{self.file}: {self.done / 1e6:.1f} of {self.total / 1e6:.1f} MB",
                end="",
                file=sys.stderr,
                flush=True,
            )
            self.due = time.monotonic() + 0.2
            self.shown = True

    def reset(self) -> None:
        self.done = 0

    def close(self) -> None:
        if self.shown:
            print(file=sys.stderr)
            self.shown = False

"""Loading a data set by its name, from a path, or from arrays."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from deepfsi.base import (
    InputError,
    Message,
    check_readable_name,
    closest_choice,
    content_of,
    plain_keywords,
)
from deepfsi.datasets import cifar, idx, indian_pines, pictures
from deepfsi.datasets.anomalies import one_class
from deepfsi.datasets.arrays import Options, Range, load_npz, split_arrays
from deepfsi.datasets.catalog import CIFAR, NAMES
from deepfsi.datasets.cubes import SUFFIXES, read_cube
from deepfsi.datasets.dataset import Dataset, Origin
from deepfsi.datasets.display import Display, array_display, read_display
from deepfsi.datasets.pictures import load_pictures

DIM_BLACK = (0.3, 1.0)
"""Reflectance of black and white in named images: black reflects, so that every pixel counts."""

DIM = ("digits", "mnist", "fashion-mnist")
"""Names of those."""

KINDS = (
    "a folder or .zip of images with a folder for each class, a .csv of their names and labels, "
    f"a cube ({', '.join(SUFFIXES)}) or an .npz file of arrays x and y"
)
"""Sources of data sets besides names, for messages."""

TAKERS = {
    "size": ("a size", "images of a folder, a zip file, a .csv file or CIFAR-10 take"),
    "images": ("a number of images", "a folder, a zip file, CIFAR-10 or MNIST takes"),
    "split": ("a split", "a hyperspectral image takes"),
    "white": ("a white", "a folder, zip file or .csv file of images or arrays take"),
    "skip_bad": (
        Message("{skip_bad}", setting="skip_bad"),
        "a folder, zip file or .csv file of images takes",
    ),
}
"""For messages, each option that only some sources take, and the sources."""


@plain_keywords()
def load_dataset(
    source: str | os.PathLike[str] | tuple[Any, ...],
    *,
    size: int | tuple[int, int] | None = None,
    seed: int = 0,
    rescale: Range | None = None,
    images: int | None = None,
    split: str | None = None,
    white: float | None = None,
    skip_bad: bool = False,
    normal: str | None = None,
) -> Dataset:
    """Load a data set by its name, from a path, or from arrays.

    Raises `InputError` if the source is unknown, missing or damaged, or cannot take an option.

    Parameters
    ----------
    source : str, path or tuple
        One of

        - a name that `list_datasets` gives; their module, `deepfsi.datasets.catalog`, says what
          each is and where its files are found. ``./mnist`` is a folder of that name;
        - a folder or ``.zip`` file with a sub-folder of images for each class, or with such folders
          within its own ``train/`` and ``test/``. Images of one depth; colours turn grey;
        - a ``.csv`` file with the file name and the label of an image in each line, whose names
          begin in the folder of its own name beside it, ``pets/`` of ``pets.csv``, or in its own.
          Numbers in place of the label are values where a line has several, or where any has a
          decimal point or an exponent; a heading names them;
        - a hyperspectral cube (``.mat``, ``.npy`` or ENVI's ``.hdr``), whose label map lies beside
          it under the same name with ``_gt`` added, as in `cubes.read_cube`;
        - an ``.npz`` file with `x`, `y` and, if it has its own test part, `x_test`, `y_test`, or
          a tuple of these arrays, as in `from_arrays`. A `y` of floats is of values, whose names a
          file may hold as `values`.
    size : int or (int, int), optional
        Side or (H, W) in pixels to which images are brought: those of a folder or zip file by
        averaging over areas, CIFAR-10's bilinearly. Needed where they differ in size.
    seed : int
        Draws the test part where the source has none, the order of the training scenes and the
        `images` to keep, 0 .. 2**32 - 1. MNIST and Fashion-MNIST keep their own split and order.
    rescale : (float, float), optional
        Low and high, to which [0, 1] is mapped; (0, 1) is no change. By default (0.3, 1) for
        digits, MNIST and Fashion-MNIST, no change for others.
    images : int, optional
        Training images to keep of CIFAR-10, MNIST, Fashion-MNIST, or a folder or zip file with its
        own test part, drawn with the seed, of each class its share; all by default.
    split : {"random", "blocks"}, optional
        Of hyperspectral images, as in `SpectralImage.parts`.
    white : float, optional
        Value that is reflectance 1, of images and arrays of integers wider than a byte; by default
        that of the fewest bits that hold the largest value, as `deepfsi.datasets.values` says.
    skip_bad : bool
        Leave images that cannot be read out, which `Dataset.preprocessing` then names.
    normal : str, optional
        Class to be told from anomalies, as `datasets.anomalies` makes them of its scenes; scenes of
        the other classes are in the test part alone.

    Examples
    --------
    >>> import deepfsi
    >>> deepfsi.load_dataset("digits").image_shape
    (8, 8)
    """
    options = Options(size, seed, rescale, images, split, white, skip_bad, normal)
    data = _load(source, options)
    return data if normal is None else one_class(data, normal, seed)


def _load(source: str | os.PathLike[str] | tuple[Any, ...], options: Options) -> Dataset:
    """Data set of a source with its own classes or values."""
    if isinstance(source, tuple):
        return _load_arrays(source, options)
    if not isinstance(source, str | os.PathLike):
        raise InputError(
            f"data were given as {type(source).__name__}: give a Dataset of deepfsi, a name such "
            "as 'digits', a path, or a tuple (x, y) or (x, y, x_test, y_test) of arrays; scenes "
            "and labels of a torch data set make two such arrays"
        )
    name = os.fspath(source)
    place = absolute(name)
    _refuse(options, name if name in NAMES else _existing(name).name, takes(name))
    data = _load_name(name, options) if name in NAMES else _load_path(_existing(name), options)
    known = options._replace(size=pictures.as_shape(options.size), white=data.white)
    return replace(data, origin=Origin(data=place, **known._asdict()))


def absolute(source: str) -> str:
    """Name of a data set as it is, absolute path of any other."""
    return (
        source
        if source in NAMES
        else check_readable_name(str(Path(source).expanduser().absolute()))
    )


def takes(source: str) -> tuple[str, ...]:
    """Options of `load_dataset` that this source takes, and not every one does."""
    if source in NAMES:
        taken = dict.fromkeys(CIFAR, ("size", "images")) | dict.fromkeys(idx.ORIGINALS, ("images",))
        return taken.get(source, ("split",) if source == indian_pines.NAME else ())
    path = _existing(source)
    if path.is_dir() or path.suffix.lower() == ".zip":
        return ("size", "images", "white", "skip_bad")
    if path.suffix.lower() == ".csv":
        return ("size", "white", "skip_bad")
    return ("split",) if path.suffix.lower() in SUFFIXES else ("white",)


Source: TypeAlias = Dataset | str | os.PathLike[str] | tuple[Any, ...]
"""A data set, or what `load_dataset` makes one of."""


def as_dataset(data: Source) -> Dataset:
    """A data set as it is, or the one of a name, a path or a tuple of arrays, as `load_dataset`."""
    return data if isinstance(data, Dataset) else load_dataset(data)


def check_source(source: str) -> None:
    """Raise `InputError` unless a name is known or there is something at a path."""
    if source not in NAMES:
        _existing(source)


def _existing(name: str) -> Path:
    path = Path(name).expanduser()
    if name and path.exists():
        return path
    if path.suffix or len(path.parts) > 1:
        raise InputError(f"there is no folder and no file at '{name}': give {KINDS}")
    raise InputError(
        f"unknown data set '{name}': {closest_choice(name, NAMES)}; or the path of {KINDS}"
    )


def _load_arrays(arrays: tuple[Any, ...], options: Options) -> Dataset:
    _refuse(options, "arrays", ("white",))
    if len(arrays) not in (2, 4):
        raise InputError(
            f"a tuple of {len(arrays)} arrays was given; give (x, y) or (x, y, x_test, y_test)"
        )
    x, y, *test = (*arrays, None, None)[:4]
    seed, rescale, white = options.seed, options.rescale, options.white
    return split_arrays((x, y), test, name="arrays", seed=seed, rescale=rescale, white=white)


def _load_name(name: str, options: Options) -> Dataset:
    seed, rescale = options.seed, options.rescale
    if name in CIFAR:
        return cifar.load_cifar(name, options)
    if name == indian_pines.NAME:
        scene = indian_pines.load_scene()
        return scene.dataset(options.split or "random", seed, indian_pines.BANDS, rescale)
    if name == "digits":
        from sklearn.datasets import load_digits

        digits = load_digits()
        return split_arrays(
            (digits.images / 16, digits.target),
            name=name,
            seed=seed,
            rescale=rescale or DIM_BLACK,
            described="Divided by 16",
        )
    return idx.load_idx(name, rescale or DIM_BLACK, options.images, seed)


def prepared(pictures: Path | npt.NDArray[Any], origin: Origin, skip_bad: bool = False) -> Display:
    """Pictures made scenes as those of a data set of that origin were."""
    # But for the view of a camera. Pictures that `write_pictures` wrote are mapped already
    bilinear = origin.data in CIFAR
    shape = origin.size or ((cifar.SIDE, cifar.SIDE) if bilinear else None)
    if isinstance(pictures, Path):
        shown = read_display(pictures, origin.white, shape, bilinear, skip_bad)
    else:
        shown = array_display(pictures, origin.white)
    x, said = shown.x, shown.preprocessing
    if origin.data in idx.ORIGINALS and x.shape[1:] == idx.UNFRAMED:
        x, said = np.pad(x, idx.FRAME), f"{said}, padded as {origin.data}"
    ends = origin.rescale or (DIM_BLACK if origin.data in DIM else (0, 1))
    if ends == (0, 1) or shown.written == len(x):
        return shown._replace(x=x, preprocessing=said)
    if shown.written:
        raise InputError(
            f"{shown.written} of {len(x)} pictures at {pictures} are reflectance that `deepfsi "
            "data export` wrote, and the others are not: give them apart"
        )
    low, high = ends
    said = f"{said}, then mapped from [0, 1] to [{low:g}, {high:g}]"
    return shown._replace(x=low + (high - low) * x, preprocessing=said)


def _load_path(path: Path, options: Options) -> Dataset:
    if path.is_dir() or path.suffix.lower() in (".zip", ".csv"):
        return load_pictures(path, options)
    if path.suffix.lower() in SUFFIXES:
        split = options.split or "random"
        return read_cube(path).dataset(split, options.seed, rescale=options.rescale)
    if path.suffix.lower() == ".npz":
        return load_npz(path, options)
    header = next((end for end in (".hdr", ".HDR") if path.with_suffix(end).is_file()), "")
    if header or Path(f"{path}.hdr").is_file():
        beside = path.with_suffix(header) if header else f"{path}.hdr"
        raise InputError(f"{path} is the data file of an ENVI cube: give its header, {beside}")
    raise InputError(
        f"{path} is no data set that is read (it holds {content_of(path)}): give {KINDS}"
    )


def _refuse(options: Options, name: str, taken: tuple[str, ...]) -> None:
    """Raise `InputError` for an option that is given but not among those that a source takes."""
    for option, (what, who) in TAKERS.items():
        if option not in taken and getattr(options, option) not in (None, False):
            raise InputError(
                "{name}: {what} was given; only {who} one, leave it out",
                name=name,
                what=what,
                who=who,
            )

"""Loading a data set by its name, from a path, or from arrays."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy.typing as npt

from deepfsi.base.errors import InputError, as_input_error, closest_choice
from deepfsi.base.files import readable_name
from deepfsi.datasets.arrays import from_arrays, load_arrays
from deepfsi.datasets.catalog import DATASETS, NamedDataset
from deepfsi.datasets.dataset import Dataset, Ends, Origin
from deepfsi.datasets.display import Display, array_display, read_display
from deepfsi.datasets.pictures import load_pictures
from deepfsi.datasets.spectra import CUBE_ENDINGS, read_cube


class _FileKind(NamedTuple):
    """A kind of files that hold a data set."""

    what: str
    endings: tuple[str, ...]  # of their names, in small letters; "/" of a folder
    options: tuple[str, ...]  # options of `load_dataset` that they take, and not every source does
    load: Callable[[Origin], Dataset]


def _load_cube(options: Origin) -> Dataset:
    cube = read_cube(Path(options.data))
    return cube.dataset(options.split, options.seed, rescale=options.rescale)


FILE_KINDS = (
    _FileKind(
        "a folder of images with a folder for each class",
        ("/",),
        ("size", "images", "white"),
        load_pictures,
    ),
    _FileKind("a .csv of their names and labels", (".csv",), ("size", "white"), load_pictures),
    _FileKind(f"a cube ({', '.join(CUBE_ENDINGS)})", CUBE_ENDINGS, ("split",), _load_cube),
    _FileKind("an .npz file of arrays x and y", (".npz",), ("white",), load_arrays),
)
"""Kinds of files that hold a data set: a new one is an entry here."""

Source: TypeAlias = Dataset | str | os.PathLike[str] | tuple[Any, ...]
"""A data set, or a source that `load_dataset` takes."""


def load_dataset(
    source: str | os.PathLike[str] | tuple[Any, ...],
    *,
    size: int | tuple[int, int] | None = None,
    seed: int = 0,
    rescale: Ends | None = None,
    images: int | None = None,
    split: str | None = None,
    white: float | None = None,
) -> Dataset:
    """Load a data set by its name, from a path, or from arrays.

    Raises `InputError` if the source is unknown, missing or damaged, or cannot take an option.

    Parameters
    ----------
    source : str, path or tuple
        One of

        - a name: digits, mnist, …; the module `deepfsi.datasets.catalog` says what each is
          and where its files are found. ``./mnist`` is a folder of that name;
        - a folder with a sub-folder of images for each class, or with such folders within its own
          ``train/`` and ``test/``. Images of equal depth; colours turn grey;
        - a ``.csv`` file with the file name and the label of an image in each line, or its values;
        - a hyperspectral cube (``.mat``, ``.npy``), whose label map lies beside it under the same
          name with ``_gt`` added, as in `spectra.read_cube`;
        - an ``.npz`` file with `x`, `y` and, if it has its own test part, `x_test`, `y_test`, or
          a tuple of these arrays, as in `from_arrays`. A `y` of floats is of values, whose names a
          file may hold as `values`.
    size : int or (int, int), optional
        Side or (H, W) in pixels to which images are brought: a folder's by
        averaging over areas, CIFAR-10's bilinearly. Needed where they differ in size.
    seed : int
        Draws the test part where the source has none, the order of the training scenes and the
        `images` to keep, 0 .. 2**32 - 1. MNIST and Fashion-MNIST keep their own split and order.
    rescale : (float, float), optional
        Low and high, to which [0, 1] is mapped; (0, 1) is no change. By default (0.3, 1) for
        digits, MNIST and Fashion-MNIST, no change for others.
    images : int, optional
        Training images to keep of CIFAR-10, MNIST, Fashion-MNIST, or a folder with its own
        test part, drawn with the seed, of each class its share; all by default.
    split : {"random", "blocks"}, optional
        Of hyperspectral images, as in `SpectralImage.parts`.
    white : float, optional
        Value that is reflectance 1, of images and ``.npz`` files of integers wider than a byte; by
        default that of the fewest bits that hold the largest value (`deepfsi.datasets.levels`).

    Examples
    --------
    >>> import deepfsi
    >>> deepfsi.load_dataset("digits").image_shape
    (8, 8)
    """
    if not isinstance(source, str | os.PathLike | tuple):
        raise InputError(
            f"data were given as {type(source).__name__}: give a Dataset of deepfsi, a name such "
            "as 'digits', a path, or a tuple (x, y) or (x, y, x_test, y_test) of arrays"
        )
    loader: Any = None if isinstance(source, tuple) else find_source(source)
    with as_input_error():
        options = Origin(
            data="arrays" if loader is None else absolute_source(source),
            size=(size, size) if isinstance(size, int) else size,
            seed=seed,
            rescale=rescale,
            images=images,
            split=split,
            white=white,
        )
    for option in ("size", "images", "split", "white"):
        taken = loader is not None and option in loader.options
        if getattr(options, option) is not None and not taken:
            raise InputError(f"{Path(options.data).name} takes no `{option}`: leave it out")
    if isinstance(source, tuple):
        return from_arrays(*source, seed=seed, rescale=rescale)
    data = loader.load(options)
    return replace(data, origin=options.model_copy(update={"white": data.white}))


def find_source(source: Any) -> NamedDataset | _FileKind:
    """Loader of a data set by its name or its path; `InputError` if there is none."""
    if source in DATASETS:
        return DATASETS[source]
    path = Path(source).expanduser()
    sources = ", ".join(kind.what for kind in FILE_KINDS)
    if not (source and path.exists()):
        raise InputError(
            f"unknown data set '{source}': {closest_choice(str(source), DATASETS)}; or the path of "
            f"{sources}"
        )
    ending = "/" if path.is_dir() else path.suffix.lower()
    for kind in FILE_KINDS:
        if ending in kind.endings:
            return kind
    raise InputError(f"{path} is no data set that is read: give {sources}")


def absolute_source(source: Any) -> str:
    """Name of a named data set, absolute path of any other."""
    if source in DATASETS:
        return str(source)
    path = str(Path(source).expanduser().absolute())
    if readable_name(path) != path:  # JSON of a design file could not hold it
        raise InputError(f"the name {readable_name(path)} is not UTF-8: rename the file or folder")
    return path


def as_dataset(data: Source) -> Dataset:
    """The data set itself, or the one that `load_dataset` makes of a source."""
    return data if isinstance(data, Dataset) else load_dataset(data)


def prepare_display(pictures: Path | npt.NDArray[Any], origin: Origin) -> Display:
    """Make scenes of pictures like those of a data set, without the view of a camera.

    Pictures that `write_pictures` wrote hold reflectance after the mapping.
    """
    if isinstance(pictures, Path):
        display = read_display(pictures, origin.white, origin.size)
    else:
        display = array_display(pictures, origin.white)
    named = DATASETS.get(origin.data)
    low, high = origin.rescale or (named.ends if named else (0, 1))
    if (low, high) == (0, 1) or display.written == len(display.x):
        return display
    if display.written:
        raise InputError(
            f"{display.written} of {len(display.x)} pictures at {pictures} are reflectance that "
            "`deepfsi data export` wrote, and the others are not: give them apart"
        )
    words = f"{display.preprocessing}, then mapped from [0, 1] to [{low:g}, {high:g}]"
    return display._replace(x=low + (high - low) * display.x, preprocessing=words)

"""Images in folders of classes, also within ``train/`` and ``test/``, and in lists of ``.csv``.

Images may come from anywhere, so that their sizes are checked before memory is spent on them.
"""

import io
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from deepfsi.base.arrays import check_memory
from deepfsi.base.errors import InputError
from deepfsi.base.files import check_unpacked, read_regular, readable_name
from deepfsi.base.tables import normal_name, read_cells
from deepfsi.datasets.arrays import draw_stratified, split_arrays
from deepfsi.datasets.dataset import Dataset, Origin
from deepfsi.datasets.levels import PictureSize, Tally

IMAGE_SUFFIXES = (
    *(".png", ".jpg", ".jpeg", ".jpe", ".jfif", ".bmp", ".gif", ".tif", ".tiff", ".webp"),
    *(".pgm", ".ppm", ".pbm", ".pnm"),
    *(".jp2", ".heic", ".avif"),  # refused when they are read: a class would lack them in silence
)
"""Ends of the names of image files."""

OF_SYSTEMS = ("__MACOSX", "@eaDir", "$RECYCLE.BIN", "System Volume Information", "lost+found")
"""Folders that operating systems and servers put beside those of a user, as do hidden ones."""


def load_pictures(options: Origin) -> Dataset:
    """Data set of the images of a folder or of a ``.csv`` file, which gives the name, too."""
    path = Path(options.data)
    shape = options.size
    test: list[list[Path]] = []
    values = None
    drawn = ""
    if path.is_file():
        name = path.stem
        train, labels, values = _read_list(path)
    else:
        name = path.resolve().name
        train, *test = list_pictures(path)
        if options.images is not None and not test:
            raise InputError(
                f"{name}: {options.images} training images were asked for; that needs images with "
                "their own train and test folders, leave it out"
            )
        kept, drawn = draw_stratified(
            list(map(class_name, train)), options.images, options.seed, name
        )
        train = [train[i] for i in kept]
        labels = np.array([class_name(path) for part in (train, *test) for path in part])
    pixels, tally = decode_pictures([*train, *(test[0] if test else [])], shape)
    levels = tally.levels(options.white)
    n = len(train)
    return split_arrays(
        (pixels[:n], labels[:n]),
        (pixels[n:], labels[n:]) if test else (None, None),
        values=values,
        name=name,
        seed=options.seed,
        rescale=options.rescale,
        described=f"{drawn}{tally.words}{sized_text(shape, tally.sizes)}; {levels.words}",
        levels=levels,
    )


def _read_list(path: Path) -> tuple[list[Path], npt.NDArray[Any], Sequence[str] | None]:
    """Images that a ``.csv`` file names, their labels (n,) or values (n, q), and the values' names.

    Names begin in the folder of the file's own name, ``pets/`` of ``pets.csv``, or in the file's.
    """
    import polars as pl

    advice = "give a line for each image: its file name and its label, or its values"
    cells = read_cells(path, advice)
    heads: tuple[Any, ...] = ()
    if cells.height and not is_image(Path(cells[0, 0] or "").name):
        heads = cells.row(0)
        cells = cells[1:]
    # Plain decimal numbers are values; polars would read the label 1_0 as a number, too
    decimal = pl.all().str.contains(r"^[+-]?\d*\.?\d+(e[+-]\d+)?$").all()
    numbers = cells.width > 1 and all(cells[:, 1:].select(decimal).row(0))
    unsure = cells.width != 2 and not numbers
    if unsure or any(cells.null_count().row(0)) or cells[:, 0].is_duplicated().any():
        raise InputError(f"{path} does not name each image in one whole line: {advice}")
    folder = path.with_suffix("") if path.with_suffix("").is_dir() else path.parent
    images = [folder / name.replace("\\", "/") for name in cells[:, 0]]
    if cells.width == 2 and not (numbers and cells[:, 1].str.contains(r"\.").any()):
        return images, cells[:, 1].to_numpy(), None
    named = heads and heads[1] not in ("label", "class")
    return images, cells[:, 1:].cast(pl.Float64).to_numpy(), heads[1:] if named else None


def sized_text(shape: PictureSize | None, sizes: set[PictureSize]) -> str:
    """Say to what size images of some sizes were brought, as the end of a phrase."""
    return f", averaged to {shape[0]}x{shape[1]} pixels" if shape and sizes != {shape} else ""


def is_image(name: str) -> bool:
    """True for names of image files."""
    return name.lower().endswith(IMAGE_SUFFIXES) and not name.startswith(".")


def _names_text(names: Sequence[str | Path]) -> str:
    """Twenty of many names, for a message."""
    more = f" and {len(names) - 20} more" if len(names) > 20 else ""
    return ", ".join(readable_name(str(name)) for name in names[:20]) + more


def class_name(path: Path) -> str:
    """Class of an image, the name of its folder."""
    return normal_name(readable_name(path.parent.name))


def list_pictures(path: Path) -> list[list[Path]]:
    """Images of a folder: all in one part, or a training and a test part."""
    parts = {each.name.lower(): each for each in path.iterdir() if each.is_dir()}
    roots = [parts["train"], parts["test"]] if {"train", "test"} <= parts.keys() else [path]
    images: dict[Path, list[Path]] = {}  # by their folder
    for folder, inside, names in os.walk(path, followlinks=True):
        inside[:] = [name for name in inside if name[0] != "." and name not in OF_SYSTEMS]
        # A folder that is called like an image is refused when it is read
        named = (Path(folder, name) for name in [*names, *inside])
        images[Path(folder)] = [path for path in named if is_image(path.name)]
    classes = [each for each in images if each.parent in roots and each not in roots]
    # Were they left out, a set with train/ and val/ alone would have these two as classes
    astray = [image for folder in images.keys() - classes for image in images[folder]]
    if astray:
        raise InputError(
            f"{path} holds images that lie in no folder of a class, or in folders within one "
            f"({_names_text(astray)}): move them into the folder of their class, or away"
        )
    empty = [folder for folder in classes if not images[folder]]
    if empty or not classes:
        raise InputError(
            f"{path} needs a sub-folder for each class that holds its images, and "
            f"{_names_text(empty) or 'it'} has none; add them, or give arrays in an .npz file"
        )
    paths = [image for folder in classes for image in images[folder]]
    paths.sort(key=lambda each: (class_name(each), readable_name(each.name)))
    return [[each for each in paths if each.parent.parent == root] for root in roots]


# ---------------------------------------------------------------- reading


class _Unreadable(InputError):
    """An image that is damaged."""


def decode_pictures(paths: list[Path], shape: PictureSize | None) -> tuple[npt.NDArray[Any], Tally]:
    """Grey images (n, H, W) of equal shape, and a tally of what they were."""
    from PIL import Image

    tally = Tally()
    bad: list[str] = []
    grey: npt.NDArray[Any] = np.empty(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        for index, path in enumerate(paths):
            try:
                image = _read(path, tally, shape)
            except _Unreadable as error:
                bad.append(f"{path} ({error})")
                continue
            if not grey.size:
                check_memory(
                    len(paths) * image.size * (image.itemsize + 8),  # and reflectance, twice
                    f"{len(paths)} images of {image.shape[0]}x{image.shape[1]} pixels",
                    "give a smaller size, or fewer",
                )
                grey = np.empty((len(paths), *image.shape), image.dtype)
            if image.shape != grey.shape[1:]:
                raise InputError(
                    f"images differ in size: others are {grey.shape[1]}x{grey.shape[2]}, "
                    f"{path} is {image.shape[0]}x{image.shape[1]}; give a size to bring "
                    "them to one"
                )
            grey[index] = image
    if bad:
        raise InputError(f"cannot read {_names_text(bad)}; replace or remove what is damaged")
    return grey, tally


def _read(path: Path, tally: Tally, shape: PictureSize | None) -> npt.NDArray[Any]:
    from PIL import Image, UnidentifiedImageError

    # Pillow's decoders of other formats may start programs, as that of EPS does
    formats = ("PNG", "JPEG", "BMP", "GIF", "PPM", "TIFF", "WEBP")
    content = read_regular(path, 2**28, "replace or remove it")
    try:
        with Image.open(io.BytesIO(content), formats=formats) as image:
            pixels = image.width * image.height
            check_unpacked(pixels, len(content), str(path), "replace or remove it")
            grey = tally.grey(image, str(path))
    except InputError:
        raise
    except UnidentifiedImageError:
        # Pillow reads floats of 32 bits alone
        tiff = path.suffix.lower() in (".tif", ".tiff")
        kind = "floats of 16 or 64 bits, or no TIFF" if tiff else "no image of a kind that is read"
        raise _Unreadable(kind) from None
    except Exception as error:  # Pillow's decoders raise almost anything on a damaged file
        raise _Unreadable(str(error)) from error
    if shape is not None:
        grey = grey.resize(shape[::-1], Image.Resampling.BOX)
    return np.asarray(grey)

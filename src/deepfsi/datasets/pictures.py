"""Images in folders and zip files.

Both hold one folder for each class, or such folders within their own ``train/`` and ``test/``. A
zip file is read in place, never unpacked. It may come from anywhere, so that its names, the sizes
it declares and the images' own sizes are all checked before memory is spent on them.
"""

import io
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from deepfsi.datasets.arrays import Options, draw_stratified, split_arrays
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.decoding import Shape, Tally
from deepfsi.datasets.values import reflectance
from deepfsi.errors import InputError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".gif", ".pgm", ".tif", ".tiff", ".webp")
"""Ends of the names of image files."""

FORMATS = ("PNG", "JPEG", "BMP", "GIF", "PPM", "TIFF", "WEBP")
"""Formats that are decoded, by Pillow's names."""

MAX_FILE = 2**28
"""Bytes at most of one image in a zip file."""

MAX_PIXELS = 2**30
"""Pixels at most of all images together: 4.3 GB as float32."""


class Picture(NamedTuple):
    """An image that is not yet read."""

    label: str
    where: str  # for messages
    open: Callable[[], IO[bytes]]


def load_pictures(path: Path, options: Options) -> Dataset:
    """Load a folder or a zip file of images."""
    name = path.resolve().stem if path.is_file() else path.resolve().name
    with open_listings(path) as listings:
        return from_listings(listings, name, options)


def from_listings(
    listings: list[list[Picture]], name: str, options: Options, bilinear: bool = False
) -> Dataset:
    """Data set of the images of one part, or of a training and a test part."""
    # Parameters as of `load_dataset` and `read_all`
    shape, images = as_shape(options.size), options.images
    train, *test = listings
    if images is not None:
        if not test:
            raise InputError(
                f"{name}: {images} training images were asked for; that needs images with their "
                "own train and test folders, leave it out"
            )
        kept = draw_stratified([p.label for p in train], images, options.seed, name)
        train = [train[i] for i in kept]
    wanted = [*train, *(test[0] if test else [])]
    pixels, tally = read_all(wanted, shape, bilinear)
    levels = tally.levels(options.white)
    x, labels = reflectance(pixels, levels), np.array([picture.label for picture in wanted])
    n = len(train)
    drawn = "" if images is None else f"{images} training images drawn by class; "
    how = "resized bilinearly" if bilinear else "averaged"
    sized = f", {how} to {shape[0]}x{shape[1]} pixels" if shape else ""
    data = split_arrays(
        (x[:n], labels[:n]),
        (x[n:], labels[n:]) if test else (None, None),
        name=name,
        seed=options.seed,
        rescale=options.rescale,
        values=f"{drawn}{tally.words}{sized}; {levels.words}",
    )
    return replace(data, white=levels.white if levels.chosen else None)


def as_shape(size: int | tuple[int, ...] | None) -> Shape | None:
    """Height and width of a size that is one side or both."""
    if size is None:
        return None
    shape: tuple[int, ...] = size if isinstance(size, tuple) else (size, size)
    if not (len(shape) == 2 and min(shape) >= 1):
        raise InputError(f"size {size}: give one side or (H, W), in pixels, at least 1")
    return shape[0], shape[1]


def _check_total(images: int, shape: tuple[int, ...]) -> None:
    """Raise `InputError` for more pixels than memory is likely to hold."""
    height, width = shape
    if images * height * width > MAX_PIXELS:
        raise InputError(
            f"{images} images of {height}x{width} pixels need "
            f"{images * height * width * 4e-9:.1f} GB; give a smaller size, or fewer images"
        )


# ---------------------------------------------------------------- what there is


@contextmanager
def open_listings(path: Path) -> Iterator[list[list[Picture]]]:
    """Images of a folder or zip file: of one part, or of its training and test part."""
    if path.is_dir():
        yield list_folder(path)
        return
    try:
        archive = zipfile.ZipFile(path)
    except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile) as error:
        raise InputError(f"cannot read {path} as a zip file ({error}); pack it again") from error
    with archive:
        yield _list_zip(archive, path)


def list_folder(folder: Path) -> list[list[Picture]]:
    """Images of a folder: of one part, or of its training and test part."""
    parts = [folder / "train", folder / "test"]
    if not (all(part.is_dir() for part in parts) and any(p.is_dir() for p in parts[0].iterdir())):
        parts = [folder]
    return [_group(_walk(part), str(part)) for part in parts]


def _walk(folder: Path) -> Iterator[tuple[tuple[str, ...], Picture | None]]:
    for part in folder.iterdir():
        if part.is_dir():
            yield (part.name,), None
            for path in part.iterdir():
                yield (part.name, path.name), picture_file(path, part.name)


def picture_file(path: Path, label: str = "") -> Picture:
    """Picture of a file."""
    return Picture(label, str(path), lambda: path.open("rb"))


def _list_zip(archive: zipfile.ZipFile, path: Path) -> list[list[Picture]]:
    entries: dict[tuple[str, ...], Picture | None] = {}
    for info in archive.infolist():
        names = _safe_names(info, path)
        if names[0] == "__MACOSX" or any(name.startswith(".") for name in names):
            continue
        if names in entries and not info.is_dir():
            raise InputError(f"{path} holds {'/'.join(names)} twice; pack it again")
        picture = None
        if not info.is_dir():
            where = f"{path}/{'/'.join(names)}"
            label = names[-2] if len(names) > 1 else ""
            picture = Picture(label, where, partial(_open_entry, archive, info, where))
        entries[names] = picture

    found = list(entries.items())
    while len({names[0] for names, _ in found}) == 1 and any(len(names) > 2 for names, _ in found):
        found = [(names[1:], picture) for names, picture in found if len(names) > 1]
    parts = {
        part: [(names[1:], picture) for names, picture in found if names[0] == part and names[1:]]
        for part in ("train", "test")
    }
    own_split = parts["test"] and any(len(n) > 1 or not picture for n, picture in parts["train"])
    if own_split:
        return [_group(inside, f"{path}/{part}") for part, inside in parts.items()]
    return [_group(found, str(path))]


def _safe_names(info: zipfile.ZipInfo, path: Path) -> tuple[str, ...]:
    """Folders and file name of an entry, where nothing about it is a trick."""
    name = info.filename.replace("\\", "/")
    names = tuple(part for part in name.split("/") if part)
    absolute = name.startswith("/") or (names and names[0][1:2] == ":")
    if not names or absolute or ".." in names or not name.isprintable():
        raise InputError(
            f"{path} holds the name {info.filename!a}, which no honest zip file has; pack it again"
        )
    return names


def _open_entry(archive: zipfile.ZipFile, info: zipfile.ZipInfo, where: str) -> IO[bytes]:
    if info.flag_bits & 1:
        raise InputError(f"{where} is encrypted; pack it again without a password")
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise InputError(f"{where} is compressed in an unusual way; pack it with deflate or none")
    if info.file_size > MAX_FILE:
        raise InputError(
            f"{where} unpacks to {info.file_size / 1e6:.0f} MB; an image has {MAX_FILE / 1e6:.0f} "
            "MB or less, remove it"
        )
    with archive.open(info) as entry:
        # asked for no more than is declared, zipfile unpacks no more
        return io.BytesIO(entry.read(info.file_size + 1))


def _group(entries: Iterable[tuple[tuple[str, ...], Picture | None]], where: str) -> list[Picture]:
    """Images of all class folders, in the order of their names; what else lies there is ignored."""
    # `entries` are names from `where` on, with None for a folder
    classes: dict[str, list[tuple[str, Picture]]] = {}
    for names, picture in entries:
        if names[0].startswith(".") or (len(names) == 1 and picture):
            continue
        found = classes.setdefault(names[0], [])
        if len(names) == 2 and picture and is_image(names[1]):
            found.append((names[1], picture))
    if not classes:
        raise InputError(f"{where} has no sub-folders; put the images of each class into its own")
    for label, found in classes.items():
        if not found:
            raise InputError(
                f"the class folder {where}/{label} holds no images; add some "
                f"({' '.join(IMAGE_SUFFIXES)}) or remove it"
            )
    return [picture for label in sorted(classes) for _, picture in sorted(classes[label])]


def is_image(name: str) -> bool:
    """True for names of image files."""
    return name.lower().endswith(IMAGE_SUFFIXES) and not name.startswith(".")


# ---------------------------------------------------------------- reading


def read_all(
    pictures: list[Picture], shape: Shape | None, bilinear: bool
) -> tuple[npt.NDArray[Any], Tally]:
    """Grey images (n, H, W), all of one shape: uint8, or else float32 in their own values."""
    from PIL import Image

    if shape is not None:
        _check_total(len(pictures), shape)
    tally = Tally()
    with warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        first = _read(pictures[0], tally, shape, bilinear)
        _check_total(len(pictures), first.shape)
        grey = np.empty((len(pictures), *first.shape), first.dtype)
        grey[0] = first
        for i, picture in enumerate(pictures[1:], 1):
            image = _read(picture, tally, shape, bilinear)
            if image.shape != first.shape:
                raise InputError(
                    f"images differ in size: {pictures[0].where} is "
                    f"{first.shape[0]}x{first.shape[1]}, {picture.where} is "
                    f"{image.shape[0]}x{image.shape[1]}; give a size to bring them to one"
                )
            grey[i] = image
    return grey, tally


def _read(picture: Picture, tally: Tally, shape: Shape | None, bilinear: bool) -> npt.NDArray[Any]:
    from PIL import Image, UnidentifiedImageError

    try:
        with picture.open() as stream, Image.open(stream, formats=FORMATS) as image:
            grey = tally.grey(image, picture.where)
    except InputError:
        raise
    except Exception as error:  # Pillow's decoders raise almost anything on a damaged file
        reason = "no image" if isinstance(error, UnidentifiedImageError) else error
        raise InputError(
            f"cannot read the image {picture.where} ({reason}); replace or remove it"
        ) from error
    if shape is not None:
        how = Image.Resampling.BILINEAR if bilinear else Image.Resampling.BOX
        grey = grey.resize(shape[::-1], how)
    return np.asarray(grey)

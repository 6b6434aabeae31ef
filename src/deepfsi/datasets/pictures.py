"""Images in folders and zip files, and those that a ``.csv`` file names.

Folders and zip files hold one folder for each class, or such folders within their own ``train/``
and ``test/``. A ``.csv`` file has the name and the label, or the values, of an image in each line.
A zip file is read in place, never unpacked. It may come from anywhere, so that its names, the
sizes it declares and the images' own sizes are all checked before memory is spent on them.
"""

import io
import os
import shutil
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from math import prod
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from deepfsi.base import InputError, Message, check_unpacked, read_regular, readable_name
from deepfsi.base.numeric import check_memory, normal_name, open_zip, read_zip_entry
from deepfsi.datasets.arrays import (
    Names,
    Options,
    draw_stratified,
    split_arrays,
)
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.decoding import Shape, Tally, unread_kind
from deepfsi.datasets.picture_lists import IMAGE_SUFFIXES, Label, is_image, list_labels, listed
from deepfsi.datasets.values import LARGE

FORMATS = ("PNG", "JPEG", "BMP", "GIF", "PPM", "TIFF", "WEBP")
"""Formats that are decoded, by Pillow's names."""

MAX_FILE = 2**28
"""Bytes at most of one image."""

MAX_PIXELS = 2**34
"""Pixels at most of all images together: 17 GB of bytes."""


SPLITS = ("train", "test", "training", "testing", "val", "valid", "validation", "eval")
"""Names of folders, in lower case, that are parts of a data set and no classes."""

OF_SYSTEMS = ("__MACOSX", "@eaDir", "$RECYCLE.BIN", "System Volume Information", "lost+found")
"""Folders that operating systems and servers put beside those of a user, as do hidden ones."""

UTF8_FLAG = 0x800
"""Bit of an entry of a zip file whose name is in UTF-8; otherwise it is in code page 437."""

DEEPEST = 4
"""Folders below each other that are looked into."""


class Picture(NamedTuple):
    """An image that is not yet read."""

    label: Label
    where: str  # for messages
    open: Callable[[], IO[bytes]]


_Entry = tuple[tuple[str, ...], Picture | None]
"""Folders and name of a file with its picture, or of a folder with None."""


def load_pictures(path: Path, options: Options) -> Dataset:
    """Load the images of a folder, a zip file or a ``.csv`` file."""
    name = path.resolve().stem if path.is_file() else path.resolve().name
    if path.suffix.lower() == ".csv":
        listing, values = list_labels(path)
        pictures = [picture_file(each, label) for each, label in listing]
        return from_listings([pictures], name, options, values=values)
    with open_listings(path) as listings:
        return from_listings(listings, name, options)


def from_listings(
    listings: list[list[Picture]],
    name: str,
    options: Options,
    *,
    bilinear: bool = False,
    values: tuple[str, ...] = (),
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
    pixels, tally, kept_places = read_all(wanted, shape, bilinear, options.skip_bad)
    levels = tally.levels(options.white)
    labels = np.array([wanted[place].label for place in kept_places])
    n = sum(place < len(train) for place in kept_places)
    drawn = "" if images is None else f"{images} training images drawn by class; "
    sized = sized_text(shape, bilinear, tally.sizes)
    return split_arrays(
        (pixels[:n], labels[:n]),
        (pixels[n:], labels[n:]) if test else (None, None),
        names=Names(values=values or None),
        name=name,
        seed=options.seed,
        rescale=options.rescale,
        described=f"{drawn}{tally.words}{sized}; {levels.words}",
        levels=levels,
    )


def sized_text(shape: Shape | None, bilinear: bool, sizes: set[Shape]) -> str:
    """Say to what size images of some sizes were brought, as the end of a phrase."""
    how = "resized bilinearly" if bilinear else "averaged"
    return f", {how} to {shape[0]}x{shape[1]} pixels" if shape and sizes != {shape} else ""


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
    """Images of a source: of one part, or of its training and test part."""
    if path.is_dir():
        yield list_folder(path)
        return
    with open_zip(path, "pack it again") as archive:
        yield _list_zip(archive, path)


def list_folder(folder: Path) -> list[list[Picture]]:
    """Images of a folder: of one part, or of its training and test part."""
    return _listings(_walk(folder), str(folder))


def _walk(folder: Path, above: tuple[str, ...] = ()) -> Iterator[_Entry]:
    with os.scandir(folder) as entries:
        parts = [  # a folder among images that is called like one is refused as an image
            (entry, entry.is_dir() and not (above and is_image(entry.name)))
            for entry in entries
            if not _is_of_system(entry.name)
        ]
    for entry, is_dir in parts:
        names = (*above, readable_name(entry.name))
        yield names, None if is_dir else picture_file(Path(entry.path))
        if is_dir and len(names) < DEEPEST:
            yield from _walk(Path(entry.path), names)


def picture_file(path: Path, label: Label = "") -> Picture:
    """Picture of a file."""

    def read() -> IO[bytes]:
        return io.BytesIO(read_regular(path, MAX_FILE, "replace or remove it"))

    return Picture(label, str(path), read)


def _list_zip(archive: zipfile.ZipFile, path: Path) -> list[list[Picture]]:
    entries: dict[tuple[str, ...], Picture | None] = {}
    for info in archive.infolist():
        names = _safe_names(info, path)
        if any(map(_is_of_system, names)):
            continue
        if names in entries and not info.is_dir():
            raise InputError(f"{path} holds {'/'.join(names)} twice; pack it again")
        where = f"{path}/{'/'.join(names)}"
        opened = partial(_open_entry, archive, info, where)
        entries[names] = None if info.is_dir() else Picture("", where, opened)
    return _listings(entries.items(), str(path))


def _is_of_system(name: str) -> bool:
    return name.startswith(".") or name in OF_SYSTEMS


def _listings(entries: Iterable[_Entry], where: str) -> list[list[Picture]]:
    """Images of one part, or of a training and a test part, whose folders are so called."""
    found = list(entries)
    while len({names[0] for names, _ in found}) == 1 and any(len(names) > 2 for names, _ in found):
        found = [(names[1:], picture) for names, picture in found if len(names) > 1]
    inside: dict[str, list[_Entry]] = {}
    for names, picture in found:
        if len(names) > 1 or picture is None:
            entry = names[1:], picture
            inside.setdefault(names[0], []).extend([entry] if entry[0] else [])
    parts = {name.lower(): name for name in sorted(inside) if name.lower() in SPLITS[:2]}
    train = inside.get(parts.get("train", ""), [])
    if inside.get(parts.get("test", "")) and any(len(n) > 1 or not pic for n, pic in train):
        other = [
            "/".join(names)
            for names, picture in found
            if names[0] not in parts.values() and picture and is_image(names[-1])
        ]
        if other:
            raise InputError(
                f"{where} holds images outside of {' and '.join(parts.values())} "
                f"({listed(other)}): move them into one of the two, or away"
            )
        return [_group(inside[parts[part]], f"{where}/{parts[part]}") for part in SPLITS[:2]]
    if inside and all(name.lower() in SPLITS for name in inside):
        raise InputError(
            f"{where} holds the folders {', '.join(sorted(inside))}, which name no classes: put a "
            "folder of each class into train and test there"
        )
    return [_group(found, where)]


def _safe_names(info: zipfile.ZipInfo, path: Path) -> tuple[str, ...]:
    """Folders and file name of an entry, where nothing about it is a trick."""
    name = info.filename
    if not info.flag_bits & UTF8_FLAG:  # macOS writes UTF-8 without the flag that says so
        with suppress(UnicodeError):
            name = name.encode("cp437").decode("utf-8")
    name = name.replace("\\", "/")
    names = tuple(part for part in name.split("/") if part)
    absolute = name.startswith("/") or (names and names[0][1:2] == ":")
    if not names or absolute or ".." in names or not name.isprintable():
        raise InputError(
            f"{path} holds the name {info.filename!a}, which no honest zip file has; pack it again"
        )
    return names


def _open_entry(archive: zipfile.ZipFile, info: zipfile.ZipInfo, where: str) -> IO[bytes]:
    return io.BytesIO(
        read_zip_entry(archive, info, where=where, largest=MAX_FILE, advice="remove it")
    )


def _group(entries: Iterable[_Entry], where: str) -> list[Picture]:
    """Images of all class folders, in the order of their names; other files there are ignored."""
    # `entries` are names from `where` on
    classes: dict[str, list[tuple[str, Picture]]] = {}
    astray = []
    for names, picture in entries:
        found = (
            classes.setdefault(normal_name(names[0]), []) if len(names) > 1 or not picture else []
        )
        if picture and is_image(names[-1]):
            if len(names) == 2:
                found.append((names[1], picture._replace(label=normal_name(names[0]))))
            else:
                astray.append("/".join(names))
    if not classes:
        raise InputError(
            f"{where} has no sub-folders; put the images of each class into its own, or give a "
            ".csv file of file names and labels"
        )
    if astray:
        raise InputError(
            f"{where} holds images that lie in no folder of a class, or in folders within one "
            f"({listed(astray)}): move them into the folder of their class, or away"
        )
    for label, found in classes.items():
        if not found:
            raise InputError(
                f"the class folder {where}/{label} holds no images; add some "
                f"({' '.join(IMAGE_SUFFIXES)}) or remove it"
            )
    return [picture for label in sorted(classes) for _, picture in sorted(classes[label])]


# ---------------------------------------------------------------- reading


class _Unreadable(InputError):
    """An image that is damaged."""


def read_all(
    pictures: list[Picture],
    shape: Shape | None,
    bilinear: bool = False,
    skip_bad: bool | None = None,
) -> tuple[npt.NDArray[Any], Tally, list[int]]:
    """Grey images (n, H, W), all of one shape: uint8, or else float32 in their own values."""
    # And the places of those that were read. Damaged ones are left out, or named, all at once;
    # with None the message offers no way to leave them out
    from PIL import Image

    if shape is not None:
        _check_total(len(pictures), shape)
    tally = Tally()
    kept: list[int] = []
    bad: list[tuple[str, str]] = []
    grey: npt.NDArray[Any] = np.empty(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        for place, picture in enumerate(pictures):
            try:
                image = _read(picture, tally, shape, bilinear)
            except _Unreadable as error:
                bad.append((picture.where, str(error)))
                continue
            if not kept:
                _check_total(len(pictures), image.shape)
                grey = _room((len(pictures), *image.shape), image.dtype)
            if image.shape != grey.shape[1:]:
                raise InputError(
                    f"images differ in size: {tally.first} is {grey.shape[1]}x{grey.shape[2]}, "
                    f"{picture.where} is {image.shape[0]}x{image.shape[1]}; give a size to bring "
                    "them to one"
                )
            grey[len(kept)] = image
            kept.append(place)
            filled = len(kept) * image.size
            check_unpacked(filled, tally.packed, "these images", "give a smaller size, or fewer")
    if bad and not (skip_bad and kept):
        raise InputError(_bad_text(bad, skip_bad is False))
    tally.bad = tuple(where for where, _ in bad)
    return grey[: len(kept)], tally, kept


def _room(shape: tuple[int, ...], kind: np.dtype[Any]) -> npt.NDArray[Any]:
    """Array for the values of images; of many a file that has no name and ends with it."""
    if 4 * prod(shape) <= LARGE:
        return np.empty(shape, kind)
    needed = prod(shape) * kind.itemsize
    place = tempfile.gettempdir()
    check_memory(
        needed,
        shutil.disk_usage(place).free,
        f"{shape[0]} images of {shape[1]}x{shape[2]} pixels, in {place}",
        "give a smaller size or fewer images, or set TMPDIR to a folder with more room",
    )
    with tempfile.TemporaryFile() as file:
        return np.memmap(file, kind, "w+", shape=shape)


def _bad_text(bad: list[tuple[str, str]], may_skip: bool) -> str:
    """Name damaged images, each with what is wrong, and say what to do."""
    wheres, reasons = zip(*bad, strict=True)
    named = listed([f"{where} ({reason})" for where, reason in bad])
    if len(set(reasons)) == 1:
        named = f"{listed(wheres)} ({reasons[0]})"
    what, them = ("the image", "it") if len(bad) == 1 else (f"{len(bad)} images:", "them")
    text = f"cannot read {what} {named}; replace or remove {them}"
    if not may_skip:
        return text
    return Message(
        "{text}, or leave {them} out with {skip_bad}", setting="skip_bad", text=text, them=them
    )


def _read(picture: Picture, tally: Tally, shape: Shape | None, bilinear: bool) -> npt.NDArray[Any]:
    from PIL import Image, UnidentifiedImageError

    try:
        with picture.open() as stream:
            size = stream.seek(0, io.SEEK_END)

            def again() -> Image.Image:
                stream.seek(0)
                try:
                    return Image.open(stream, formats=FORMATS)
                except UnidentifiedImageError:
                    raise _Unreadable(unread_kind(stream)) from None

            with again() as image:
                pixels, advice = image.width * image.height, "replace or remove it"
                check_unpacked(pixels, size, picture.where, advice)
                grey = tally.grey(image, picture.where, again)
        tally.packed += size
    except InputError:
        raise
    except Exception as error:  # Pillow's decoders raise almost anything on a damaged file
        raise _Unreadable(str(error)) from error
    if shape is not None:
        how = Image.Resampling.BILINEAR if bilinear else Image.Resampling.BOX
        grey = grey.resize(shape[::-1], how)
    return np.asarray(grey)

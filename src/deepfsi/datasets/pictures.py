"""Images in folders and zip files, and those that a ``.csv`` file names.

Folders and zip files hold one folder for each class, or such folders within their own ``train/``
and ``test/``. A ``.csv`` file has the name and the label, or the values, of an image in each line.
A zip file is read in place, never unpacked. It may come from anywhere, so that its names, the
sizes it declares and the images' own sizes are all checked before memory is spent on them.
"""

import csv
import io
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from deepfsi.datasets.arrays import Names, Options, draw_stratified, split_arrays
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.decoding import Shape, Tally
from deepfsi.datasets.values import reflectance
from deepfsi.errors import InputError
from deepfsi.files import check_unpacked, read_regular
from deepfsi.tables.zip_files import open_zip, read_entry

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".gif", ".pgm", ".tif", ".tiff", ".webp")
"""Ends of the names of image files."""

FORMATS = ("PNG", "JPEG", "BMP", "GIF", "PPM", "TIFF", "WEBP")
"""Formats that are decoded, by Pillow's names."""

MAX_FILE = 2**28
"""Bytes at most of one image."""

MAX_PIXELS = 2**30
"""Pixels at most of all images together: 4.3 GB as float32."""


MOST_NAMES = 20
"""Images that one line names at most."""

LIST_ADVICE = "give a line of text for each image, its file name and its label, or its values"
"""What to do about a list of images that cannot be used."""


class Picture(NamedTuple):
    """An image that is not yet read."""

    label: str | tuple[float, ...]  # its class, or its values
    where: str  # for messages
    open: Callable[[], IO[bytes]]


def load_pictures(path: Path, options: Options) -> Dataset:
    """Load the images of a folder, a zip file or a ``.csv`` file."""
    name = path.resolve().stem if path.is_file() else path.resolve().name
    if path.suffix.lower() == ".csv":
        pictures, values = list_labels(path)
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
    x, n = reflectance(pixels, levels), sum(place < len(train) for place in kept_places)
    drawn = "" if images is None else f"{images} training images drawn by class; "
    sized = sized_text(shape, bilinear)
    data = split_arrays(
        (x[:n], labels[:n]),
        (x[n:], labels[n:]) if test else (None, None),
        names=Names(values=values or None),
        name=name,
        seed=options.seed,
        rescale=options.rescale,
        described=f"{drawn}{tally.words}{sized}; {levels.words}",
    )
    return replace(data, white=levels.white if levels.chosen else None)


def sized_text(shape: Shape | None, bilinear: bool) -> str:
    """Say to what size images were brought, as the end of a phrase."""
    how = "resized bilinearly" if bilinear else "averaged"
    return f", {how} to {shape[0]}x{shape[1]} pixels" if shape else ""


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
    parts = [folder / "train", folder / "test"]
    if not (all(part.is_dir() for part in parts) and any(p.is_dir() for p in parts[0].iterdir())):
        parts = [folder]
    return [_group(_walk(part), str(part)) for part in parts]


def list_labels(path: Path) -> tuple[list[Picture], tuple[str, ...]]:
    """Images that a ``.csv`` file names, with their labels or values, and the values' names."""
    # Names are from the folder beside it that has its name, `pets/` of `pets.csv`, or else from its
    # own folder. A first line that names no image is a heading. Numbers are values where a line has
    # several, or any has a decimal point or an exponent; whole numbers are classes, as in arrays
    try:
        lines = read_regular(path, MAX_FILE, LIST_ADVICE).decode("utf-8-sig").splitlines()
        rows = list(csv.reader(lines, delimiter=next((d for d in ";\t" if d in lines[0]), ",")))
    except (OSError, UnicodeDecodeError, csv.Error, IndexError) as error:
        raise InputError(f"cannot read {path} ({error}): {LIST_ADVICE}") from error
    folder = path.with_suffix("") if path.with_suffix("").is_dir() else path.parent
    heading: list[str] = []
    if not (rows[0] and is_image(Path(rows[0][0].strip()).name)):
        heading = [cell.strip() for cell in rows[0][1:]]
        rows[0] = []
    names, answers = list[str](), list[list[str]]()
    for number, row in enumerate(rows, 1):
        if not row:
            continue
        name, *cells = map(str.strip, row)
        as_many = len(cells) == len(answers[0]) if answers else len(cells) > 0
        if not (is_image(Path(name).name) and as_many and all(cells)):
            raise InputError(
                f"{path}, line {number}: {', '.join(row)!r} is not an image "
                f"and its label: {LIST_ADVICE}"
            )
        names.append(name)
        answers.append(cells)
    if not names:
        raise InputError(f"{path} names no image: {LIST_ADVICE}")
    values = _values_of(answers, path)
    labels: Sequence[str | tuple[float, ...]] = values or [label for [label] in answers]
    pictures = [
        picture_file(folder / name, label) for name, label in zip(names, labels, strict=True)
    ]
    missing = [picture.where for picture in pictures if not Path(picture.where).is_file()]
    if missing:
        raise InputError(
            f"{path} names {len(missing)} images that are not there, {_listed(missing)}: names are "
            f"from the folder {folder} on"
        )
    lines_of = Counter(picture.where for picture in pictures)
    if twice := [where for where, count in lines_of.items() if count > 1]:
        raise InputError(f"{path} names {_listed(twice)} twice: give each image one line")
    return pictures, tuple(heading) if values and len(heading) == len(values[0]) else ()


def _values_of(rows: list[list[str]], path: Path) -> list[tuple[float, ...]]:
    """Values of images, or none where their cells are labels."""
    columns = len(rows[0])
    if columns == 1 and all(cell.lstrip("+-").isdigit() for [cell] in rows):
        return []
    try:
        return [tuple(map(float, cells)) for cells in rows]
    except ValueError as error:
        if columns == 1:
            return []
        raise InputError(
            f"{path} has {columns} columns beside the file name, and a cell that is no number "
            f"({error}): {LIST_ADVICE}"
        ) from None


def _walk(folder: Path) -> Iterator[tuple[tuple[str, ...], Picture | None]]:
    for part in folder.iterdir():
        if part.is_dir():
            yield (part.name,), None
            for path in part.iterdir():
                yield (part.name, path.name), picture_file(path, part.name)


def picture_file(path: Path, label: str | tuple[float, ...] = "") -> Picture:
    """Picture of a file."""

    def read() -> IO[bytes]:
        return io.BytesIO(read_regular(path, MAX_FILE, "replace or remove it"))

    return Picture(label, str(path), read)


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
    return io.BytesIO(read_entry(archive, info, where, MAX_FILE, "remove it"))


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
        raise InputError(
            f"{where} has no sub-folders; put the images of each class into its own, or give a "
            ".csv file of file names and labels"
        )
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
                grey = np.empty((len(pictures), *image.shape), image.dtype)
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


def _listed(names: list[str]) -> str:
    """Names for a message, the first of many."""
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return ", ".join(names[:MOST_NAMES]) + more


def _bad_text(bad: list[tuple[str, str]], may_skip: bool) -> str:
    """Name damaged images, each with what is wrong, and say what to do."""
    named = _listed([f"{where} ({reason})" for where, reason in bad])
    what, them = ("the image", "it") if len(bad) == 1 else (f"{len(bad)} images:", "them")
    advice = f", or leave {them} out with `skip_bad`" if may_skip else ""
    return f"cannot read {what} {named}; replace or remove {them}{advice}"


def _read(picture: Picture, tally: Tally, shape: Shape | None, bilinear: bool) -> npt.NDArray[Any]:
    from PIL import Image, UnidentifiedImageError

    try:
        with picture.open() as stream:
            size = stream.seek(0, io.SEEK_END)

            def again() -> Image.Image:
                stream.seek(0)
                return Image.open(stream, formats=FORMATS)

            with again() as image:
                pixels, advice = image.width * image.height, "replace or remove it"
                check_unpacked(pixels, size, picture.where, advice)
                grey = tally.grey(image, picture.where, again)
        tally.packed += size
    except InputError:
        raise
    except Exception as error:  # Pillow's decoders raise almost anything on a damaged file
        no_image = isinstance(error, UnidentifiedImageError)
        raise _Unreadable("no image" if no_image else str(error)) from error
    if shape is not None:
        how = Image.Resampling.BILINEAR if bilinear else Image.Resampling.BOX
        grey = grey.resize(shape[::-1], how)
    return np.asarray(grey)

"""Images in folders and zip files, and those that a ``.csv`` file names.

Folders and zip files hold one folder for each class, or such folders within their own ``train/``
and ``test/``. A ``.csv`` file has the name and the label, or the values, of an image in each line.
A zip file is read in place, never unpacked. It may come from anywhere, so that the
sizes it declares and the images' own sizes are checked before memory is spent on them.
"""

import io
import os
import re
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import IO, Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from deepfsi.base.arrays import check_memory, free_memory, open_zip
from deepfsi.base.errors import InputError
from deepfsi.base.files import check_unpacked, read_regular, readable_name
from deepfsi.base.tables import LABEL_HEADS, normal_name, read_cells
from deepfsi.datasets.arrays import draw_stratified, split_arrays
from deepfsi.datasets.dataset import Dataset, Origin
from deepfsi.datasets.levels import PICTURE_FORMATS, PictureSize, Tally

Label: TypeAlias = str | tuple[float, ...]
"""Class of an image, or its values."""

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".gif", ".pgm", ".tif", ".tiff", ".webp")
"""Ends of the names of image files."""

MAX_FILE = 2**28
"""Bytes at most of one image, and of a list of images."""

MOST_NAMES = 20
"""Images that one line names at most."""

PART_NAMES = ("train", "test")
"""Names of folders, in lower case, that are parts of a data set and no classes."""

OF_SYSTEMS = ("__MACOSX", "@eaDir", "$RECYCLE.BIN", "System Volume Information", "lost+found")
"""Folders that operating systems and servers put beside those of a user, as do hidden ones."""

UTF8_FLAG = 0x800
"""Bit of an entry of a zip file whose name is in UTF-8; otherwise it is in code page 437."""

DEEPEST = 4
"""Folders below each other that are looked into."""

LIST_ADVICE = "give a line of text for each image, its file name and its label, or its values"
"""What to do about a list of images that cannot be used."""


class Picture(NamedTuple):
    """An image that is not yet read."""

    label: Label
    where: str  # for messages
    open: Callable[[], IO[bytes]]


class Listing(NamedTuple):
    """Images of one part, or of a training and a test part; with values, their names."""

    parts: list[list[Picture]]
    values: tuple[str, ...] = ()


_Entry = tuple[tuple[str, ...], Picture | None]
"""Folders and name of a file with its picture, or of a folder with None."""


def load_pictures(path: Path, options: Origin) -> Dataset:
    """Load the images of a folder, a zip file or a ``.csv`` file."""
    name = path.resolve().stem if path.is_file() else path.resolve().name
    with open_listing(path) as listing:
        return dataset_of_pictures(listing, name, options)


def dataset_of_pictures(
    listing: Listing, name: str, options: Origin, bilinear: bool = False
) -> Dataset:
    """Data set of listed images."""
    shape = options.size
    images = options.images
    train, *test = listing.parts
    if images is not None:
        if not test:
            raise InputError(
                f"{name}: {images} training images were asked for; that needs images with their "
                "own train and test folders, leave it out"
            )
        kept = draw_stratified([p.label for p in train], images, options.seed, name)
        train = [train[i] for i in kept]
    pictures = [*train, *(test[0] if test else [])]
    pixels, tally = decode_pictures(pictures, shape, bilinear, options.skip_bad)
    levels = tally.levels(options.white)
    labels = np.array([pictures[index].label for index in tally.kept])
    n = sum(index < len(train) for index in tally.kept)
    drawn = "" if images is None else f"{images} training images drawn by class; "
    return split_arrays(
        (pixels[:n], labels[:n]),
        (pixels[n:], labels[n:]) if test else (None, None),
        values=listing.values or None,
        name=name,
        seed=options.seed,
        rescale=options.rescale,
        described=f"{drawn}{tally.words}{sized_text(shape, bilinear, tally.sizes)}; {levels.words}",
        levels=levels,
    )


def sized_text(shape: PictureSize | None, bilinear: bool, sizes: set[PictureSize]) -> str:
    """Say to what size images of some sizes were brought, as the end of a phrase."""
    how = "resized bilinearly" if bilinear else "averaged"
    return f", {how} to {shape[0]}x{shape[1]} pixels" if shape and sizes != {shape} else ""


def as_shape(size: int | tuple[int, ...] | None) -> PictureSize | None:
    """Height and width of a size that is one side or both."""
    if size is None:
        return None
    shape: tuple[int, ...] = size if isinstance(size, tuple) else (size, size)
    if not (len(shape) == 2 and min(shape) >= 1):
        raise InputError(f"size {size}: give one side or (H, W), in pixels, at least 1")
    return shape[0], shape[1]


# ---------------------------------------------------------------- lists


def _list_named(path: Path) -> Listing:
    """Images that a ``.csv`` file names, with their labels or values, and the values' names.

    Names are from the folder beside it that has its name, ``pets/`` of ``pets.csv``, or else from
    its own folder. A first line that names no file is a heading. Numbers are values where a line
    has several, or any has a decimal point or an exponent; whole numbers are classes, as in arrays.
    """
    cells = read_cells(path, LIST_ADVICE)
    heads: tuple[str, ...] = ()
    if cells.height and not re.search(r"[./\\]", cells[0, 0] or ""):
        _, *words = cells.row(0)
        heads = tuple(word or "" for word in words)
        cells = cells[1:]
    if cells.is_empty() or cells.width < 2 or any(cells.null_count().row(0)):
        raise InputError(f"{path} does not give each image all its cells: {LIST_ADVICE}")
    names, *columns = [column.to_list() for column in cells.iter_columns()]
    if wrong := [name for name in names if not is_image(Path(name).name)]:
        raise InputError(f"{path} names {_names_text(wrong)}, no image: {LIST_ADVICE}")
    values = _values_of(columns, path)
    labels: Sequence[Label] = values or [normal_name(label) for label in columns[0]]
    folder = path.with_suffix("") if path.with_suffix("").is_dir() else path.parent
    paths = [folder / name.replace("\\", "/") for name in names]
    if missing := [str(file) for file in paths if not file.is_file()]:
        raise InputError(
            f"{path} names {len(missing)} images that are not there, {_names_text(missing)}: names "
            f"are from the folder {folder} on"
        )
    if twice := [str(file) for file, count in Counter(paths).items() if count > 1]:
        raise InputError(f"{path} names {_names_text(twice)} twice: give each image one line")
    named = values and (len(columns) > 1 or (heads and heads[0].lower() not in LABEL_HEADS))
    return Listing([list(map(picture_file, paths, labels))], heads if named else ())


def _values_of(columns: list[list[str]], path: Path) -> list[tuple[float, ...]]:
    """Values of images, or none where their cells are labels: words, or one whole number each."""
    try:
        numbers = [list(map(float, column)) for column in columns]
    except ValueError:
        if len(columns) > 1:
            raise InputError(
                f"{path} has {len(columns)} columns beside the file name, and a cell in them that "
                f"is no number: {LIST_ADVICE}"
            ) from None
        return []
    if len(columns) == 1 and all(re.fullmatch(r"[+-]?\d+", cell) for cell in columns[0]):
        return []
    return list(zip(*numbers, strict=True))


def is_image(name: str) -> bool:
    """True for names of image files."""
    return name.lower().endswith(IMAGE_SUFFIXES) and not name.startswith(".")


def _names_text(names: Sequence[str]) -> str:
    """Names for a message, the first of many."""
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return ", ".join(names[:MOST_NAMES]) + more


# ---------------------------------------------------------------- folders and zip files


@contextmanager
def open_listing(path: Path) -> Iterator[Listing]:
    """Images of a folder, a zip file or a ``.csv`` file, which can be read within the block."""
    if path.is_dir():
        yield _listing(_walk(path), str(path))
    elif path.suffix.lower() == ".csv":
        yield _list_named(path)
    else:
        with open_zip(path, "pack it again") as archive:
            yield _listing(_zip_entries(archive, path), str(path))


def _walk(folder: Path, above: tuple[str, ...] = ()) -> Iterator[_Entry]:
    with os.scandir(folder) as entries:
        inside = [  # a folder among images that is called like one is refused as an image
            (entry, entry.is_dir() and not (above and is_image(entry.name)))
            for entry in entries
            if not _is_of_system(entry.name)
        ]
    for entry, is_dir in inside:
        names = (*above, readable_name(entry.name))
        yield names, None if is_dir else picture_file(Path(entry.path))
        if is_dir and len(names) < DEEPEST:
            yield from _walk(Path(entry.path), names)


def picture_file(path: Path, label: Label = "") -> Picture:
    """Picture of a file."""

    def read() -> IO[bytes]:
        return io.BytesIO(read_regular(path, MAX_FILE, "replace or remove it"))

    return Picture(label, str(path), read)


def _zip_entries(archive: zipfile.ZipFile, path: Path) -> Iterable[_Entry]:
    def read(info: zipfile.ZipInfo) -> IO[bytes]:
        with archive.open(info) as entry:
            # asked for no more than is declared, zipfile unpacks no more
            return io.BytesIO(entry.read(info.file_size + 1))

    for info in archive.infolist():
        name = info.filename
        if not info.flag_bits & UTF8_FLAG:  # macOS writes UTF-8 without the flag that says so
            with suppress(UnicodeError):
                name = name.encode("cp437").decode("utf-8")
        names = tuple(word for word in name.replace("\\", "/").split("/") if word)
        if names and not any(map(_is_of_system, names)):
            where = f"{path}/{'/'.join(names)}"
            yield names, None if info.is_dir() else Picture("", where, partial(read, info))


def _is_of_system(name: str) -> bool:
    return name.startswith(".") or name in OF_SYSTEMS


def _listing(entries: Iterable[_Entry], where: str) -> Listing:
    """Images of one part, or of a training and a test part, whose folders are so called."""
    files = list(entries)
    while len({names[0] for names, _ in files}) == 1 and any(len(names) > 2 for names, _ in files):
        files = [(names[1:], picture) for names, picture in files if len(names) > 1]
    inside: dict[str, list[_Entry]] = {part: [] for part in PART_NAMES}
    for names, picture in files:
        if len(names) > 2 and names[0].lower() in PART_NAMES:
            inside[names[0].lower()].append((names[1:], picture))
    if all(inside.values()):
        other = [
            "/".join(names)
            for names, picture in files
            if names[0].lower() not in PART_NAMES and picture and is_image(names[-1])
        ]
        if other:
            raise InputError(
                f"{where} holds images outside of train and test ({_names_text(other)}): move "
                "them into one of the two, or away"
            )
        parts = [_by_class(entries, f"{where}/{part}") for part, entries in inside.items()]
        return Listing(parts)
    return Listing([_by_class(files, where)])


def _by_class(entries: Iterable[_Entry], where: str) -> list[Picture]:
    """Images of all class folders, in the order of their names; other files there are ignored.

    The names of the entries are from `where` on.
    """
    classes: dict[str, list[tuple[str, Picture]]] = {}
    astray = []
    for names, picture in entries:
        label = normal_name(names[0])
        if len(names) > 1 or not picture:
            classes.setdefault(label, [])
        if picture and is_image(names[-1]):
            if len(names) == 2:
                classes[label].append((names[1], picture._replace(label=label)))
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
            f"({_names_text(astray)}): move them into the folder of their class, or away"
        )
    if empty := [label for label, images in classes.items() if not images]:
        raise InputError(
            f"the class folder {where}/{empty[0]} holds no images; add some "
            f"({' '.join(IMAGE_SUFFIXES)}) or remove it"
        )
    in_order = (sorted(classes[label], key=itemgetter(0)) for label in sorted(classes))
    return [picture for images in in_order for _, picture in images]


# ---------------------------------------------------------------- reading


class _Unreadable(InputError):
    """An image that is damaged."""


def decode_pictures(
    pictures: list[Picture],
    shape: PictureSize | None,
    bilinear: bool = False,
    skip_bad: bool | None = None,
) -> tuple[npt.NDArray[Any], Tally]:
    """Grey images (n, H, W), all of one shape, and a tally of what they were."""
    from PIL import Image

    tally = Tally()
    bad: list[tuple[str, str]] = []
    grey: npt.NDArray[Any] = np.empty(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        for index, picture in enumerate(pictures):
            try:
                image = _read(picture, tally, shape, bilinear)
            except _Unreadable as error:
                bad.append((picture.where, str(error)))
                continue
            if not tally.kept:
                check_memory(
                    len(pictures) * image.nbytes,
                    free_memory(),
                    f"{len(pictures)} images of {image.shape[0]}x{image.shape[1]} pixels",
                    "give a smaller size, or fewer",
                )
                grey = np.empty((len(pictures), *image.shape), image.dtype)
            if image.shape != grey.shape[1:]:
                raise InputError(
                    f"images differ in size: {tally.first} is {grey.shape[1]}x{grey.shape[2]}, "
                    f"{picture.where} is {image.shape[0]}x{image.shape[1]}; give a size to bring "
                    "them to one"
                )
            grey[len(tally.kept)] = image
            tally.kept.append(index)
            filled = len(tally.kept) * image.size
            check_unpacked(filled, tally.packed, "these images", "give a smaller size, or fewer")
    if bad and not (skip_bad and tally.kept):
        raise InputError(_bad_text(bad, skip_bad is False))
    tally.bad = tuple(where for where, _ in bad)
    return grey[: len(tally.kept)], tally


def _bad_text(bad: list[tuple[str, str]], may_skip: bool) -> str:
    """Name damaged images, each with what is wrong, and say what to do."""
    named = _names_text([f"{where} ({reason})" for where, reason in bad])
    what = "the image" if len(bad) == 1 else f"{len(bad)} images:"
    them = "it" if len(bad) == 1 else "them"
    skip = f", or leave {them} out with `skip_bad`" if may_skip else ""
    return f"cannot read {what} {named}; replace or remove {them}{skip}"


def _read(
    picture: Picture, tally: Tally, shape: PictureSize | None, bilinear: bool
) -> npt.NDArray[Any]:
    from PIL import Image, UnidentifiedImageError

    try:
        with picture.open() as stream:
            size = stream.seek(0, io.SEEK_END)
            with Image.open(stream, formats=PICTURE_FORMATS) as image:
                pixels = image.width * image.height
                check_unpacked(pixels, size, picture.where, "replace or remove it")
                grey = tally.grey(image, picture.where)
        tally.packed += size
    except InputError:
        raise
    except UnidentifiedImageError:
        raise _Unreadable("no image of a kind that is read") from None
    except Exception as error:  # Pillow's decoders raise almost anything on a damaged file
        raise _Unreadable(str(error)) from error
    if shape is not None:
        how = Image.Resampling.BILINEAR if bilinear else Image.Resampling.BOX
        grey = grey.resize(shape[::-1], how)
    return np.asarray(grey)

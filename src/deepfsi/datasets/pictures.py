"""Images in folders, and those that a ``.csv`` file names.

A folder holds one folder for each class, or such folders within its own ``train/`` and ``test/``. A
``.csv`` file has the name and the label, or the values, of an image in each line. Images may come
from anywhere, so that their sizes are checked before memory is spent on them.
"""

import io
import re
import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from deepfsi.base.arrays import check_memory, free_memory
from deepfsi.base.errors import InputError
from deepfsi.base.files import check_unpacked, read_regular, readable_name
from deepfsi.base.tables import LABEL_HEADS, normal_name, read_cells
from deepfsi.datasets.arrays import draw_stratified, split_arrays
from deepfsi.datasets.dataset import Dataset, Origin
from deepfsi.datasets.levels import PictureSize, Tally

Label: TypeAlias = str | tuple[float, ...]
"""Class of an image, or its values."""

IMAGE_SUFFIXES = (
    *(".png", ".jpg", ".jpeg", ".jpe", ".jfif", ".bmp", ".gif", ".tif", ".tiff", ".webp"),
    *(".pgm", ".ppm", ".pbm", ".pnm"),
    *(".jp2", ".heic", ".avif"),  # refused when they are read: a class would lack them in silence
)
"""Ends of the names of image files."""

OF_SYSTEMS = ("__MACOSX", "@eaDir", "$RECYCLE.BIN", "System Volume Information", "lost+found")
"""Folders that operating systems and servers put beside those of a user, as do hidden ones."""

LIST_ADVICE = "give a line of text for each image, its file name and its label, or its values"
"""What to do about a list of images that cannot be used."""


class Picture(NamedTuple):
    """Image that is not yet read."""

    path: Path
    label: Label = ""


class Listing(NamedTuple):
    """Images of one part, or of a training and a test part; with values, their names."""

    parts: list[list[Picture]]
    values: tuple[str, ...] = ()


def load_pictures(path: Path, options: Origin, name: str = "", bilinear: bool = False) -> Dataset:
    """Data set of the images of a folder or of a ``.csv`` file, which gives the name, too."""
    whole = path.resolve()
    name = name or (whole.stem if path.is_file() else whole.name)
    shape = options.size
    images = options.images
    listing = list_pictures(path)
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
    pixels, tally = decode_pictures(pictures, shape, bilinear)
    levels = tally.levels(options.white)
    labels = np.array([picture.label for picture in pictures])
    n = len(train)
    drawn = "" if images is None else f"{images} training images drawn by class; "
    return split_arrays(
        (pixels[:n], labels[:n]),
        (pixels[n:], labels[n:]) if test else None,
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
    return Listing([list(map(Picture, paths, labels))], heads if named else ())


def _values_of(columns: list[list[str]], path: Path) -> list[tuple[float, ...]]:
    """Values of images, or none where their cells are labels: words, or one whole number each."""
    try:
        # Python takes 1_0 for 10
        numbers = [[float(cell.replace("_", "?")) for cell in column] for column in columns]
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


def _names_text(names: Sequence[str | Path]) -> str:
    """Twenty of many names, for a message."""
    more = f" and {len(names) - 20} more" if len(names) > 20 else ""
    return ", ".join(readable_name(str(name)) for name in names[:20]) + more


# ---------------------------------------------------------------- folders


def list_pictures(path: Path) -> Listing:
    """Images of a folder or of a ``.csv`` file."""
    if not path.is_dir():
        return _list_named(path)
    entries = _entries(path)
    folders = {each.name.lower(): each for each in entries if each.is_dir()}
    if not {"train", "test"} <= folders.keys():
        return Listing([_by_class(path)])
    parts = [folders.pop("train"), folders.pop("test")]
    other = [each for each in entries if is_image(each.name)] + _images_below(folders.values())
    if other:
        raise InputError(
            f"{path} holds images outside of train and test ({_names_text(other)}): move them into "
            "one of the two, or away"
        )
    return Listing(list(map(_by_class, parts)))


def _entries(folder: Path) -> list[Path]:
    """Files and folders of the user."""
    every = folder.iterdir()
    return [each for each in every if each.name[0] != "." and each.name not in OF_SYSTEMS]


def _images_below(folders: Iterable[Path]) -> list[Path]:
    return [file for each in folders for file in each.rglob("*") if is_image(file.name)]


def _by_class(folder: Path) -> list[Picture]:
    """Images of all class folders, by class and name; other files there are ignored."""
    entries = _entries(folder)
    folders = [each for each in entries if each.is_dir()]
    if not folders:
        raise InputError(
            f"{folder} has no sub-folders; put the images of each class into its own, or give a "
            ".csv file of file names and labels"
        )
    astray = [each for each in entries if is_image(each.name) and each not in folders]
    pictures: list[Picture] = []
    for each in folders:
        inside = _entries(each)
        # A folder that is called like an image is refused when it is read
        images = [file for file in inside if is_image(file.name)]
        astray += _images_below(other for other in inside if not is_image(other.name))
        if not (images or astray):
            raise InputError(f"the class folder {each} holds no images; add some or remove it")
        label = normal_name(readable_name(each.name))
        pictures += [Picture(file, label) for file in images]
    if astray:
        raise InputError(
            f"{folder} holds images that lie in no folder of a class, or in folders within one "
            f"({_names_text(astray)}): move them into the folder of their class, or away"
        )
    return sorted(pictures, key=lambda each: (each.label, readable_name(each.path.name)))


# ---------------------------------------------------------------- reading


class _Unreadable(InputError):
    """An image that is damaged."""


def decode_pictures(
    pictures: list[Picture], shape: PictureSize | None, bilinear: bool = False
) -> tuple[npt.NDArray[Any], Tally]:
    """Grey images (n, H, W) of equal shape, and a tally of what they were."""
    from PIL import Image

    tally = Tally()
    bad: list[str] = []
    grey: npt.NDArray[Any] = np.empty(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        for index, picture in enumerate(pictures):
            try:
                image = _read(picture.path, tally, shape, bilinear)
            except _Unreadable as error:
                bad.append(f"{picture.path} ({error})")
                continue
            if tally.count == 1:
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
                    f"{picture.path} is {image.shape[0]}x{image.shape[1]}; give a size to bring "
                    "them to one"
                )
            grey[index] = image
            filled = tally.count * image.size
            check_unpacked(filled, tally.packed, "these images", "give a smaller size, or fewer")
    if bad:
        raise InputError(f"cannot read {_names_text(bad)}; replace or remove what is damaged")
    return grey, tally


def _read(path: Path, tally: Tally, shape: PictureSize | None, bilinear: bool) -> npt.NDArray[Any]:
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
        raise _Unreadable("no image of a kind that is read") from None
    except Exception as error:  # Pillow's decoders raise almost anything on a damaged file
        raise _Unreadable(str(error)) from error
    tally.packed += len(content)
    if shape is not None:
        how = Image.Resampling.BILINEAR if bilinear else Image.Resampling.BOX
        grey = grey.resize(shape[::-1], how)
    return np.asarray(grey)

"""Images in folders of classes, also within ``train/`` and ``test/``, and in lists of ``.csv``.

Images may come from anywhere, so that their sizes are checked before memory is spent on them.
"""

import io
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from deepfsi.base.arrays import check_memory
from deepfsi.base.errors import InputError
from deepfsi.base.files import check_unpacked, read_regular, readable_name
from deepfsi.base.quantities import plural
from deepfsi.base.tables import normal_name, read_cells
from deepfsi.datasets.arrays import draw_stratified, split_arrays
from deepfsi.datasets.dataset import Dataset, Origin
from deepfsi.datasets.levels import ValueRange, measure_levels

if TYPE_CHECKING:
    from PIL.Image import Image as PillowImage

PictureSize = tuple[int, int]

WRITTEN = "deepfsi"
"""Word in the head of a PNG file that holds reflectance as a data set had it."""

IMAGE_SUFFIXES = (
    *(".png", ".jpg", ".jpeg", ".jpe", ".jfif", ".bmp", ".gif", ".tif", ".tiff", ".webp"),
    *(".pgm", ".ppm", ".pbm", ".pnm"),
    *(".jp2", ".heic", ".avif"),  # refused when they are read: a class would lack them in silence
)
"""Ends of the names of image files."""

SYSTEM_FOLDERS = ("__MACOSX", "@eaDir", "$RECYCLE.BIN", "System Volume Information", "lost+found")
"""Folders that operating systems and servers add; hidden ones are passed over, too."""


def load_pictures(options: Origin) -> Dataset:
    """Data set of the images of a folder or of a ``.csv`` file, which gives the name, too."""
    path = Path(options.data)
    test: list[list[Path]] = []
    values = None
    drawn = ""
    if path.is_file():
        name = path.stem
        train, labels, values = _read_list(path)
    else:
        name = path.resolve().name  # also of the folder `.`
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
        labels = np.array([class_name(path) for split in (train, *test) for path in split])
    paths = [*train, *(test[0] if test else [])]
    pixels, levels, words, _ = read_pictures(paths, options.size, options.white)
    n = len(train)
    return split_arrays(
        (pixels[:n], labels[:n]),
        (pixels[n:], labels[n:]) if test else (None, None),
        values=values,
        name=name,
        seed=options.seed,
        rescale=options.rescale,
        described=f"{drawn}{words}",
        levels=levels,
        files=[readable_name(f"{path.parent.name}/{path.name}") for path in paths],
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
    # Lists of Windows separate folders by backslashes
    images = [folder / name.replace("\\", "/") for name in cells[:, 0]]
    if cells.width == 2 and not (numbers and cells[:, 1].str.contains(r"\.").any()):
        return images, cells[:, 1].to_numpy(), None
    named = heads and heads[1] not in ("label", "class")
    return images, cells[:, 1:].cast(pl.Float64).to_numpy(), heads[1:] if named else None


def is_image(name: str) -> bool:
    """True for names of image files."""
    return name.lower().endswith(IMAGE_SUFFIXES) and not name.startswith(".")


def _names_text(names: Sequence[str | Path]) -> str:
    """Names for a message, twenty of them at most."""
    rest = f" and {len(names) - 20} more" if len(names) > 20 else ""
    return ", ".join(readable_name(str(name)) for name in names[:20]) + rest


def class_name(path: Path) -> str:
    """Class of an image, the name of its folder."""
    return normal_name(readable_name(path.parent.name))


def list_pictures(path: Path) -> list[list[Path]]:
    """Images of a folder: one list, or a training and a test list."""
    splits = {entry.name.lower(): entry for entry in path.iterdir() if entry.is_dir()}
    roots = [splits["train"], splits["test"]] if {"train", "test"} <= splits.keys() else [path]
    images: dict[Path, list[Path]] = {}  # by their folder
    for folder, inside, names in os.walk(path, followlinks=True):
        inside[:] = [name for name in inside if name[0] != "." and name not in SYSTEM_FOLDERS]
        # A folder that is called like an image is refused when it is read
        named = (Path(folder, name) for name in [*names, *inside])
        images[Path(folder)] = [path for path in named if is_image(path.name)]
    classes = [folder for folder in images if folder.parent in roots and folder not in roots]
    # If they were passed over, a set with train/ and val/ alone would have these as its classes
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
    paths.sort(key=lambda image: (class_name(image), readable_name(image.name)))
    return [[image for image in paths if image.parent.parent == root] for root in roots]


class Pictures(NamedTuple):
    """Grey pictures of one size and depth."""

    values: npt.NDArray[Any]  # (n, H, W), bytes or floats
    levels: ValueRange
    words: str  # what they were and what was done, as the beginning of a sentence
    written: int  # number of pictures that `write_pictures` wrote, as reflectance


def read_pictures(paths: list[Path], shape: PictureSize | None, white: float | None) -> Pictures:
    """Read pictures, turn them to grey, and average them to a shape if one is given."""
    from PIL import Image

    sizes: set[PictureSize] = set()
    ends: dict[str, npt.NDArray[Any]] = {}
    written = 0
    out: npt.NDArray[Any] = np.empty(0)
    for index, path in enumerate(paths):
        grey, marked = _read(path)
        height, width = grey.shape
        sizes.add((height, width))
        ends[str(path)] = np.array([grey.min(), grey.max()])
        written += marked
        if grey.dtype != np.uint8:
            grey = grey.astype(np.float32)
        if shape is not None:
            grey = np.asarray(Image.fromarray(grey).resize(shape[::-1], Image.Resampling.BOX))
        if not out.size:
            size = f"{grey.shape[0]}x{grey.shape[1]} pixels"
            check_memory(
                len(paths) * grey.size * (grey.itemsize + 8),  # reflectance in float32, twice
                f"{len(paths)} images of {size}",
                "give a smaller size, or fewer",
            )
            out = np.empty((len(paths), *grey.shape), grey.dtype)
        if grey.shape != out.shape[1:]:
            raise InputError(
                f"images differ in size: others are {size}, {path} is {height}x{width}; give a "
                "size to bring them to one"
            )
        out[index] = grey
    levels = measure_levels(ends, white)
    kinds = {"uint8": "8-bit", "float32": "float", "int32": "32-bit"}
    levels = levels._replace(kind=kinds.get(levels.kind, "16-bit"))
    how = "averaged to" if shape and sizes != {shape} else "of"
    words = f"{plural(len(paths), 'image')} {how} {size}; {levels.words}"
    return Pictures(out, levels, words, written)


def _read(path: Path) -> tuple[npt.NDArray[Any], bool]:
    """Grey levels of an image (H, W), and whether `write_pictures` wrote it."""
    from PIL import Image, ImageOps, UnidentifiedImageError

    # Pillow's decoders of other formats may start programs, as that of EPS does
    formats = ("PNG", "JPEG", "BMP", "GIF", "PPM", "TIFF", "WEBP")
    content = read_regular(path, 2**28, "replace or remove it")
    try:
        with warnings.catch_warnings():
            # Pillow warns of damaged tags, and itself only warns of huge images
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(content), formats=formats) as image:
                pixels = image.width * image.height
                check_unpacked(pixels, len(content), str(path), "replace or remove it")
                ImageOps.exif_transpose(image, in_place=True)
                return _values(image, str(path)), WRITTEN in image.info
    except InputError:
        raise
    except UnidentifiedImageError:
        # Pillow reads floats of 32 bits alone
        tiff = path.suffix.lower() in (".tif", ".tiff")
        fault = "floats of 16 or 64 bits, or no TIFF" if tiff else "no image of a kind that is read"
    except Exception as error:  # Pillow's decoders raise almost anything on a damaged file
        fault = str(error)
    raise InputError(f"cannot read {path} ({fault}): replace or remove it")


def _values(image: "PillowImage", where: str) -> npt.NDArray[Any]:
    """Grey levels of an image: uint8, 16 or 32 bits, or float32."""
    if image.mode not in ("I", "F") and not image.mode.startswith("I;16"):
        return np.asarray(image.convert("L"))
    tags = getattr(image, "tag_v2", {})
    if tags.get(262) == 0:  # TIFF's PhotometricInterpretation: Pillow turns it over in 8 bits alone
        raise InputError(f"{where} has 0 for white: save it with 0 for black")
    values = np.asarray(image)
    return values.astype(values.dtype.newbyteorder("="))

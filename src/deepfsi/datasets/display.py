"""Scenes as pictures for a display: a data set's test scenes written, pictures read back.

A picture is what the display shows: grey levels 0 to 255 are reflectance 0 to 1.
"""

import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from deepfsi.base import InputError, new_folder, readable_name
from deepfsi.datasets.arrays import check_unmasked
from deepfsi.datasets.dataset import Dataset, Reflectance
from deepfsi.datasets.decoding import WRITTEN, Shape
from deepfsi.datasets.picture_lists import is_image, list_labels
from deepfsi.datasets.pictures import (
    list_folder,
    picture_file,
    read_all,
    sized_text,
)
from deepfsi.datasets.values import Levels, measure, reflectance


class Display(NamedTuple):
    """Pictures to be shown one after another."""

    names: tuple[str, ...]  # names of their files
    labels: tuple[str, ...] | None  # class of each, if there is a folder for each class
    x: Reflectance  # (S, H, W): Reflectance in [0, 1]
    levels: Levels  # range of the values, and their white
    preprocessing: str  # what was done to the pictures, in words
    written: int  # how many `write_pictures` wrote


def array_display(pictures: npt.ArrayLike, white: float | None = None) -> Display:
    """Pictures (n, H, W), or spectra (n, B), of an array; floats are scenes as a design has them.

    Parameters
    ----------
    pictures : array
        Whole numbers, from 0 to a white; or floats, reflectance in [0, 1].
    white : float, optional
        As for `read_display`.
    """
    check_unmasked(pictures, "pictures")
    values = np.asarray(pictures)
    if not values.size:
        raise InputError(f"an array of shape {values.shape} holds no pictures: give one or more")
    levels = measure({"pictures": values}, white)
    return Display(
        names=tuple(map(str, range(len(values)))),
        labels=None,
        x=reflectance(values, levels),
        levels=levels,
        preprocessing=levels.words,
        written=0,
    )


def read_display(
    path: str | os.PathLike[str],
    white: float | None = None,
    shape: Shape | None = None,
    bilinear: bool = False,
    skip_bad: bool | None = None,
) -> Display:
    """Read a picture, a folder or ``.csv`` file of some, or a folder with one for each class."""
    # Pictures have one size and one depth, or raise `InputError`; colours are turned to grey. Those
    # of more than 8 bits have reflectance 1 at `white`, found as for `load_dataset` unless given
    source = Path(path)
    if source.is_file() and source.suffix.lower() == ".csv":
        pictures = [picture_file(each, label) for each, label in list_labels(source)[0]]
    elif source.is_file():
        pictures = [picture_file(source)]
    elif not source.is_dir():
        raise InputError(f"no picture at {source}: give an image file, or a folder of some")
    elif found := sorted(file for file in source.iterdir() if is_image(file.name)):
        pictures = [picture_file(file) for file in found]
        _check_flat(source)
    else:
        pictures = [picture for part in list_folder(source) for picture in part]
    folder = source.parent if source.is_file() else source
    pixels, tally, kept = read_all(pictures, shape, bilinear, skip_bad)
    files = [Path(pictures[place].where).relative_to(folder).as_posix() for place in kept]
    names = tuple(map(readable_name, files))
    labels = [pictures[place].label for place in kept]
    classes = tuple(label for label in labels if label and isinstance(label, str)) or None
    levels, sized = tally.levels(white), sized_text(shape, bilinear, tally.sizes)
    said = f"{tally.words}{sized}; {levels.words}"
    x = reflectance(pixels, levels)
    return Display(names, classes, x, levels, said, tally.written)


def _check_flat(folder: Path) -> None:
    """Raise `InputError` for folders of images beside images, as one is meant."""
    inner = [each for each in sorted(folder.iterdir()) if each.is_dir() and each.name[0] != "."]
    for each in inner:
        if any(is_image(file.name) for file in each.iterdir()):
            raise InputError(
                f"{folder} holds images and folders of images, such as {each.name}: give one of "
                "them, or move the images that lie beside the folders"
            )


def write_display(
    data: Dataset, folder: str | os.PathLike[str], per_class: int, seed: int = 0
) -> list[Path]:
    """Write test scenes as pictures, a sub-folder for each class."""
    if len(data.image_shape) != 2:
        raise InputError(f"{data.name}: scenes of shape {data.image_shape} are no images")
    rng = np.random.default_rng(seed)
    pictures = {}
    for number, label in enumerate(data.classes):
        if label.startswith(".") or Path(label).name != label:
            raise InputError(
                f"class {label!r} of {data.name} cannot be a folder: give it a name without a "
                "slash and a leading dot"
            )
        places = np.flatnonzero(data.y_test == number)
        if not 1 <= per_class <= len(places):
            raise InputError(
                f"{per_class} test scenes of class {label} are not there: give 1 to {len(places)}"
            )
        for place in sorted(rng.choice(places, per_class, replace=False)):
            pictures[f"{label}/{place:06d}.png"] = data.x_test[place].reshape(data.image_shape)
    return write_pictures(pictures, folder)


def write_pictures(
    pictures: Mapping[str, np.ndarray], folder: str | os.PathLike[str]
) -> list[Path]:
    """Write reflectances (H, W) in [0, 1] as grey pictures, by their names in a new folder."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    said = PngInfo()
    said.add_text(WRITTEN, "reflectance")
    with new_folder(folder) as draft:
        for name, picture in pictures.items():
            path = draft / name
            path.parent.mkdir(parents=True, exist_ok=True)
            drawn = io.BytesIO()  # a full disk is then an error of the file, not of its format
            grey = Image.fromarray(np.rint(picture * 255).astype(np.uint8))
            grey.save(drawn, format="PNG", pnginfo=said)
            path.write_bytes(drawn.getvalue())
    return [Path(folder) / name for name in pictures]

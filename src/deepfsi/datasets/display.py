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

from deepfsi.base.errors import InputError
from deepfsi.base.files import new_folder, readable_name
from deepfsi.base.tables import normal_name, read_cells
from deepfsi.datasets.dataset import Dataset, Reflectance
from deepfsi.datasets.levels import ValueRange, measure_levels, reflectance
from deepfsi.datasets.pictures import (
    WRITTEN,
    PictureSize,
    class_name,
    is_image,
    list_pictures,
    read_pictures,
)


class Display(NamedTuple):
    """Pictures that are shown one after another."""

    names: tuple[str, ...]  # names of their files
    labels: tuple[str, ...] | None  # class of each, if there is a folder for each class
    x: Reflectance  # (S, H, W), reflectance in [0, 1]
    levels: ValueRange  # range of the values, and their white
    preprocessing: str  # sentence on the changes made to the pictures
    written: int  # number of pictures that `write_pictures` wrote


def array_display(pictures: npt.ArrayLike, white: float | None = None) -> Display:
    """Pictures (n, H, W), or spectra (n, B), of an array; floats are scenes in [0, 1]."""
    values = np.asarray(pictures)
    levels = measure_levels({"pictures": values}, white)
    names = tuple(map(str, range(len(values))))
    x = reflectance(values, levels)
    return Display(names, None, x, levels, levels.words, written=0)


def read_display(
    path: str | os.PathLike[str], white: float | None = None, shape: PictureSize | None = None
) -> Display:
    """Read a picture, a folder of pictures, or one of classes, and average them to a shape."""
    source = Path(path)
    labels: tuple[str, ...] | None = None
    if source.is_file():
        pictures = [source]
    elif not source.is_dir():
        raise InputError(f"no picture at {source}: give an image file, or a folder of some")
    elif any(is_image(file.name) for file in source.iterdir()):
        pictures = [file for file in sorted(source.iterdir()) if is_image(file.name)]
    else:
        pictures = [picture for split in list_pictures(source) for picture in split]
        labels = tuple(map(class_name, pictures))
    folder = source.parent if source.is_file() else source
    read = read_pictures(pictures, shape, white)
    names = [readable_name(picture.relative_to(folder).as_posix()) for picture in pictures]
    x = reflectance(read.values, read.levels)
    return Display(tuple(names), labels, x, read.levels, read.words, read.written)


def read_scene_list(path: Path) -> list[tuple[str, str | None]]:
    """Names of scenes in a text or CSV file, in its order, with their classes where it has them.

    A line is NAME or NAME,LABEL, quoted as in CSV where a name has a comma. Empty lines, and a
    first line that names the columns (``name,label``), are left out.
    """
    advice = "give a text file with a scene on each line, or a folder of pictures"
    cells = read_cells(path, advice)
    if cells.height:
        heads = [(head or "").lower() for head in cells.row(0)]
        if heads[0] in ("name", "scene") or heads[1:] in (["label"], ["class"]):
            cells = cells[1:]
    if not cells.height or cells.width > 2 or cells[:, 0].null_count():
        raise InputError(
            f"{path} has no scenes, or a line that is not NAME or NAME,LABEL: {advice}"
        )
    return [
        (name, normal_name(label[0]) if any(label) else None) for name, *label in cells.iter_rows()
    ]


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
        rows = np.flatnonzero(data.y_test == number)
        if not 1 <= per_class <= len(rows):
            raise InputError(
                f"{per_class} test scenes of class {label} are not there: give 1 to {len(rows)}"
            )
        for row in sorted(rng.choice(rows, per_class, replace=False)):
            pictures[f"{label}/{row:06d}.png"] = data.x_test[row].reshape(data.image_shape)
    return write_pictures(pictures, folder)


def write_pictures(
    pictures: Mapping[str, np.ndarray], folder: str | os.PathLike[str]
) -> list[Path]:
    """Write reflectances (H, W), by the names of their files, as grey pictures in a new folder."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    text = PngInfo()
    text.add_text(WRITTEN, "reflectance")
    with new_folder(folder) as draft:
        for name, picture in pictures.items():
            path = draft / name
            path.parent.mkdir(parents=True, exist_ok=True)
            # Written in memory first: a full disk is then an error of the file, not of its format
            content = io.BytesIO()
            grey = Image.fromarray(np.rint(picture * 255).astype(np.uint8))
            grey.save(content, format="PNG", pnginfo=text)
            path.write_bytes(content.getvalue())
    return [Path(folder) / name for name in pictures]

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
from deepfsi.base.numeric.tables import LABEL_HEADS, normal_name
from deepfsi.datasets.arrays import check_unmasked
from deepfsi.datasets.dataset import Dataset, Reflectance
from deepfsi.datasets.decoding import WRITTEN, PictureSize
from deepfsi.datasets.levels import ValueRange, measure_levels, reflectance
from deepfsi.datasets.pictures import (
    Picture,
    decode_pictures,
    is_image,
    open_listing,
    picture_file,
    read_list,
    sized_text,
)

NAME_HEADS = ("name", "scene")
"""First words of a line that names the columns of a list of scenes, in lower case."""


class Display(NamedTuple):
    """Pictures to be shown one after another."""

    names: tuple[str, ...]  # names of their files
    labels: tuple[str, ...] | None  # class of each, if there is a folder for each class
    x: Reflectance  # (S, H, W), reflectance in [0, 1]
    levels: ValueRange  # range of the values, and their white
    preprocessing: str  # changes made to the pictures, in words
    written: int  # those that `write_pictures` wrote


def array_display(pictures: npt.ArrayLike, white: float | None = None) -> Display:
    """Pictures (n, H, W), or spectra (n, B), of an array; floats are scenes in [0, 1]."""
    check_unmasked(pictures, "pictures")
    values = np.asarray(pictures)
    if not values.size:
        raise InputError(f"an array of shape {values.shape} holds no pictures: give one or more")
    levels = measure_levels({"pictures": values}, white)
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
    shape: PictureSize | None = None,
    bilinear: bool = False,
    skip_bad: bool | None = None,
) -> Display:
    """Read a picture, a folder or ``.csv`` file of some, or a folder with one for each class.

    Parameters
    ----------
    path : path
        Pictures of one size and one depth; colours are turned to grey.
    white : float, optional
        Value that is reflectance 1, of more than 8 bits; measured as for `load_dataset` unless
        given.
    shape : (int, int), optional
        Height and width to which they are brought.
    bilinear : bool
        Bring them to it bilinearly, and not by averaging over areas.
    skip_bad : bool, optional
        Leave damaged ones out. Unless given, the message offers no way to leave them out.
    """
    source = Path(path)
    if source.is_file() and source.suffix.lower() != ".csv":
        pictures = [picture_file(source)]
    elif not (source.is_file() or source.is_dir()):
        raise InputError(f"no picture at {source}: give an image file, or a folder of some")
    elif source.is_dir() and any(is_image(file.name) for file in source.iterdir()):
        pictures = _flat_folder(source)
    else:
        with open_listing(source) as listing:
            pictures = [picture for part in listing.parts for picture in part]
    folder = source.parent if source.is_file() else source
    pixels, tally = decode_pictures(pictures, shape, bilinear, skip_bad)
    kept = [pictures[index] for index in tally.kept]
    names = [Path(picture.where).relative_to(folder).as_posix() for picture in kept]
    levels = tally.levels(white)
    return Display(
        names=tuple(map(readable_name, names)),
        labels=tuple(p.label for p in kept if p.label and isinstance(p.label, str)) or None,
        x=reflectance(pixels, levels),
        levels=levels,
        preprocessing=f"{tally.words}{sized_text(shape, bilinear, tally.sizes)}; {levels.words}",
        written=tally.written,
    )


def _flat_folder(folder: Path) -> list[Picture]:
    """Pictures of a folder that holds no folders of images beside them, as one is meant."""
    inside = sorted(folder.iterdir())
    for path in inside:
        if path.is_dir() and path.name[0] != "." and any(is_image(f.name) for f in path.iterdir()):
            raise InputError(
                f"{folder} holds images and folders of images, such as {path.name}: give one of "
                "them, or move the images that lie beside the folders"
            )
    return [picture_file(file) for file in inside if is_image(file.name)]


class ListedScene(NamedTuple):
    """Scene that a list names, with its class where that is known."""

    line: int
    name: str
    label: str | None


def read_scene_list(path: Path) -> list[ListedScene]:
    """Scenes of a text or CSV file, in its order.

    A line is NAME or NAME,LABEL, quoted as in CSV where a name has a comma. Empty lines, and a
    first line that names the columns (``name,label``), are left out.
    """

    def is_heading(cells: tuple[str, ...]) -> bool:
        labels = len(cells) == 2 and cells[1].lower() in LABEL_HEADS
        return cells[0].lower() in NAME_HEADS or labels

    advice = "give a text file with a scene on each line, or a folder of pictures"
    scenes = []
    for line, name, cells in read_list(path, is_heading, advice).rows:
        if len(cells) > 1 or not name:
            raise InputError(
                f"{path} has {','.join([name, *cells])!r} on line {line}: give NAME or NAME,LABEL"
            )
        scenes.append(ListedScene(line, name, normal_name(cells[0]) or None if cells else None))
    if not scenes:
        raise InputError(f"{path} has no scenes: {advice}")
    return scenes


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
    """Write reflectances as grey pictures.

    Parameters
    ----------
    pictures : mapping of arrays, shape (H, W)
        Reflectance in [0, 1], by the names of the files in the folder.
    folder : path
        A new one.

    Returns
    -------
    list of Path
        Their files.
    """
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    text = PngInfo()
    text.add_text(WRITTEN, "reflectance")
    with new_folder(folder) as draft:
        for name, picture in pictures.items():
            path = draft / name
            path.parent.mkdir(parents=True, exist_ok=True)
            drawn = io.BytesIO()  # a full disk is then an error of the file, not of its format
            grey = Image.fromarray(np.rint(picture * 255).astype(np.uint8))
            grey.save(drawn, format="PNG", pnginfo=text)
            path.write_bytes(drawn.getvalue())
    return [Path(folder) / name for name in pictures]

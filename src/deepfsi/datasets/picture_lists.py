"""Lists of images in ``.csv`` files: the name and the label, or the values, of one in each line."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import TypeAlias

import numpy as np

from deepfsi.base import InputError
from deepfsi.base.numeric import (
    LABEL_HEADS,
    WITHOUT_VALUE,
    TextRows,
    has_decimal_commas,
    is_whole_number,
    normal_name,
    parse_number,
    read_rows,
)
from deepfsi.datasets.arrays import check_no_classes

Label: TypeAlias = str | tuple[float, ...]
"""Class of an image, or its values."""

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".gif", ".pgm", ".tif", ".tiff", ".webp")
"""Ends of the names of image files."""

LARGEST_LIST = 2**28
"""Bytes of a list at most."""

MOST_NAMES = 20
"""Images that one line names at most."""

LIST_ADVICE = "give a line of text for each image, its file name and its label, or its values"
"""What to do about a list of images that cannot be used."""


def list_labels(path: Path) -> tuple[list[tuple[Path, Label]], tuple[str, ...]]:
    """Images that a ``.csv`` file names, with their labels or values, and the values' names."""
    # Names are from the folder beside it that has its name, `pets/` of `pets.csv`, or else from its
    # own folder. A first line that names no file is a heading. Numbers are values where a line has
    # several, or any has a decimal point or an exponent; whole numbers are classes, as in arrays
    rows = read_rows(path, LARGEST_LIST, LIST_ADVICE)
    folder = path.with_suffix("") if path.with_suffix("").is_dir() else path.parent
    numbered = list(zip(rows.lines, rows.cells, strict=True))
    heading: tuple[str, ...] = ()
    if numbered and not re.search(r"[./\\]", numbered[0][1][0]):
        heading = numbered.pop(0)[1][1:]
    names, answers = list[str](), list[tuple[str, ...]]()
    for number, (name, *cells) in numbered:
        as_many = len(cells) == len(answers[0]) if answers else len(cells) > 0
        if not (is_image(re.split(r"[/\\]", name)[-1]) and as_many and all(cells)):
            later = ": put the column of file names first" if any(map(is_image, cells)) else ""
            raise InputError(
                f"{path}, line {number}: {', '.join([name, *cells])!r} is not an image "
                f"and its label{later}: {LIST_ADVICE}"
            )
        names.append(name)
        answers.append(tuple(cells))
    if not names:
        raise InputError(f"{path} names no image: {LIST_ADVICE}")
    values = _values_of(answers, rows, path)
    named = bool(heading) and heading[0].lower() not in LABEL_HEADS
    if values and (len(values[0]) > 1 or not named):
        check_no_classes(
            np.array(values),
            str(path),
            "write one column of words or of numbers without a point, 1 and not 1.0",
            "write their name over the column",
        )
    labels: Sequence[Label] = values or [normal_name(label) for [label] in answers]
    find = _finder(folder)
    paths = [find(name) for name in names]
    missing = [str(each) for each in paths if not each.is_file()]
    if missing:
        raise InputError(
            f"{path} names {len(missing)} images that are not there, {listed(missing)}: names are "
            f"from the folder {folder} on"
        )
    if twice := [str(each) for each, count in Counter(paths).items() if count > 1]:
        raise InputError(f"{path} names {listed(twice)} twice: give each image one line")
    pictures = list(zip(paths, labels, strict=True))
    return pictures, heading if values and len(heading) == len(values[0]) else ()


def _finder(folder: Path) -> Callable[[str], Path]:
    r"""Function from a name to its file: as it is, or in another spelling, case, or with `\`."""

    @cache
    def spellings(place: Path) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for each in sorted(place.iterdir()) if place.is_dir() else ():
            found.setdefault(normal_name(each.name).casefold(), []).append(each.name)
        return found

    def find(name: str) -> Path:
        path = folder / name
        if path.is_file():
            return path
        here = folder
        for part in name.replace("\\", "/").split("/"):
            alike = spellings(here).get(normal_name(part).casefold(), [])
            here = here / (alike[0] if len(alike) == 1 and part not in alike else part)
        return here if here.is_file() else path

    return find


def _values_of(
    answers: list[tuple[str, ...]], rows: TextRows, path: Path
) -> list[tuple[float, ...]]:
    """Values of images, or none where their cells are labels."""
    columns = len(answers[0])
    if columns == 1 and all(is_whole_number(cell) for [cell] in answers):
        return []
    every = [cell for cells in answers for cell in cells]
    comma = has_decimal_commas(every, rows.separator)
    numbers = [parse_number(cell, comma) for cell in every]
    wrong = [cell for cell, number in zip(every, numbers, strict=True) if number is None]
    no_value = [cell for cell in wrong if cell.lower() in WITHOUT_VALUE]
    if columns == 1 and wrong and (len(no_value) < len(wrong) or len(wrong) == len(every)):
        return []
    if wrong:
        raise InputError(
            f"{path} has {columns} columns beside the file name, and a cell that is no finite "
            f"number ({(no_value or wrong)[0]!r}): {LIST_ADVICE}"
        )
    found = [number for number in numbers if number is not None]
    return [tuple(found[at : at + columns]) for at in range(0, len(found), columns)]


def is_image(name: str) -> bool:
    """True for names of image files."""
    return name.lower().endswith(IMAGE_SUFFIXES) and not name.startswith(".")


def listed(names: Sequence[str]) -> str:
    """Names for a message, the first of many."""
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return ", ".join(names[:MOST_NAMES]) + more

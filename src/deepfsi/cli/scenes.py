"""Scenes that a command is given: pictures that a display shows, or a list of names."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

from deepfsi.base import InputError, as_input_error
from deepfsi.base.numeric import LABEL_HEADS, normal_name, read_rows
from deepfsi.datasets import read_display
from deepfsi.hardware.counting import Scene
from deepfsi.lab import picture_hashes

if TYPE_CHECKING:
    from deepfsi.datasets.display import Display


def scenes_of(images: "Display", source: Path, patterns: Path) -> tuple[Scene, ...]:
    """Scenes by the names of their pictures, with the classes of the folders."""
    count = len(images.names)
    labels = images.labels or [None] * count
    hashes = picture_hashes(source, patterns) or [None] * count
    return tuple(
        Scene(name=name, label=label, hash=each)
        for name, label, each in zip(images.names, labels, hashes, strict=True)
    )


def listed(source: Path, patterns: Path) -> tuple[Scene, ...]:
    """Scenes of a list, of one picture or of a folder of pictures, to be shown patterns."""
    suffix = source.suffix.lower()
    if suffix in (".txt", ".csv") and not source.exists():
        raise InputError(f"there is nothing at {source}: give a list of scenes, or their pictures")
    if source.is_file() and suffix in ("", ".txt", ".csv"):
        return read_scenes(source)
    return scenes_of(read_display(source), source, patterns)


LARGEST_LIST = 2**24
"""Bytes of a list at most."""

HEADS = ("name", "scene")
"""First words of a line that names the columns, in lower case."""


def read_scenes(path: str | os.PathLike[str]) -> tuple[Scene, ...]:
    """Scenes of a text or CSV file, in its order."""
    # A line is NAME or NAME,LABEL, quoted as in CSV where a name has a comma. Empty lines, and a
    # first line that names the columns (`name,label`), are left out
    hint = "give a text file with a scene on each line, or a folder of pictures"
    rows = read_rows(Path(path), LARGEST_LIST, hint)
    numbered = list(zip(rows.lines, rows.cells, strict=True))
    if numbered and _is_heading(numbered[0][1]):
        del numbered[0]
    scenes = []
    for number, row in numbered:
        if len(row) > 2 or not row[0]:
            raise InputError(
                f"{path} has {','.join(row)!r} on line {number}: give NAME or NAME,LABEL"
            )
        with as_input_error(f"{path}, line {number},"):
            label = normal_name(row[1]) or None if len(row) > 1 else None
            scenes.append(Scene(name=row[0], label=label))
    if not scenes:
        raise InputError(f"{path} has no scenes: {hint}")
    return tuple(scenes)


def _is_heading(row: tuple[str, ...]) -> bool:
    """True for the names of columns."""
    labels = len(row) == 2 and row[1].lower() in LABEL_HEADS
    return row[0].lower() in HEADS or labels

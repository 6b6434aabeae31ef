"""Lists of scenes as text: a name on each line, and its class after a comma where that is known."""

import os
from pathlib import Path

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.text_files import LABEL_HEADS, read_rows, spelling
from deepfsi.hardware.counting.acquisition import Scene

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
            label = spelling(row[1]) or None if len(row) > 1 else None
            scenes.append(Scene(name=row[0], label=label))
    if not scenes:
        raise InputError(f"{path} has no scenes: {hint}")
    return tuple(scenes)


def _is_heading(row: tuple[str, ...]) -> bool:
    """True for the names of columns."""
    labels = len(row) == 2 and row[1].lower() in LABEL_HEADS
    return row[0].lower() in HEADS or labels

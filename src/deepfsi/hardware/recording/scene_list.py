"""Lists of scenes as text: a name on each line, and its class after a comma where that is known."""

import csv
import os
from pathlib import Path

from deepfsi.errors import InputError, as_input_error
from deepfsi.files import read_regular
from deepfsi.hardware.recording.acquisition import Scene

LARGEST_LIST = 2**24
"""Bytes of a list at most."""

HEADS = ("name", "scene")
"""First words of a line that names the columns."""


def read_scenes(path: str | os.PathLike[str]) -> tuple[Scene, ...]:
    """Scenes of a text or CSV file, in its order."""
    # A line is NAME or NAME,LABEL, quoted as in CSV where a name has a comma. Empty lines, and a
    # first line that names the columns (`name,label`), are left out
    hint = "give a text file with a scene on each line, or a folder of pictures"
    content = read_regular(Path(path), LARGEST_LIST, hint)
    try:
        lines = content.decode("utf-8-sig").splitlines()
        rows = [[cell.strip() for cell in row] for row in csv.reader(lines, strict=True)]
    except (UnicodeDecodeError, csv.Error):
        raise InputError(f"{path} is not text in UTF-8 with commas: {hint}") from None
    if rows and rows[0] and rows[0][0].lower() in HEADS:
        rows[0] = []
    scenes = []
    for number, row in enumerate(rows, 1):
        if not any(row):
            continue
        if len(row) > 2 or not row[0]:
            raise InputError(
                f"{path} has {','.join(row)!r} on line {number}: give NAME or NAME,LABEL"
            )
        with as_input_error(f"{path}, line {number},"):
            scenes.append(Scene(name=row[0], label=row[1] or None if len(row) > 1 else None))
    if not scenes:
        raise InputError(f"{path} has no scenes: {hint}")
    return tuple(scenes)

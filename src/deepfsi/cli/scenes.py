"""Scenes that a command is given: pictures that a display shows, or a list of names."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

from deepfsi.base import InputError, as_input_error
from deepfsi.datasets import read_display, read_scene_list
from deepfsi.hardware.counting import Scene
from deepfsi.lab import picture_hashes

if TYPE_CHECKING:
    from deepfsi.datasets import Display


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


def read_scenes(path: str | os.PathLike[str]) -> tuple[Scene, ...]:
    """Scenes of a text or CSV file, in its order."""
    scenes = []
    for line, name, label in read_scene_list(Path(path)):
        with as_input_error(f"{path}, line {line},"):
            scenes.append(Scene(name=name, label=label))
    return tuple(scenes)

"""Scenes that a camera is shown: pictures of a display, or a list of names."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.datasets.display import read_display, read_scene_list
from deepfsi.designfile.design_file import DesignFile, DesignHeader
from deepfsi.designfile.provenance import scene_hashes, trained_on
from deepfsi.hardware.counting.acquisition import Scene
from deepfsi.hardware.patterns.folder import Patterns, read_patterns
from deepfsi.lab.design_data import design_scenes

if TYPE_CHECKING:
    from deepfsi.datasets.display import Display


def _design_of(patterns: Path) -> DesignHeader | None:
    """Header of the design in a folder of patterns; None where it has none."""
    if read_patterns(patterns).manifest.design_sha256 is None:
        return None
    return DesignFile.read(patterns / Patterns.DESIGN, ()).header


def displayed(source: Path, patterns: Path) -> "Display":
    """Pictures of scenes, with the white of the patterns' design where their type has none."""
    images = read_display(source)
    if not images.levels.chosen or (design := _design_of(patterns)) is None:
        return images
    known = trained_on(design.info)
    white = known.origin.white if known and known.origin else None
    return images if white is None else read_display(source, white)


def picture_hashes(
    source: str | os.PathLike[str], patterns: str | os.PathLike[str]
) -> tuple[str, ...] | None:
    """Hashes of pictures as the patterns' design sees them; None where it cannot see them.

    Parameters
    ----------
    source : str or path
        The pictures.
    patterns : str or path
        Folder of the patterns.
    """
    design = _design_of(Path(patterns))
    if design is None:
        return None
    try:
        shown = design_scenes(design.info, design.image_shape, Path(source))
    except InputError:  # it was made of arrays, or of pictures of another size
        return None
    return scene_hashes(shown.x, design.image_shape)


def scenes_of(images: "Display", source: Path, patterns: Path) -> tuple[Scene, ...]:
    """Scenes of pictures, with their names, the classes of their folders and their hashes."""
    count = len(images.names)
    labels = images.labels or [None] * count
    hashes = picture_hashes(source, patterns) or [None] * count
    return tuple(
        Scene(name=name, label=label, hash=digest)
        for name, label, digest in zip(images.names, labels, hashes, strict=True)
    )


def listed_scenes(source: Path, patterns: Path) -> tuple[Scene, ...]:
    """Scenes that someone shows to a camera."""
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

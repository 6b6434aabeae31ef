"""Scenes of a run: pictures that a display shows, or a list of names; and as a design sees them."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deepfsi.base import InputError, as_input_error
from deepfsi.base.numeric import LABEL_HEADS, normal_name, read_rows
from deepfsi.datasets import prepared, read_display
from deepfsi.datasets.display import Display
from deepfsi.designfile import DesignFile, DesignHeader, scene_hashes, trained_on
from deepfsi.hardware.calibration import camera_view
from deepfsi.hardware.counting import Calibration, Scene
from deepfsi.hardware.patterns import Patterns, read_patterns


def _design_of(patterns: Path) -> DesignHeader | None:
    """Header of the design in a folder of patterns; None where it has none."""
    if read_patterns(patterns).manifest.design_sha256 is None:
        return None
    return DesignFile.read(patterns / Patterns.DESIGN, ()).header


def displayed(source: Path, patterns: Path) -> Display:
    """Pictures of scenes, with the white of the patterns' design where their type has none."""
    images = read_display(source)
    if not images.levels.chosen or (design := _design_of(patterns)) is None:
        return images
    known = trained_on(design.info)
    white = known.origin.white if known and known.origin else None
    return images if white is None else read_display(source, white)


def design_scenes(
    info: Mapping[str, Any], image_shape: tuple[int, ...], pictures: Path, skip_bad: bool = False
) -> Display:
    """Pictures as a design with that provenance sees them, prepared as the data that it knows."""
    known = trained_on(info)
    if known is None or known.origin is None:
        raise InputError(
            "this design was trained on data that no file or name holds, such as arrays in memory, "
            "and does not know what to do to pictures: learn it from pictures, or `evaluate` it on "
            "arrays with labels"
        )
    shown = prepared(pictures, known.origin, skip_bad)
    if shown.x.shape[1:] != image_shape:
        raise InputError(
            "the pictures are of {pixels} pixels and the design's scenes of {scene}: bring them to "
            "its size, or learn a design with {size}",
            setting="size",
            pixels="x".join(map(str, shown.x.shape[1:])),
            scene="x".join(map(str, image_shape)),
        )
    if known.origin.view is None:
        return shown
    calibration = Calibration.load(Path(known.origin.view))
    x = camera_view(shown.x.reshape(len(shown.x), -1), image_shape, calibration)
    return shown._replace(x=x, preprocessing=f"{shown.preprocessing}, then as the camera sees it")


def picture_hashes(
    source: str | os.PathLike[str], patterns: str | os.PathLike[str]
) -> tuple[str, ...] | None:
    """Hashes of pictures as the patterns' design sees them; None where it cannot see them."""
    design = _design_of(Path(patterns))
    if design is None:
        return None
    try:
        shown = design_scenes(design.info, design.image_shape, Path(source))
    except InputError:  # it was made of arrays, or of pictures of another size
        return None
    return scene_hashes(shown.x, design.image_shape)


def scenes_of(images: Display, source: Path, patterns: Path) -> tuple[Scene, ...]:
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

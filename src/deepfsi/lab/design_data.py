"""Data as a design knows them: those that it is tested on, and pictures as it sees them.

A camera's calibration may view them. Where they are not what the design was trained on, that is
noted. Scenes that a camera is shown are pictures of a display, or a list of names.
"""

import os
from collections.abc import Mapping
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.datasets.dataset import Dataset, Origin
from deepfsi.datasets.display import array_display, read_display, read_scene_list
from deepfsi.datasets.load import absolute_source, load_dataset, options_of, prepare_display
from deepfsi.designfile.design_file import DesignFile, DesignHeader
from deepfsi.designfile.provenance import TrainedOn, new_scenes, scene_hashes, trained_on
from deepfsi.hardware.calibration.view import camera_view, view_dataset
from deepfsi.hardware.counting.acquisition import Calibration, Scene
from deepfsi.hardware.patterns.folder import Patterns, check_patterns, read_patterns

if TYPE_CHECKING:
    from deepfsi.datasets.display import Display
    from deepfsi.design.design import Design


class _DesignData(NamedTuple):
    """Data that a design is tested on, and notes on where it is not what it was trained on."""

    data: Dataset
    notes: tuple[str, ...]


def open_design(path: Path, *, trust: bool = False, static: bool = False) -> "Design":
    """Open a design file, or what a folder of patterns realises of the design in it."""
    from deepfsi.design.design import load_design

    folder = path.is_dir()
    file = path / Patterns.DESIGN if folder else path
    design = load_design(file, trust=trust)
    if folder or static:
        design.exposure.check("masks", str(file))
    return design.as_shown(*check_patterns(path).realised) if folder else design


def data_of(
    design: "Design",
    data: str | None = None,
    size: tuple[int, int] | None = None,
    view: Path | None = None,
) -> _DesignData:
    """Load the data to test a design on: what is given, else what it was trained on."""
    training = trained_on(design.info)
    known = training.origin if training else None
    if data is None and known is None:
        raise InputError(
            "this design was trained on data that no file or name holds, such as arrays in "
            "memory: give the data to test it on, `data`"
        )
    asked = _asked(known, data, size, view)
    try:
        loaded = _load(asked)
    except InputError as error:
        if data is None:
            raise InputError(
                f"the data that this design was trained on cannot be loaded ({error}): give the "
                "data to test it on, `data`"
            ) from error
        raise
    notes = _notes(training, asked, loaded)
    _, left = new_scenes(design.training_scenes, loaded)
    if design.training_scenes is None and notes:
        left = "test scenes may be among those it was trained on, which its file does not hold"
    return _DesignData(loaded, tuple(notes if left is None else [*notes, left]))


def data_of_file(file: Path, size: tuple[int, int] | None = None) -> Dataset:
    """Data that a design file was trained on, without torch."""
    training = trained_on(DesignFile.read(file, ()).header.info)
    if training is None or training.origin is None:
        raise InputError(
            f"{file} was trained on data that no file or name holds, such as arrays in memory: "
            "give a folder of pictures"
        )
    return _load(_asked(training.origin, None, size, None))


def _asked(
    known: Origin | None, data: str | None, size: tuple[int, int] | None, view: Path | None
) -> Origin:
    """Source that is told, the rest of it as the design remembers."""
    name = known.data if data is None and known else absolute_source(str(data))
    told = {"size": size, "view": absolute_source(str(view)) if view else None}
    told = {option: value for option, value in told.items() if value is not None}
    if known is None or name == known.data:
        return (known or Origin(data=name)).model_copy(update=told)
    allowed = options_of(name)
    same = [
        "rescale",
        "view",
        *(option for option in ("size", "white", "skip_bad") if option in allowed),
    ]
    kept = {option: getattr(known, option) for option in same}
    return Origin(data=name).model_copy(update=kept | told)


def _load(origin: Origin) -> Dataset:
    options = origin.model_dump(exclude={"data", "normal", "view", "fold"})
    scenes = load_dataset(origin.data, **options)
    if origin.fold is not None:
        place, count = origin.fold
        scenes = scenes.folds(count)[place]
    return scenes if origin.view is None else view_dataset(scenes, Path(origin.view))


def _notes(training: TrainedOn | None, asked: Origin, data: Dataset) -> list[str]:
    known = training.origin if training else None
    if training is None or training.is_of(data):
        return []
    if known is None:
        return [f"this is not the data that the design was trained on, {training.name}"]
    if known == asked:
        return [f"{known.words} has changed since the design was trained on it"]
    return [f"the design was trained on {known.words}; this is {asked.words}"]


def design_scenes(
    info: Mapping[str, Any],
    image_shape: tuple[int, ...],
    pictures: Path | np.ndarray,
    skip_bad: bool = False,
) -> "Display":
    """Pictures as a design with that provenance sees them, prepared as the data that it knows."""
    known = trained_on(info)
    origin = known.origin if known else None
    if not isinstance(pictures, Path):
        if pictures.ndim == 2 and pictures.shape[1] == prod(image_shape):
            pictures = pictures.reshape(-1, *image_shape)
        if pictures.dtype.kind == "f":  # reflectance, as a data set has it
            origin = None
    if origin is not None:
        shown = prepare_display(pictures, origin, skip_bad)
    elif not isinstance(pictures, Path):
        shown = array_display(pictures)
    else:
        raise InputError(
            "this design was trained on data that no file or name holds, such as arrays in memory, "
            "and does not know what to do to pictures: learn it from pictures, or `evaluate` it on "
            "arrays with labels"
        )
    if shown.x.shape[1:] != image_shape:
        pixels, scene = ("x".join(map(str, shape)) for shape in (shown.x.shape[1:], image_shape))
        raise InputError(
            f"the pictures are of {pixels} pixels and the design's scenes of {scene}: bring them "
            "to its size, or learn a design with `size`"
        )
    if origin is None or origin.view is None:
        return shown
    calibration = Calibration.load(Path(origin.view))
    x = camera_view(shown.x.reshape(len(shown.x), -1), image_shape, calibration)
    return shown._replace(x=x, preprocessing=f"{shown.preprocessing}, then as the camera sees it")


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

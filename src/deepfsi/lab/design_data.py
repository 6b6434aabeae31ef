"""Data as a design knows them: those that it is tested on, and pictures as it sees them.

Where they are not what the design was trained on, that is noted. Scenes that a camera is shown are
pictures of a display, or a list of names. Through a calibrated camera the cells of a mask see

    x' = flat · average over each cell of (blurred image of x),

relative light in [0, 1], dark where a cell looks beside the display. A design that is trained on
such views of scenes fits the camera.
"""

import hashlib
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from math import prod
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from deepfsi.base.arrays import LARGEST_TENSORS
from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.files import read_regular
from deepfsi.base.registry import require_extras
from deepfsi.camera.camera import Camera
from deepfsi.counting.acquisition import Calibration, Scene
from deepfsi.datasets.dataset import Dataset, Origin
from deepfsi.datasets.display import array_display, read_display, read_scene_list
from deepfsi.datasets.load import absolute_source, load_dataset, options_of, prepare_display
from deepfsi.designfile.design_file import AdaptiveHeader, DesignFile, DesignHeader
from deepfsi.designfile.provenance import TrainedOn, new_scenes, scene_hashes, trained_on
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.rails import DesignRails

if TYPE_CHECKING:
    from scipy import sparse

    from deepfsi.datasets.display import Display
    from deepfsi.design.design import Design

POINTS_PER_CELL = 24, 32
"""Points of a cell's average, down and across: a DLP7000's mirrors of 32 x 32 cells."""

VIEWED_AT_ONCE = 4096
"""Scenes that are viewed at once."""


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
    return design.as_shown(*Patterns.read(path).check().realised) if folder else design


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


def _design_of(patterns: Patterns) -> DesignHeader | None:
    """Header of the design in a folder of patterns; None where it has none."""
    if patterns.manifest.design_sha256 is None or patterns.folder is None:
        return None
    return DesignFile.read(patterns.folder / Patterns.DESIGN, ()).header


def displayed(source: Path, patterns: Patterns) -> "Display":
    """Pictures of scenes, with the white of the patterns' design where their type has none."""
    images = read_display(source)
    if not images.levels.chosen or (design := _design_of(patterns)) is None:
        return images
    known = trained_on(design.info)
    white = known.origin.white if known and known.origin else None
    return images if white is None else read_display(source, white)


def _picture_hashes(source: Path, patterns: Patterns) -> tuple[str, ...] | None:
    """Hashes of pictures as the patterns' design sees them; None where it cannot see them."""
    design = _design_of(patterns)
    if design is None:
        return None
    try:
        shown = design_scenes(design.info, design.image_shape, source)
    except InputError:  # it was made of arrays, or of pictures of another size
        return None
    return scene_hashes(shown.x, design.image_shape)


def scenes_of(images: "Display", source: Path, patterns: Patterns) -> tuple[Scene, ...]:
    """Scenes of pictures, with their names, the classes of their folders and their hashes."""
    count = len(images.names)
    labels = images.labels or [None] * count
    hashes = _picture_hashes(source, patterns) or [None] * count
    return tuple(
        Scene(name=name, label=label, hash=digest)
        for name, label, digest in zip(images.names, labels, hashes, strict=True)
    )


def listed_scenes(source: Path, patterns: Patterns) -> tuple[Scene, ...]:
    """Scenes that someone shows to a camera."""
    suffix = source.suffix.lower()
    if suffix in (".txt", ".csv") and not source.exists():
        raise InputError(f"there is nothing at {source}: give a list of scenes, or their pictures")
    if source.is_file() and suffix in ("", ".txt", ".csv"):
        return read_scenes(source)
    return scenes_of(read_display(source), source, patterns)


def read_scenes(path: str | os.PathLike[str]) -> tuple[Scene, ...]:
    """Scenes of a text or CSV file, in its order."""
    with as_input_error(str(path)):
        return tuple(Scene(name=name, label=label) for name, label in read_scene_list(Path(path)))


def _view_matrix(
    image_shape: tuple[int, ...], calibration: Calibration, cells_shape: tuple[int, ...]
) -> "sparse.csr_array":
    """Matrix (down * across, h * w) from a scene to what each cell sees: rows sum to 1 or less."""
    from scipy import sparse

    if len(image_shape) != 2:
        raise InputError(f"scenes of shape {image_shape} are no images: a camera's view needs two")
    view = geometry_matrix(image_shape, cells_shape, calibration.homography, calibration.blur)
    if not view.nnz:
        raise InputError("no cell looks at the display: calibrate the camera again")
    flat = _at_cells(np.array(calibration.flat), cells_shape)
    return sparse.csr_array(sparse.diags_array(flat.ravel()) @ view)


def camera_view(
    x: np.ndarray,
    image_shape: tuple[int, ...],
    calibration: Calibration,
    cells_shape: tuple[int, ...] | None = None,
) -> np.ndarray:
    """Scenes as the cells of a mask see them."""
    x = np.asarray(x, dtype=np.float32)
    view = _view_matrix(image_shape, calibration, cells_shape or image_shape).astype(np.float32)
    if x.ndim != 2 or x.shape[1] != view.shape[1]:
        raise InputError(f"scenes of shape {x.shape} with images of {image_shape}: give (n, h * w)")
    out = np.empty((len(x), view.shape[0]), dtype=np.float32)
    for first in range(0, len(x), VIEWED_AT_ONCE):
        block = x[first : first + VIEWED_AT_ONCE]
        out[first : first + VIEWED_AT_ONCE] = (view @ np.ascontiguousarray(block.T)).T
    return np.clip(out, 0, 1, out=out)  # rounding


def view_dataset(data: Dataset, camera: Calibration | Path) -> Dataset:
    """Data set of images as the camera sees them, to train on; its preprocessing says so."""
    calibration = Calibration.load(camera) if isinstance(camera, Path) else camera
    origin = None
    if isinstance(camera, Path) and data.origin is not None:
        origin = data.origin.model_copy(update={"view": str(camera.absolute())})
    digest = hashlib.sha256(calibration.model_dump_json().encode()).hexdigest()
    return replace(
        data,
        origin=origin,
        x_train=camera_view(np.asarray(data.x_train), data.image_shape, calibration),
        x_test=camera_view(np.asarray(data.x_test), data.image_shape, calibration),
        preprocessing=(
            f"{data.preprocessing} Then as {'x'.join(map(str, data.image_shape))} cells of a "
            f"camera see it (calibration {digest[:12]})."
        ),
    )


def geometry_matrix(
    image_shape: tuple[int, ...],
    cells_shape: tuple[int, ...],
    homography: Any,
    blur: tuple[float, float],
) -> "sparse.csr_array":
    """Matrix (down * across, h * w) of geometry and blur: cell averages over points.

    Each point sees one pixel, or nothing beside the display. `homography` (3, 3) leads from the
    display to the device, in unit squares; `blur` is a standard deviation down and across, in the
    device's.
    """
    # The average over a cell of the blurred image is separable, so it is applied to the points'
    # pixels one axis after the other
    from scipy import sparse

    h, w = image_shape
    down, across = cells_shape
    average_down, tops = _axis_average(down, blur[0], POINTS_PER_CELL[0])
    average_across, lefts = _axis_average(across, blur[1], POINTS_PER_CELL[1])
    x, y = np.meshgrid(lefts, tops)
    back = np.linalg.inv(np.asarray(homography, dtype=float))
    u, v, scale = back @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    front = scale * np.sign(back[2] @ [0.5, 0.5, 1.0]) > 0  # not behind the camera
    with np.errstate(divide="ignore", invalid="ignore"):
        u = u / scale
        v = v / scale
    inside = np.flatnonzero(front & (u >= 0) & (u < 1) & (v >= 0) & (v < 1))
    pixel = (v[inside] * h).astype(int) * w + (u[inside] * w).astype(int)
    # rows: points down; columns: (point across, pixel)
    row, column = np.divmod(inside, len(lefts))
    shape = (len(tops), len(lefts) * h * w)
    points = sparse.csr_array((np.ones(len(inside)), (row, column * h * w + pixel)), shape=shape)
    half = (average_down @ points).tocoo()
    cell_row = half.row
    column, pixel = np.divmod(half.col, h * w)
    half = sparse.csr_array(
        (half.data, (column, cell_row * h * w + pixel)), shape=(len(lefts), down * h * w)
    )
    whole = (average_across @ half).tocoo()
    cell_row, pixel = np.divmod(whole.col, h * w)
    return sparse.csr_array(
        (whole.data, (cell_row * across + whole.row, pixel)), shape=(down * across, h * w)
    )


def _axis_average(cells: int, blur: float, each: int) -> tuple["sparse.csr_array", np.ndarray]:
    """Average of blurred light over each cell of an axis (cells, points), and the points."""
    # Points lie beyond the cells as far as the blur reaches
    from scipy import sparse

    step = 1 / (cells * each)
    beyond = int(np.ceil(4 * blur / step))
    places = (np.arange(-beyond, cells * each + beyond) + 0.5) * step
    kernel = np.ones(1)
    if beyond:
        kernel = np.exp(-((np.arange(-beyond, beyond + 1) * step / blur) ** 2) / 2)
    weights = np.convolve(kernel / kernel.sum(), np.full(each, 1 / each))
    cell = np.repeat(np.arange(cells), len(weights))
    point = cell * each + np.tile(np.arange(len(weights)), cells)
    values = np.tile(weights, cells)
    return sparse.csr_array((values, (cell, point)), shape=(cells, len(places))), places


def _at_cells(values: np.ndarray, cells_shape: tuple[int, ...]) -> np.ndarray:
    """Values of a grid over the unit square at the centres of another's cells, linear between."""
    from scipy import ndimage

    if values.shape == cells_shape:
        return values
    places = [
        (np.arange(n) + 0.5) / n * size - 0.5
        for n, size in zip(cells_shape, values.shape, strict=True)
    ]
    grid = np.meshgrid(*places, indexing="ij")
    return np.asarray(ndimage.map_coordinates(values, grid, order=1, mode="nearest"))


def camera_of(source: Path, settings: Mapping[str, Any] = MappingProxyType({})) -> Camera:
    """Camera of a design, with other settings; the preset `dmd` where none is known."""
    folders = (source, source / "patterns") if source.is_dir() else ()
    files = (folder / Patterns.DESIGN for folder in folders)
    file = next((file for file in files if file.is_file()), source)
    camera = None
    if file.is_file():
        with suppress(InputError):  # whoever opens the design says what is wrong with it
            camera = DesignFile.read(file, ()).camera
    return Camera.of_run(camera, **settings)


def design_rails(file: str | os.PathLike[str]) -> DesignRails:
    """Rails of a design file, to be shown; only adaptive masks need torch."""
    path = Path(file)
    if isinstance(DesignFile.read(path, ()).header, AdaptiveHeader):
        with require_extras():
            from deepfsi.lab.adaptive_looks import adaptive_rails
        return adaptive_rails(path)
    return DesignRails.of(
        DesignFile.read(path), read_regular(path, LARGEST_TENSORS, "give a design file")
    )

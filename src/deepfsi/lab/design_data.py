"""Data for a design: test data, pictures prepared as in its training, and scenes of a camera.

Notes say how data differ from the training's. A camera looks at pictures of a display, or at scenes
of a list of names. Through a calibrated camera the cells of a mask see

    x' = flat · average over each cell of (blurred image of x),

relative light in [0, 1], dark where a cell looks beside the display. A design that is trained on
such views of scenes fits the camera.
"""

import hashlib
import os
from collections.abc import Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import replace
from math import prod
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from deepfsi.base.arrays import LARGEST_TENSORS
from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.files import hash_file, read_regular
from deepfsi.base.registry import require_extras
from deepfsi.camera.camera import Camera
from deepfsi.counting.acquisition import Calibration, Scene
from deepfsi.datasets.dataset import Dataset, Origin
from deepfsi.datasets.display import array_display, read_display, read_scene_list
from deepfsi.datasets.load import absolute_source, find_source, load_dataset, prepare_display
from deepfsi.designfile.design_file import DesignFile
from deepfsi.designfile.provenance import (
    SCENE_ARRAYS,
    TrainingScenes,
    known_hashes,
    new_scenes,
    trained_camera,
    trained_on,
)
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.manifest import Manifest
from deepfsi.patterns.rails import DesignRails

if TYPE_CHECKING:
    from scipy import sparse

    from deepfsi.datasets.display import Display
    from deepfsi.design.design import Design


def open_design(
    path: Path, patterns: Patterns | None = None, *, trust: bool = False, static: bool = False
) -> "Design":
    """Open a design file, or the design as patterns realise it; `static` refuses adaptive masks."""
    with require_extras():
        from deepfsi.design.design import load_design

    if patterns is None and path.is_dir():
        patterns = Patterns.read(path).check()
    file = path if patterns is None else shown_design(path, patterns.manifest)
    design = load_design(file, trust=trust)
    if patterns is None and not static:
        return design
    design.exposure.check("masks")
    return design if patterns is None else design.as_shown(*patterns.realised)


def shown_design(path: Path, manifest: Manifest) -> Path:
    """Design file, also of a folder of patterns; `InputError` if it is not that of the manifest."""
    file = path / Patterns.DESIGN if path.is_dir() else path
    exported = manifest.design_sha256
    if (exported or manifest.looks) and hash_file(file) != exported:
        raise InputError(
            f"{file} is not the design whose patterns were shown: give the file that "
            "`deepfsi dmd export` was given"
        )
    return file


def data_of(
    design: "Design",
    data: str | None = None,
    size: tuple[int, int] | None = None,
    view: Path | None = None,
) -> tuple[Dataset, tuple[str, ...]]:
    """Test data of a design, by default from its training, and notes on how they differ."""
    training = trained_on(design.info)
    known = training.origin if training else None
    stated = {"size": size, "view": absolute_source(view) if view else None}
    stated = {option: value for option, value in stated.items() if value is not None}
    name = absolute_source(data) if data is not None else None
    if known is not None and name in (None, known.data):
        asked = known.model_copy(update=stated)
    elif name is None:
        raise InputError(f"{NO_ORIGIN}: give the data to test it on, `data`")
    else:
        names = {"rescale", "view", *({"size", "white"} & set(find_source(name).options))}
        kept = {option: getattr(known, option) for option in names} if known else {}
        asked = Origin(data=name).model_copy(update=kept | stated)
    try:
        loaded = _load(asked)
    except InputError as error:
        if data is not None:
            raise
        raise InputError(f"{error}; or give the data to test it on, `data`") from error
    notes = []
    if training is not None and not training.is_of(loaded):
        if known is None:
            note = f"this is not the data that the design was trained on, {training.name}"
        elif known == asked:
            note = f"{known.words} has changed since the design was trained on it"
        else:
            note = f"the design was trained on {known.words}; this is {asked.words}"
        notes.append(note)
    _, left = new_scenes(design.training_scenes, loaded)
    if design.training_scenes is None and notes:
        left = "test scenes may be among those it was trained on, which its file does not hold"
    return loaded, tuple(notes if left is None else [*notes, left])


NO_ORIGIN = "this design was trained on data that no file or name holds, such as arrays in memory"


def _load(origin: Origin) -> Dataset:
    options = origin.model_dump(exclude={"data", "normal", "skip_bad", "view", "fold"})
    scenes = load_dataset(origin.data, **options)
    if origin.fold is not None:
        index, count = origin.fold
        scenes = scenes.folds(count)[index]
    if origin.view is None:
        return scenes
    folder = Path(origin.view)
    return view_dataset(scenes, Calibration.load(folder), folder)


def design_scenes(
    info: Mapping[str, Any], image_shape: tuple[int, ...], pictures: Path | np.ndarray
) -> "Display":
    """Pictures prepared as the training data of a design with this provenance, and its view."""
    known = trained_on(info)
    origin = known.origin if known else None
    if isinstance(pictures, Path):
        if origin is None:
            raise InputError(
                f"{NO_ORIGIN}, and does not know what to do to pictures: learn it from pictures, "
                "or `evaluate` it on arrays with labels"
            )
        shown = prepare_display(pictures, origin)
    else:
        if pictures.ndim == 2 and pictures.shape[1] == prod(image_shape):
            pictures = pictures.reshape(-1, *image_shape)
        if pictures.dtype.kind == "f":  # reflectance, as a data set has it
            origin = None
        shown = prepare_display(pictures, origin) if origin else array_display(pictures)
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


def shown_scenes(source: Path, patterns: Patterns) -> tuple["Display", tuple[Scene, ...]]:
    """Pictures that are shown, and their scenes: names, classes of the folders and hashes.

    The design of the patterns gives the white of pictures whose type has none. Hashes are of the
    pictures as this design sees them.
    """
    design = origin = None
    if patterns.manifest.design_sha256 is not None and patterns.folder is not None:
        file = DesignFile.read(patterns.folder / Patterns.DESIGN, SCENE_ARRAYS)
        design = file.header
        known = trained_on(design.info)
        origin = known.origin if known else None
    size = None
    try:
        images = read_display(source)
    except InputError:
        if origin is None or origin.size is None:
            raise
        size = origin.size  # sizes that differ are brought to that of the design, as its data were
        images = read_display(source, shape=size)
    if images.levels.chosen and origin and origin.white is not None:
        images = read_display(source, origin.white, size)
    labels = images.labels or [None] * len(images.names)
    hashes: Sequence[str | None] = [None] * len(images.names)
    if design is not None:
        with suppress(InputError):  # it was made of arrays, or of pictures of another size
            x = design_scenes(design.info, design.image_shape, source).x
            training = TrainingScenes.restored(file.arrays)
            hashes = known_hashes(training, x, design.image_shape)
    return images, tuple(
        Scene(name=name, label=label, hash=digest)
        for name, label, digest in zip(images.names, labels, hashes, strict=True)
    )


def listed_scenes(source: Path, patterns: Patterns) -> tuple[Scene, ...]:
    """Scenes that someone shows to a camera."""
    if source.suffix.lower() in ("", ".txt", ".csv") and not source.is_dir():
        with as_input_error(str(source)):
            return tuple(Scene(name=name, label=label) for name, label in read_scene_list(source))
    return shown_scenes(source, patterns)[1]


def camera_view(
    x: np.ndarray,
    image_shape: tuple[int, ...],
    calibration: Calibration,
    cells_shape: tuple[int, ...] | None = None,
) -> np.ndarray:
    """Scenes as the cells of a mask see them."""
    from scipy import ndimage, sparse

    x = np.asarray(x, dtype=np.float32)
    cells_shape = cells_shape or image_shape
    if len(image_shape) != 2:
        raise InputError(f"scenes of shape {image_shape} are no images: a camera's view needs two")
    view = geometry_matrix(image_shape, cells_shape, calibration.homography, calibration.blur)
    if not view.nnz:
        raise InputError("no cell looks at the display: calibrate the camera again")
    flat = np.array(calibration.flat)
    # a flat field has the cells of its calibration, and is interpolated to those of the masks
    finer = np.divide(cells_shape, flat.shape)
    flat = ndimage.zoom(flat, finer, order=1, mode="nearest", grid_mode=True)
    view = sparse.csr_array(sparse.diags_array(flat.ravel()) @ view).astype(np.float32)
    out = np.empty((len(x), view.shape[0]), dtype=np.float32)
    for first in range(0, len(x), 4096):  # scenes in memory
        block = x[first : first + 4096]
        out[first : first + 4096] = (view @ np.ascontiguousarray(block.T)).T
    return np.clip(out, 0, 1, out=out)  # rounding


def view_dataset(data: Dataset, calibration: Calibration, folder: Path | None = None) -> Dataset:
    """Data set of images as a camera sees them; its origin is known if `folder` is given."""
    origin = None
    if folder is not None and data.origin is not None:
        origin = data.origin.model_copy(update={"view": str(folder.absolute())})
    digest = hashlib.sha256(calibration.model_dump_json().encode()).hexdigest()
    cells = "x".join(map(str, data.image_shape))
    words = f"Then as {cells} cells of a camera see it (calibration {digest[:12]})."
    return replace(
        data,
        origin=origin,
        x_train=camera_view(np.asarray(data.x_train), data.image_shape, calibration),
        x_test=camera_view(np.asarray(data.x_test), data.image_shape, calibration),
        preprocessing=f"{data.preprocessing} {words}",
    )


def geometry_matrix(
    image_shape: tuple[int, ...],
    cells_shape: tuple[int, ...],
    homography: Any,
    blur: tuple[float, float],
) -> "sparse.csr_array":
    """Matrix (down * across, h * w) of geometry and blur: cell averages over points.

    Each point sees one pixel, or nothing beside the display. `homography` (3, 3) leads from the
    display to the device, in unit squares; `blur` is a standard deviation (down, across) in the
    unit square of the device.
    """
    # The average over a cell of the blurred image is separable, so it is applied to the points'
    # pixels one axis after the other
    from scipy import sparse

    h, w = image_shape
    down, across = cells_shape
    # Points of a cell: a DLP7000's mirrors of 32 x 32 cells
    average_down, tops = _axis_average(down, blur[0], 24)
    average_across, lefts = _axis_average(across, blur[1], 32)
    x, y = np.meshgrid(lefts, tops)
    back = np.linalg.inv(np.asarray(homography, dtype=float))
    u, v, scale = back @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    front = scale * np.sign(back[2] @ [0.5, 0.5, 1.0]) > 0  # not behind the camera
    with np.errstate(divide="ignore", invalid="ignore"):
        u = u / scale
        v = v / scale
    inside = np.flatnonzero(front & (u >= 0) & (u < 1) & (v >= 0) & (v < 1))
    pixel = (v[inside] * h).astype(int) * w + (u[inside] * w).astype(int)
    row, column = np.divmod(inside, len(lefts))
    # Rows are points down, columns points across and pixels
    shape = (len(tops), len(lefts) * h * w)
    points = sparse.csr_array((np.ones(len(inside)), (row, column * h * w + pixel)), shape=shape)
    half = (average_down @ points).reshape(down * len(lefts), h * w).tocsr()
    return sparse.kron(sparse.eye_array(down), average_across, format="csr") @ half


def _axis_average(cells: int, blur: float, fine: int) -> tuple["sparse.csr_array", np.ndarray]:
    """Average of blurred light over each cell of an axis (cells, points), and the points.

    A cell has `fine` points; more lie beyond the cells, as far as the blur reaches.
    """
    from scipy import sparse

    step = 1 / (cells * fine)
    beyond = int(np.ceil(4 * blur / step))
    points = (np.arange(-beyond, cells * fine + beyond) + 0.5) * step
    kernel = np.ones(1)
    if beyond:
        kernel = np.exp(-((np.arange(-beyond, beyond + 1) * step / blur) ** 2) / 2)
    weights = np.convolve(kernel / kernel.sum(), np.full(fine, 1 / fine))
    cell = np.repeat(np.arange(cells), len(weights))
    point = cell * fine + np.tile(np.arange(len(weights)), cells)
    values = np.tile(weights, cells)
    return sparse.csr_array((values, (cell, point)), shape=(cells, len(points))), points


def camera_of(source: Path, settings: Mapping[str, Any] = MappingProxyType({})) -> Camera:
    """Camera of a design with `settings` replaced; the preset `dmd` if the design has none."""
    folders = (source, source / "patterns") if source.is_dir() else ()
    files = (folder / Patterns.DESIGN for folder in folders)
    file = next((file for file in files if file.is_file()), source)
    camera = None
    if file.is_file():
        # whoever opens the design of a folder says what is wrong with it
        with suppress(InputError) if source.is_dir() else nullcontext():
            camera = trained_camera(DesignFile.read(file, ()).header.info)
    return Camera.of_run(camera, **settings)


def design_rails(file: str | os.PathLike[str]) -> DesignRails:
    """Rails of a design file; only adaptive masks need torch."""
    path = Path(file)
    if DesignFile.read(path, ()).header.name == "adaptive":
        with require_extras():
            from deepfsi.lab.observer import adaptive_rails
        return adaptive_rails(path)
    return DesignRails.of(
        DesignFile.read(path), read_regular(path, LARGEST_TENSORS, "give a design file")
    )

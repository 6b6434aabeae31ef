"""Scenes as the cells of a mask see them through a calibrated camera.

The view of a scene x is

    x' = flat · average over each cell of (blurred image of x),

relative light in [0, 1], dark where a cell looks beside the display. Training on views instead of
scenes is what makes a design fit the camera.
"""

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.datasets.dataset import Dataset
from deepfsi.hardware.counting.acquisition import Calibration

if TYPE_CHECKING:
    from scipy import sparse

POINTS_PER_CELL = 24, 32
"""Points of a cell's average, down and across: a DLP7000's mirrors of 32 x 32 cells."""

VIEWED_AT_ONCE = 4096
"""Scenes that are viewed at once."""


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

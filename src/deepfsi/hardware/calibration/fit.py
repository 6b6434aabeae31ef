"""What the camera sees of the display: where, how sharp, how bright, and what it counts besides.

Places on the display and on the device are (across, down) in a *unit square* each: the displayed
image, and the area of the device that the cells of a mask fill. So a calibration made with a few
large cells serves masks with many small ones. The view of a scene x is

    x' = flat · average over each cell of (blurred image of x),

relative light in [0, 1], dark where a cell looks beside the display. Training on views instead of
scenes is what makes a design fit the camera.

To calibrate, show the scenes of `spot_scenes`, one of uniform white and one of uniform black, take
a picture of each (`acquisition.picture`) and give them to `calibrate`.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy import ndimage, optimize, sparse
from skimage import measure, transform

from deepfsi.datasets import Dataset
from deepfsi.errors import InputError, as_input_error
from deepfsi.files import write_atomically
from deepfsi.hardware.patterns.sequence import Grid, Patterns
from deepfsi.hardware.recording.counts import Counts

__all__ = [
    "BLACK",
    "WHITE",
    "Calibration",
    "Homography",
    "background",
    "black_rates",
    "calibrate",
    "calibrate_run",
    "camera_view",
    "find_blur",
    "find_flat",
    "find_homography",
    "find_spots",
    "load_calibration",
    "save_calibration",
    "spot_scenes",
    "subtract_background",
    "view_dataset",
    "view_matrix",
]

SCHEMA: Literal[1] = 1
WHITE, BLACK = "white.png", "black.png"
FILE = "calibration.json"
POINTS = 24, 32  # of a cell's average, down and across: a DLP7000's mirrors of 32 x 32 cells
WINDOW = 1.5  # cells, standard deviation of the window in which a spot is centred
FAINT = 6.0  # a spot is seen where its peak is this many standard deviations of the noise
OUTLIER = 0.5  # cells
SEEN = 0.5  # of a cell that the display fills: where the flat field is fitted, not continued
DEGREE = 4  # of its polynomial
CELLS_PER_TERM = 4
WIDEST = 2.0  # cells, largest blur that is looked for
BLOCK = 4096  # scenes at a time

Number = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Rate = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Row = tuple[Number, Number, Number]
Progress = Callable[[float], None]


class Calibration(BaseModel):
    """What one camera and one display do to a scene.

    Attributes
    ----------
    homography : 3 x 3 numbers
        Display → device, unit squares, (across, down, 1).
    residual : float
        Root mean square distance of the spots from it, cells.
    spots, shown : int
        Spots that it rests on, and spots that were shown.
    blur : tuple of float
        Standard deviation of a Gaussian, down and across, in the device's unit square.
    flat : rows of numbers, shape (down, across)
        Light of each cell relative to the brightest, for a uniform scene that fills the view.
    dark : float
        Counts/s with all mirrors OFF and the display black.
    ambient : float
        Counts/s that all mirrors ON add to it, the display black.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: Literal[1] = SCHEMA
    deepfsi: str = version("deepfsi")
    homography: tuple[Row, Row, Row]
    residual: Rate
    spots: int = Field(ge=4)
    shown: int = Field(ge=4)
    blur: tuple[Share, Share] = (0.0, 0.0)
    flat: tuple[tuple[Share, ...], ...] = Field(((1.0,),), min_length=1)
    dark: Rate = 0.0
    ambient: Rate = 0.0

    @model_validator(mode="after")
    def _whole(self) -> "Calibration":
        if len({len(row) for row in self.flat}) != 1 or not self.flat[0]:
            raise ValueError("the rows of the flat field differ in length")
        if not any(map(any, self.flat)):
            raise ValueError("the flat field is dark everywhere")
        if abs(np.linalg.det(np.array(self.homography))) < 1e-9:
            raise ValueError("the homography cannot be inverted")
        return self


@dataclass(frozen=True)
class Homography:
    """What `find_homography` found.

    Attributes
    ----------
    matrix : array, shape (3, 3)
        Display → device in unit squares.
    residual : float
        Root mean square distance of the spots from it, cells.
    spots : int
        Spots that it rests on.
    """

    matrix: np.ndarray
    residual: float
    spots: int


def spot_scenes(
    image_shape: tuple[int, int], count: tuple[int, int] = (5, 5), side: int = 2
) -> np.ndarray:
    """Scenes of one bright square each, on a regular grid over the display.

    Parameters
    ----------
    image_shape : tuple of int
        Pixels of the display, down and across.
    count : tuple of int
        Spots down and across, at least 2 each.
    side : int
        Pixels of a square.

    Returns
    -------
    array, shape (spots, down, across)
        Reflectance, float32: 1 in the square, 0 elsewhere.

    Raises
    ------
    InputError
        If fewer than 2 x 2 spots are asked for, or they do not fit side by side.
    """
    room = np.array(image_shape) - np.array(count) * side
    if min(count) < 2 or side < 1 or room.min() < 0:
        raise InputError(
            f"{count[0]} x {count[1]} spots of {side} pixels do not fit a display of "
            f"{image_shape[0]} x {image_shape[1]}: give 2 x 2 or more that fit side by side"
        )
    tops, lefts = (
        np.round((np.arange(n) + 0.5) * s / n - side / 2).astype(int)
        for n, s in zip(count, image_shape, strict=True)
    )
    scenes = np.zeros((count[0] * count[1], *image_shape), dtype=np.float32)
    for scene, (top, left) in zip(scenes, np.ndindex(count), strict=True):
        scene[tops[top] : tops[top] + side, lefts[left] : lefts[left] + side] = 1
    return scenes


def calibrate(
    scenes: np.ndarray,
    pictures: np.ndarray,
    grid: Grid,
    *,
    white: np.ndarray | None = None,
    black: np.ndarray | None = None,
    dark: float = 0.0,
    ambient: float = 0.0,
) -> Calibration:
    """Fit a calibration to pictures of spots, and of uniform scenes if they are there.

    Parameters
    ----------
    scenes : array, shape (spots, h, w)
        What was displayed, one bright spot each on black.
    pictures : array, shape (spots, down, across)
        What the camera measured of each, in any unit.
    grid : Grid
        Of the patterns with which the pictures were taken.
    white, black : array, shape (down, across), optional
        Pictures of a uniform white scene and of a black one, in the unit of `pictures`. Without
        `white` the flat field is 1; what `black` shows is taken from every other picture.
    dark, ambient : float
        Counts/s, as `black_rates` gives them.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If arrays do not fit each other, or fewer than four spots are seen.
    """
    scenes, pictures = np.asarray(scenes, dtype=float), np.asarray(pictures, dtype=float)
    cells = (grid.down, grid.across)
    if scenes.ndim != 3 or pictures.shape != (len(scenes), *cells):
        raise InputError(
            f"scenes of shape {scenes.shape} and pictures of shape {pictures.shape}: give one "
            f"picture of {cells[0]} x {cells[1]} cells for each displayed image"
        )
    for name, picture in (("white", white), ("black", black)):
        if picture is not None and np.shape(picture) != cells:
            raise InputError(
                f"the {name} picture has shape {np.shape(picture)}: give {cells[0]} x {cells[1]}"
            )
    floor = 0.0 if black is None else np.asarray(black, dtype=float)
    pictures = pictures - floor
    shown, measured = _centroids(scenes), find_spots(pictures)
    fit = find_homography(shown, measured, cells)
    blur = find_blur(scenes, pictures, fit.matrix, grid)
    flat = None if white is None else find_flat(white - floor, scenes.shape[1:], fit.matrix, blur)
    return Calibration(
        homography=fit.matrix.tolist(),
        residual=fit.residual,
        spots=fit.spots,
        shown=len(scenes),
        blur=blur,
        flat=((1.0,),) if flat is None else tuple(map(tuple, flat.tolist())),
        dark=dark,
        ambient=ambient,
    )


def calibrate_run(
    shown: Mapping[str, np.ndarray],
    names: Sequence[str],
    pictures: np.ndarray,
    counts: Counts,
    grid: Grid,
) -> Calibration:
    """Calibrate from one acquisition of spots, a white and a black picture.

    Parameters
    ----------
    shown : mapping of str to array, shape (h, w)
        Displayed pictures by name; `WHITE` and `BLACK` are uniform, all others are spots.
    names : sequence of str
        Of the acquisition's scenes.
    pictures : array, shape (S, down, across)
        What was measured of each, by `acquisition.picture`.
    counts : Counts
    grid : Grid

    Raises
    ------
    InputError
        If a scene was not among those shown, or the fit fails.
    """
    unknown = sorted(set(names) - set(shown))
    if unknown:
        raise InputError(
            f"the run has a scene {unknown[0]} that is none of the displayed pictures: give the "
            "folder that `deepfsi camera spots` wrote"
        )
    measured = dict(zip(names, pictures, strict=True))
    spots = [name for name in names if name not in (WHITE, BLACK)]
    dark = ambient = 0.0
    if BLACK in measured:
        place = list(names).index(BLACK)
        dark, ambient = black_rates(counts.on_rate[[place]], counts.off_rate[[place]])
    return calibrate(
        np.stack([shown[name] for name in spots]) if spots else np.empty((0, 1, 1)),
        np.stack([measured[name] for name in spots]) if spots else np.empty((0, 1, 1)),
        grid,
        white=measured.get(WHITE),
        black=measured.get(BLACK),
        dark=dark,
        ambient=ambient,
    )


def find_spots(pictures: np.ndarray) -> np.ndarray:
    """Centre of the spot in each picture.

    Parameters
    ----------
    pictures : array, shape (n, down, across)

    Returns
    -------
    array, shape (n, 2)
        (across, down) in the unit square; NaN where no spot stands out of the noise.
    """
    pictures = np.asarray(pictures, dtype=float)
    down, across = np.indices(pictures.shape[1:])
    out = np.full((len(pictures), 2), np.nan)
    for place, picture in enumerate(pictures):
        light = picture - np.median(picture)
        smooth = ndimage.gaussian_filter(light, 1.0, mode="constant")
        noise = 1.4826 * np.median(np.abs(smooth - np.median(smooth)))
        top = np.unravel_index(smooth.argmax(), smooth.shape)
        if not smooth[top] > FAINT * noise:
            continue
        centre = np.array(top, dtype=float)
        for _ in range(50):  # a Gaussian window follows the spot, which undoes its own pull
            offset = np.array([down - centre[0], across - centre[1]])
            weight = light * np.exp(-(offset**2).sum(axis=0) / (2 * WINDOW**2))
            step = 2 * (weight * offset).sum(axis=(1, 2)) / max(weight.sum(), 1e-300)
            centre += np.clip(step, -1, 1)
            if np.abs(step).max() < 1e-6:
                break
        inside = (centre > -0.5).all() and (centre < np.array(smooth.shape) - 0.5).all()
        if inside:
            out[place] = (centre[::-1] + 0.5) / smooth.shape[::-1]
    return out


def find_homography(
    display: np.ndarray, device: np.ndarray, cells: tuple[int, int], seed: int = 0
) -> Homography:
    """Homography that brings places on the display to places on the device.

    Spots that lie more than half a cell from what the others say are left out (RANSAC).

    Parameters
    ----------
    display, device : array, shape (n, 2)
        (across, down) in unit squares; NaN where a spot was not seen.
    cells : tuple of int
        Down and across, the unit of residuals.
    seed : int
        Of RANSAC's draws.

    Returns
    -------
    Homography

    Raises
    ------
    InputError
        If fewer than four spots agree on one, or they lie on a line.
    """
    seen = np.isfinite(device).all(axis=1)
    scale = np.array(cells[::-1], dtype=float)
    source, target = np.asarray(display)[seen], np.asarray(device)[seen] * scale
    trouble = (
        f"{seen.sum()} of {len(seen)} spots are seen, or too few agree on one perspective: four "
        "that do not lie on a line are needed; show larger spots, expose longer or aim the camera"
    )
    if seen.sum() < 4:
        raise InputError(trouble)
    _, inliers = measure.ransac(
        (source, target),
        transform.ProjectiveTransform,
        min_samples=4,
        residual_threshold=OUTLIER,
        max_trials=500,
        stop_probability=0.9999,
        rng=seed,
    )
    if inliers is None or inliers.sum() < 4:
        raise InputError(trouble)
    model = transform.estimate_transform("projective", source[inliers], target[inliers])
    if not model or not np.isfinite(model.params).all():
        raise InputError(trouble)
    distance = model.residuals(source[inliers], target[inliers])
    matrix = np.diag([*(1 / scale), 1.0]) @ model.params
    matrix /= matrix[2, 2]
    return Homography(
        matrix=matrix,
        residual=float(np.sqrt((distance**2).mean())),
        spots=int(inliers.sum()),
    )


def find_blur(
    scenes: np.ndarray, pictures: np.ndarray, homography: Any, grid: Grid
) -> tuple[float, float]:
    """Blur that explains pictures of spots best, each spot with a brightness of its own.

    Parameters
    ----------
    scenes : array, shape (n, h, w)
        What was displayed.
    pictures : array, shape (n, down, across)
        What was measured.
    homography : 3 x 3 numbers
    grid : Grid
        Gives the shape of a cell: the blur is round on the device.

    Returns
    -------
    tuple of float
        Standard deviation down and across, in the device's unit square.
    """
    cells = (grid.down, grid.across)
    flat_scenes = np.asarray(scenes, dtype=float).reshape(len(scenes), -1)
    measured = np.asarray(pictures, dtype=float).reshape(len(pictures), -1)
    side = np.sqrt(grid.height * grid.width)

    def spread(width: float) -> tuple[float, float]:
        return width * side / (grid.down * grid.height), width * side / (grid.across * grid.width)

    def misfit(width: float) -> float:
        model = (_matrix(scenes.shape[1:], cells, homography, spread(width)) @ flat_scenes.T).T
        power = (model**2).sum(axis=1)
        match = (model * measured).sum(axis=1)
        explained = np.divide(match**2, power, out=np.zeros_like(power), where=power > 0)
        return float((measured**2).sum() - explained.sum())

    found = optimize.minimize_scalar(
        misfit, bounds=(0, WIDEST), method="bounded", options={"xatol": 5e-3}
    )
    return spread(0.0) if misfit(0.0) <= found.fun else spread(float(found.x))


def find_flat(
    white: np.ndarray,
    image_shape: tuple[int, ...],
    homography: Any,
    blur: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """Flat field of a picture of a uniform white scene.

    A polynomial of the place, of degree 4 at most, so that the noise of the picture's cells does
    not become part of the view; it follows what a lens does, but no dust. Cells that the display
    fills less than half have the value of the nearest cell that it fills.

    Parameters
    ----------
    white : array, shape (down, across)
    image_shape : tuple of int
        Pixels of the display.
    homography : 3 x 3 numbers
    blur : tuple of float

    Returns
    -------
    array, shape (down, across)
        Relative to its largest value.

    Raises
    ------
    InputError
        If the display fills no cell or the picture is dark.
    """
    white = np.asarray(white, dtype=float)
    filled = _matrix(image_shape, white.shape, homography, blur).sum(axis=1).reshape(white.shape)
    seen = filled > SEEN
    if not (seen.any() and white[seen].mean() > 0):
        raise InputError(
            "the picture of the white scene is dark, or the camera does not look at the display: "
            "take it again with a longer exposure"
        )
    terms = [(i, n - i) for n in range(DEGREE + 1) for i in range(n + 1)]
    terms = terms[: max(1, int(seen.sum()) // CELLS_PER_TERM)]
    down, across = (2 * (np.arange(n) + 0.5) / n - 1 for n in white.shape)
    basis = np.stack([np.outer(down**i, across**j) for i, j in terms])
    scaled = (basis * filled)[:, seen].T
    weights, *_ = np.linalg.lstsq(scaled, white[seen], rcond=None)
    flat = np.tensordot(weights, basis, 1).clip(0)
    nearest = ndimage.distance_transform_edt(~seen, return_distances=False, return_indices=True)
    flat = flat[tuple(nearest)]
    return np.asarray(flat / flat.max())


def black_rates(on_rate: np.ndarray, off_rate: np.ndarray) -> tuple[float, float]:
    """Dark and ambient rates of a run with the display black.

    Parameters
    ----------
    on_rate, off_rate : array
        Counts/s in the frames with all mirrors ON and OFF, as `acquisition.Counts` has them.

    Returns
    -------
    dark, ambient : float
        Counts/s. NaN passes are left out; an ambient rate below 0 is noise and becomes 0.

    Raises
    ------
    InputError
        If no pass has both rates.
    """
    on, off = np.broadcast_arrays(np.asarray(on_rate, float), np.asarray(off_rate, float))
    whole = np.isfinite(on) & np.isfinite(off)
    if not whole.any():
        raise InputError("no pass has frames all ON and all OFF: record the black scene again")
    dark = float(off[whole].mean())
    return dark, max(0.0, float(on[whole].mean()) - dark)


def view_matrix(
    image_shape: tuple[int, ...], calibration: Calibration, cells_shape: tuple[int, int]
) -> sparse.csr_array:
    """Matrix from a displayed scene to what each cell sees of it.

    Parameters
    ----------
    image_shape : tuple of int
        (h, w) of the scene.
    calibration : Calibration
    cells_shape : tuple of int
        Cells of a mask, down and across.

    Returns
    -------
    sparse array, shape (down * across, h * w)
        Its rows sum to at most 1.

    Raises
    ------
    InputError
        If the scene is no image, or no cell looks at the display.
    """
    if len(image_shape) != 2:
        raise InputError(f"scenes of shape {image_shape} are no images: a camera's view needs two")
    view = _matrix(image_shape, cells_shape, calibration.homography, calibration.blur)
    if not view.nnz:
        raise InputError("no cell looks at the display: calibrate the camera again")
    flat = _at_cells(np.array(calibration.flat), cells_shape)
    return sparse.csr_array(sparse.diags_array(flat.ravel()) @ view)


def camera_view(
    x: np.ndarray,
    image_shape: tuple[int, ...],
    calibration: Calibration,
    cells_shape: tuple[int, int] | None = None,
) -> np.ndarray:
    """Scenes as the cells of a mask see them.

    Parameters
    ----------
    x : array, shape (n, h * w)
        Reflectance in [0, 1].
    image_shape : tuple of int
        (h, w) of a scene.
    calibration : Calibration
    cells_shape : tuple of int, optional
        Down and across; as the scene unless given.

    Returns
    -------
    array, shape (n, down * across), float32
        Relative light in [0, 1].

    Raises
    ------
    InputError
        If shapes do not fit.
    """
    x = np.asarray(x, dtype=np.float32)
    if len(image_shape) != 2 or x.ndim != 2 or x.shape[1] != np.prod(image_shape):
        raise InputError(
            f"scenes of shape {x.shape} with images of {image_shape}: give one row of h * w "
            "values for each image"
        )
    down, across = cells_shape or (image_shape[0], image_shape[1])
    view = view_matrix(image_shape, calibration, (down, across)).astype(np.float32)
    out = np.empty((len(x), down * across), dtype=np.float32)
    for first in range(0, len(x), BLOCK):
        block = x[first : first + BLOCK]
        out[first : first + BLOCK] = (view @ np.ascontiguousarray(block.T)).T
    return np.clip(out, 0, 1, out=out)  # rounding


def view_dataset(
    data: Dataset, calibration: Calibration, cells_shape: tuple[int, int] | None = None
) -> Dataset:
    """Data set whose scenes are as the camera sees them, to train on.

    Parameters
    ----------
    data : Dataset
        Images.
    calibration : Calibration
    cells_shape : tuple of int, optional
        Cells of a mask, down and across; as the images unless given.

    Returns
    -------
    Dataset
        Its preprocessing names the calibration.

    Raises
    ------
    InputError
        If the scenes are no images.
    """
    content = calibration.model_dump_json().encode()
    shape = cells_shape or data.image_shape
    if len(shape) != 2:
        raise InputError(
            f"{data.name}: scenes of shape {shape} are no images: give a data set of some"
        )
    return replace(
        data,
        x_train=camera_view(data.x_train, data.image_shape, calibration, shape),
        x_test=camera_view(data.x_test, data.image_shape, calibration, shape),
        image_shape=shape,
        preprocessing=(
            f"{data.preprocessing} Then as {shape[0]}x{shape[1]} cells of a camera see it "
            f"(calibration {hashlib.sha256(content).hexdigest()[:12]})."
        ),
    )


def background(
    patterns: Patterns,
    exposure_s: float,
    dark: float | np.ndarray,
    ambient: float | np.ndarray = 0.0,
) -> np.ndarray:
    """Expected counts of each readout that do not come from the scene.

    The dark rate counts during every gate; ambient light as far as the frame's mirrors are ON,
    spread evenly over the cells.

    Parameters
    ----------
    patterns : Patterns
    exposure_s : float
        Total exposure, seconds; a frame's gate is its share of it.
    dark, ambient : float or array, shape (rails,)
        Counts/s; one for each detector on two arms.

    Returns
    -------
    array, shape (rails, m)
        Counts; 0 for a rail that is not shown.
    """
    manifest = patterns.manifest
    dark, ambient = (np.broadcast_to(rate, manifest.rails) for rate in (dark, ambient))
    out = np.zeros((manifest.rails, manifest.masks))
    opened = patterns.fractions.mean(axis=1)
    for place, share, part in zip(manifest.shown, manifest.shares, opened, strict=True):
        frame, gate = manifest.frames[place], share * exposure_s
        if frame.rail in ("plus", "both"):
            out[0, frame.mask] = gate * (dark[0] + ambient[0] * part)
        if frame.rail in ("minus", "both"):
            part = 1 - part if frame.rail == "both" else part
            out[1, frame.mask] = gate * (dark[1] + ambient[1] * part)
    return out


def subtract_background(
    counts: np.ndarray,
    patterns: Patterns,
    exposure_s: float,
    dark: float | np.ndarray,
    ambient: float | np.ndarray = 0.0,
) -> np.ndarray:
    """Counts (..., rails, m) less what `background` expects of dark counts and ambient light.

    The noise of both stays. The parameters are those of `background`.

    Raises
    ------
    InputError
        If the counts are not those of the patterns.
    """
    expected = background(patterns, exposure_s, dark, ambient)
    if np.shape(counts)[-2:] != expected.shape:
        raise InputError(
            f"counts of shape {np.shape(counts)} are not of these patterns: give "
            f"(..., {expected.shape[0]}, {expected.shape[1]})"
        )
    return np.asarray(counts) - expected


def save_calibration(calibration: Calibration, folder: Path) -> Path:
    """Write `calibration.json` into a folder, which is made if need be."""
    return write_atomically(folder / FILE, calibration.model_dump_json(indent=1).encode())


def load_calibration(folder: Path) -> Calibration:
    """Read `calibration.json` of a folder.

    Raises
    ------
    InputError
        If it is missing or damaged.
    """
    path = Path(folder) / FILE
    try:
        with as_input_error(f"'{path}'", "calibrate the camera again"):
            return Calibration.model_validate_json(path.read_bytes())
    except OSError as error:
        raise InputError(
            f"no calibration at '{path}' ({error.strerror}): calibrate the camera first"
        ) from None


def _centroids(scenes: np.ndarray) -> np.ndarray:
    """Centroid (across, down) of each scene's light, in the unit square."""
    light = scenes - scenes.min(axis=(1, 2), keepdims=True)
    total = light.sum(axis=(1, 2))
    if not (total > 0).all():
        raise InputError("a displayed scene is uniform: show one bright spot in each")
    places = [(np.arange(size) + 0.5) / size for size in scenes.shape[:0:-1]]
    across, down = light.sum(axis=1) @ places[0], light.sum(axis=2) @ places[1]
    return np.stack([across, down], axis=1) / total[:, None]


def _matrix(
    image_shape: tuple[int, ...],
    cells_shape: tuple[int, ...],
    homography: Any,
    blur: tuple[float, float],
) -> sparse.csr_array:
    """Geometry and blur, (cells, pixels): cell averages over points that each see one pixel.

    The average over a cell of the blurred image is separable, so it is applied to the points'
    pixels one axis after the other.
    """
    (h, w), (down, across) = image_shape, cells_shape
    average_down, tops = _axis_average(down, blur[0], POINTS[0])
    average_across, lefts = _axis_average(across, blur[1], POINTS[1])
    x, y = np.meshgrid(lefts, tops)
    back = np.linalg.inv(np.asarray(homography, dtype=float))
    u, v, scale = back @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    front = scale * np.sign(back[2] @ [0.5, 0.5, 1.0]) > 0  # not behind the camera
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = u / scale, v / scale
    inside = np.flatnonzero(front & (u >= 0) & (u < 1) & (v >= 0) & (v < 1))
    pixel = (v[inside] * h).astype(int) * w + (u[inside] * w).astype(int)
    # rows: points down; columns: (point across, pixel)
    row, column = np.divmod(inside, len(lefts))
    shape = (len(tops), len(lefts) * h * w)
    points = sparse.csr_array((np.ones(len(inside)), (row, column * h * w + pixel)), shape=shape)
    half = (average_down @ points).tocoo()
    cell_row, (column, pixel) = half.row, np.divmod(half.col, h * w)
    half = sparse.csr_array(
        (half.data, (column, cell_row * h * w + pixel)), shape=(len(lefts), down * h * w)
    )
    whole = (average_across @ half).tocoo()
    cell_row, pixel = np.divmod(whole.col, h * w)
    return sparse.csr_array(
        (whole.data, (cell_row * across + whole.row, pixel)), shape=(down * across, h * w)
    )


def _axis_average(cells: int, blur: float, each: int) -> tuple[sparse.csr_array, np.ndarray]:
    """Average of blurred light over each cell of an axis, (cells, points), and the points.

    Points lie beyond the cells as far as the blur reaches.
    """
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


def _at_cells(values: np.ndarray, cells_shape: tuple[int, int]) -> np.ndarray:
    """Values of a grid over the unit square at the centres of another's cells, linear between."""
    if values.shape == cells_shape:
        return values
    places = [
        (np.arange(n) + 0.5) / n * size - 0.5
        for n, size in zip(cells_shape, values.shape, strict=True)
    ]
    return np.asarray(
        ndimage.map_coordinates(
            values, np.meshgrid(*places, indexing="ij"), order=1, mode="nearest"
        )
    )

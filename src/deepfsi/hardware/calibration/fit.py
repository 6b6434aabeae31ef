"""Calibrations fitted to pictures of spots, of uniform white and of uniform black.

Show the scenes of `spot_scenes`, one of uniform white and one of uniform black, take a picture of
each (`recording.picture.reconstruct`) and give them to `calibrate`.
"""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import ndimage
from skimage import measure, transform

from deepfsi.base.errors import InputError
from deepfsi.camera.layout import Grid
from deepfsi.hardware.calibration.background import expected_background
from deepfsi.hardware.calibration.refine import fit_view
from deepfsi.hardware.calibration.view import geometry_matrix
from deepfsi.hardware.counting.calibration_file import Calibration
from deepfsi.hardware.counting.counts import Counts
from deepfsi.hardware.patterns.sequence import Patterns

WHITE, BLACK = "white.png", "black.png"
"""Names of the pictures of uniform white and black."""

WINDOW_CELLS = 1.5
"""Standard deviation of the window in which a spot is centred, cells."""

LEAST_PEAK_STD = 6.0
"""A spot is seen where its peak is this many standard deviations of the noise."""

FIRST_OUTLIER_CELLS = 1.0
"""Distance beyond which a spot is left out of the first homography, cells."""

LEAST_FILLED = 0.5
"""Share of a cell that the display fills where the flat field is fitted, not continued."""

FLAT_DEGREE = 4
"""Degree of the flat field's polynomial, at most."""

CELLS_PER_TERM = 4
"""Cells that each term of the polynomial needs."""


def spot_scenes(
    image_shape: tuple[int, int], count: tuple[int, int] = (5, 5), side: int = 2
) -> np.ndarray:
    """Scenes of one bright square each, on a regular grid over the display."""
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


@np.errstate(under="ignore")
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
    """Fit a calibration to pictures of spots, and of uniform scenes if they are there."""
    # scenes (spots, h, w); pictures (spots, down, across); white, black (down, across)
    scenes, pictures = np.asarray(scenes, dtype=float), np.asarray(pictures, dtype=float)
    cells = (grid.down, grid.across)
    _check_shapes(scenes, pictures, {"white": white, "black": black}, cells)
    floor = 0.0 if black is None else np.asarray(black, dtype=float)
    pictures = pictures - floor
    first, agreed = find_homography(_centroids(scenes), find_spots(pictures), cells)
    view = fit_view(scenes, pictures, grid, first, agreed)
    flat = (
        None
        if white is None
        else find_flat(white - floor, scenes.shape[1:], view.matrix, view.blur)
    )
    return Calibration(
        homography=view.matrix.tolist(),
        residual=view.residual,
        error=view.error,
        spots=int(view.used.sum()),
        shown=len(scenes),
        blur=view.blur,
        flat=((1.0,),) if flat is None else tuple(map(tuple, flat.tolist())),
        dark=dark,
        ambient=ambient,
    )


def _check_shapes(
    scenes: np.ndarray,
    pictures: np.ndarray,
    uniform: Mapping[str, np.ndarray | None],
    cells: tuple[int, int],
) -> None:
    """Raise `InputError` unless there is a picture of each scene, all of these cells."""
    if scenes.ndim != 3 or pictures.shape != (len(scenes), *cells):
        raise InputError(
            f"scenes of shape {scenes.shape} and pictures of shape {pictures.shape}: give one "
            f"picture of {cells[0]} x {cells[1]} cells for each displayed image"
        )
    for name, picture in uniform.items():
        if picture is not None and np.shape(picture) != cells:
            raise InputError(
                f"the {name} picture has shape {np.shape(picture)}: give {cells[0]} x {cells[1]}"
            )


def calibrate_run(
    shown: Mapping[str, np.ndarray],
    names: Sequence[str],
    pictures: np.ndarray,
    counts: Counts,
    patterns: Patterns,
) -> Calibration:
    """Calibrate from one acquisition of spots, a white and a black picture."""
    # shown (h, w); pictures (S, down, across)
    unknown = sorted(set(names) - set(shown))
    if unknown:
        raise InputError(
            f"the run has a scene {unknown[0]} that is none of the displayed pictures: give the "
            "folder that `deepfsi camera spots` wrote"
        )
    counted = np.any(counts.valid, axis=1)
    measured = dict(zip(names, pictures, strict=True))
    for name in (WHITE, BLACK):
        if name in measured and not counted[list(names).index(name)]:
            raise InputError(
                f"no exposure of {name} was counted: record the run again, or leave "
                "that picture out of it"
            )
    spots = [name for name in names if name not in (WHITE, BLACK)]
    dark, ambient = float(counts.dark_rate[counted].mean()), 0.0
    if BLACK in measured:
        place = list(names).index(BLACK)
        exposures = counts.signal()[place][counts.valid[place]]
        mean = exposures.sum() / max(len(exposures), 1)
        lit = expected_background(patterns, counts.exposure_s, dark=0.0, ambient=1.0).sum()
        ambient = max(0.0, float(mean / lit))
    fitted = calibrate(
        np.array([shown[name] for name in spots]),
        np.array([measured[name] for name in spots]),
        patterns.manifest.grid,
        white=measured.get(WHITE),
        black=measured.get(BLACK),
        dark=dark,
        ambient=ambient,
    )
    known = counts.dead_time if counts.dead_time.seconds else None
    return fitted.model_copy(update={"dead_time": known})


def find_spots(pictures: np.ndarray) -> np.ndarray:
    """Places (n, 2) of the spots in pictures (n, down, across), NaN where none is seen."""
    # (across, down) in the unit square. A spot is seen where it stands out of the noise
    pictures = np.asarray(pictures, dtype=float)
    down, across = np.indices(pictures.shape[1:])
    out = np.full((len(pictures), 2), np.nan)
    for place, picture in enumerate(pictures):
        excess = picture - np.median(picture)
        smooth = ndimage.gaussian_filter(excess, 1.0, mode="constant")
        noise = 1.4826 * np.median(np.abs(smooth - np.median(smooth)))
        top = np.unravel_index(smooth.argmax(), smooth.shape)
        if not smooth[top] > LEAST_PEAK_STD * noise:
            continue
        spot = np.array(top, dtype=float)
        for _ in range(50):  # a Gaussian window follows the spot, which undoes its own pull
            offset = np.array([down - spot[0], across - spot[1]])
            weight = excess * np.exp(-(offset**2).sum(axis=0) / (2 * WINDOW_CELLS**2))
            step = 2 * (weight * offset).sum(axis=(1, 2)) / max(weight.sum(), 1e-300)
            spot += np.clip(step, -1, 1)
            if np.abs(step).max() < 1e-6:
                break
        if (spot > -0.5).all() and (spot < np.array(smooth.shape) - 0.5).all():
            out[place] = (spot[::-1] + 0.5) / smooth.shape[::-1]
    return out


def find_homography(
    display: np.ndarray, device: np.ndarray, cells: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Homography (3, 3) from display to device in unit squares, and the spots (n,) it rests on."""
    # Spots that lie more than a cell from what the others say are left out (RANSAC). display,
    # device (n, 2)
    found = np.isfinite(device).all(axis=1)
    scale = np.array(cells[::-1], dtype=float)
    source, target = np.asarray(display)[found], np.asarray(device)[found] * scale
    trouble = (
        f"{found.sum()} of {len(found)} spots are seen, or too few agree on one perspective: four "
        "that do not lie on a line are needed; show larger spots, expose longer or aim the camera"
    )
    if found.sum() < 4:
        raise InputError(trouble)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "No inliers found")
        _, inliers = measure.ransac(
            (source, target),
            transform.ProjectiveTransform,
            min_samples=4,
            residual_threshold=FIRST_OUTLIER_CELLS,
            max_trials=500,
            stop_probability=0.9999,
            rng=0,
        )
    if inliers is None or inliers.sum() < 4 or _on_a_line(source[inliers]):
        raise InputError(trouble)
    model = transform.estimate_transform("projective", source[inliers], target[inliers])
    if not model or not np.isfinite(model.params).all():
        raise InputError(trouble)
    matrix = np.diag([*(1 / scale), 1.0]) @ model.params
    agreed = np.zeros(len(found), dtype=bool)
    agreed[np.flatnonzero(found)[inliers]] = True
    return matrix / matrix[2, 2], agreed


def find_flat(
    white: np.ndarray,
    image_shape: tuple[int, ...],
    homography: Any,
    blur: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """Flat field of a picture of a uniform white scene."""
    # A polynomial of the place, of degree 4 at most, so that the noise of the picture's cells does
    # not become part of the view; it follows what a lens does, but no dust. Cells that the display
    # fills less than half have the value of the nearest cell that it fills. The picture's shape is
    # (down, across), as the flat field's, which is relative to its largest value. Other parameters
    # as for `geometry_matrix`
    white = np.asarray(white, dtype=float)
    view = geometry_matrix(image_shape, white.shape, homography, blur)
    filled = view.sum(axis=1).reshape(white.shape)
    lit = filled > LEAST_FILLED
    if not (lit.any() and white[lit].mean() > 0):
        raise InputError(
            "the picture of the white scene is dark, or the camera does not look at the display: "
            "take it again with a longer exposure"
        )
    terms = [(i, n - i) for n in range(FLAT_DEGREE + 1) for i in range(n + 1)]
    terms = terms[: max(1, int(lit.sum()) // CELLS_PER_TERM)]
    down, across = (2 * (np.arange(n) + 0.5) / n - 1 for n in white.shape)
    basis = np.stack([np.outer(down**i, across**j) for i, j in terms])
    scaled = (basis * filled)[:, lit].T
    weights, *_ = np.linalg.lstsq(scaled, white[lit], rcond=None)
    flat = np.tensordot(weights, basis, 1).clip(0)
    nearest = ndimage.distance_transform_edt(~lit, return_distances=False, return_indices=True)
    flat = flat[tuple(nearest)]
    return np.asarray(flat / flat.max())


def _on_a_line(places: np.ndarray) -> bool:
    """True if places (n, 2) in the unit square lie on one line."""
    return bool(np.linalg.matrix_rank(places - places.mean(axis=0), tol=1e-9) < 2)


def _centroids(scenes: np.ndarray) -> np.ndarray:
    """Centroid (across, down) of each scene, in the unit square."""
    bright = scenes - scenes.min(axis=(1, 2), keepdims=True)
    total = bright.sum(axis=(1, 2))
    if not (total > 0).all():
        raise InputError("a displayed scene is uniform: show one bright spot in each")
    places = [(np.arange(size) + 0.5) / size for size in scenes.shape[:0:-1]]
    across, down = bright.sum(axis=1) @ places[0], bright.sum(axis=2) @ places[1]
    return np.stack([across, down], axis=1) / total[:, None]

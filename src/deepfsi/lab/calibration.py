"""Calibrations fitted to pictures of spots, of uniform white and of uniform black.

Spots smaller than a cell have biased centres. So centres give only a first homography, and the
spots that agree on it. Then pictures are fitted with images of their spots, light averaged over the
cells: all share one homography and one blur, and each spot has its own brightness.
"""

import math
import warnings
from itertools import product
from pathlib import Path

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.camera.detectors import DetectorMap
from deepfsi.camera.layout import DmdGrid
from deepfsi.counting.acquisition import Calibration
from deepfsi.counting.checks import SPOILING
from deepfsi.counting.counts import Counts
from deepfsi.counting.recording import Recording
from deepfsi.datasets.display import Display, write_pictures
from deepfsi.lab.design_data import geometry_matrix
from deepfsi.patterns.rails import DesignRails

WHITE = "white.png"
BLACK = "black.png"
"""Names of the pictures of uniform white and black."""


def spot_scenes(side: int = 2) -> np.ndarray:
    """Scenes (25, 32, 32) with a bright square each, on a regular grid over the display."""
    corners = np.round((np.arange(5) + 0.5) * 32 / 5 - side / 2).astype(int)
    scenes = np.zeros((25, 32, 32), dtype=np.float32)
    for scene, (top, left) in zip(scenes, product(corners, corners), strict=True):
        scene[top : top + side, left : left + side] = 1
    return scenes


def write_spots(folder: Path, side: int = 2) -> list[Path]:
    """Write the pictures that calibrate a camera: spots, uniform white and uniform black."""
    pictures = {f"spot-{k:02d}.png": spot for k, spot in enumerate(spot_scenes(side))}
    uniform = {WHITE: np.ones((32, 32)), BLACK: np.zeros((32, 32))}
    return write_pictures(pictures | uniform, folder)


@np.errstate(under="ignore")
def fit_calibration(
    scenes: np.ndarray,
    pictures: np.ndarray,
    grid: DmdGrid,
    *,
    white: np.ndarray | None = None,
    black: np.ndarray | None = None,
) -> Calibration:
    """Fit a calibration to pictures of spots, and of uniform scenes if they are there."""
    scenes = np.asarray(scenes, dtype=float)
    pictures = np.asarray(pictures, dtype=float)
    cells = (grid.down, grid.across)
    floor = 0.0 if black is None else np.asarray(black, dtype=float)
    pictures = pictures - floor
    first, agreed = find_homography(_find_spots(scenes), _find_spots(pictures), cells)
    spots = DisplayedScenes(scenes[agreed], grid)
    start = np.append(first.ravel()[:8], 0.3)  # at a blur of 0 the misfit has no slope
    view, covariance = _fit_view(spots, pictures[agreed], start)
    # Centroids of small spots are biased alike in the pictures and in their fit
    shifts = _find_spots(pictures[agreed]) - _find_spots(spots.images(view), clear=0.0)
    distances = np.linalg.norm(shifts * spots.cells[::-1], axis=1)
    matrix = np.append(view[:8], 1).reshape(3, 3)
    down, across = (view[8] * spots.side / spots.cells).tolist()
    flat = np.ones((1, 1))
    if white is not None:
        flat = _find_flat(white - floor, scenes.shape[1:], matrix, (down, across))
    return Calibration(
        homography=matrix.tolist(),
        residual=float(np.sqrt((distances**2).mean())),
        error=_corner_error(spots, view, covariance),
        spots=len(distances),
        shown=len(scenes),
        blur=(down, across),
        flat=tuple(map(tuple, flat.tolist())),
    )


def calibrate(shown: Display, run: Recording, counts: Counts) -> Calibration:
    """Calibrate from a run of spots, and of a white and a black picture if it has them."""
    names = [scene.name for scene in run.acquisition.scenes]
    unknown = sorted(set(names) - set(shown.names))
    if unknown:
        raise InputError(
            f"the run has a scene {unknown[0]} that is none of the displayed pictures: give the "
            "folder spots of the scan"
        )
    counted = np.any(counts.valid, axis=1)
    for name in (WHITE, BLACK):
        if name in names and not counted[names.index(name)]:
            raise InputError(
                f"no exposure of {name} was counted: record the run again, or leave "
                "that picture out of it"
            )
    scenes = dict(zip(shown.names, shown.x, strict=True))
    measured = dict(zip(names, reconstruct(run, counts), strict=True))
    spots = [name for name in names if name not in (WHITE, BLACK)]
    fitted = fit_calibration(
        np.array([scenes[name] for name in spots]),
        np.array([measured[name] for name in spots]),
        run.manifest.grid,
        white=measured.get(WHITE),
        black=measured.get(BLACK),
    )
    dark = float(counts.dark_rate[counted].mean())
    dead_time = counts.dead_time if counts.dead_time.seconds else None
    return fitted.model_copy(update={"dark": dark, "dead_time": dead_time})


def _find_spots(pictures: np.ndarray, clear: float = 6.0) -> np.ndarray:
    """Centres (n, 2) of the spots in pictures (n, down, across), NaN if no spot is seen.

    Centres are (across, down) in the unit square.
    """
    from scipy import ndimage

    down, across = np.indices(pictures.shape[1:])
    out = np.full((len(pictures), 2), np.nan)
    for index, picture in enumerate(pictures):
        smooth = ndimage.gaussian_filter(picture - np.median(picture), 1.0, mode="constant")
        # the median deviation, as a standard deviation of Gaussian noise
        noise = 1.4826 * np.median(np.abs(smooth - np.median(smooth)))
        top = np.unravel_index(smooth.argmax(), smooth.shape)
        # A spot is seen if its peak is above `clear` standard deviations of the noise
        if smooth[top] > clear * noise:
            near = np.hypot(down - top[0], across - top[1]) < 2.5
            spot = np.array(ndimage.center_of_mass((picture - np.median(picture)).clip(0) * near))
            out[index] = (spot[::-1] + 0.5) / smooth.shape[::-1]
    return out


def find_homography(
    display: np.ndarray, device: np.ndarray, cells: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Homography (3, 3) of spots (n, 2) in unit squares, and indices of those that agree."""
    from skimage import measure, transform

    seen = np.flatnonzero(np.isfinite(display + device).all(axis=1))
    scale = np.array(cells[::-1], dtype=float)
    pairs = display[seen], device[seen] * scale
    model = None
    if len(seen) >= 4:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "No inliers found")
            model, _ = measure.ransac(
                pairs,
                transform.ProjectiveTransform,
                min_samples=4,
                residual_threshold=1.0,  # cells
                max_trials=500,
                stop_probability=0.9999,
                rng=0,
            )
    # The fit to all that agree has more of them than the four that were drawn had
    agreed = seen[model.residuals(*pairs) < 1.0] if model else seen[:0]
    # Spots on a line agree on many perspectives
    spread = display[agreed] - display[agreed[:1]]
    if model is None or len(agreed) < 4 or np.linalg.matrix_rank(spread, tol=1e-9) < 2:
        raise InputError(
            f"{len(seen)} of {len(device)} spots are seen, or too few agree on one perspective: "
            "four that do not lie on a line are needed; show larger spots, expose longer or aim "
            "the camera"
        )
    matrix = np.diag([*(1 / scale), 1.0]) @ model.params
    return matrix / matrix[2, 2], agreed


def _find_flat(
    white: np.ndarray,
    image_shape: tuple[int, ...],
    homography: np.ndarray,
    blur: tuple[float, float],
) -> np.ndarray:
    """Flat field (down, across) of a picture of uniform white, over its largest value."""
    # A quadratic over the device keeps the noise of single cells out of the view. It follows a
    # lens, but no dust
    view = geometry_matrix(image_shape, white.shape, homography, blur)
    filled = view.sum(axis=1).reshape(white.shape)
    lit = filled > 0.5  # cells that the display fills by more than half
    if not (lit.any() and white[lit].mean() > 0):
        raise InputError(
            "the picture of the white scene is dark, or the camera does not look at the display: "
            "take it again with a longer exposure"
        )
    down, across = (2 * (np.arange(n) + 0.5) / n - 1 for n in white.shape)
    # powers (down, across) of a full quadratic, six terms
    terms = [(i, degree - i) for degree in range(3) for i in range(degree + 1)]
    basis = np.stack([np.outer(down**i, across**j) for i, j in terms])
    weights, *_ = np.linalg.lstsq((basis * filled)[:, lit].T, white[lit], rcond=None)
    flat = np.tensordot(weights, basis, 1)
    return np.asarray((flat / flat[lit].max()).clip(0, 1))


class DisplayedScenes:
    """Displayed scenes, and their images through views (9,): 8 of a homography, and a blur."""

    def __init__(self, scenes: np.ndarray, grid: DmdGrid) -> None:
        self.grid = grid
        self.cells = np.array([grid.down, grid.across])
        self.side = np.sqrt(grid.mirrors) / np.array([grid.height, grid.width])
        shape = np.array(scenes.shape[1:])
        fine = 4  # points of a displayed pixel in each direction that stand for its light
        inside = (np.indices((fine, fine)).reshape(2, -1).T + 0.5) / fine
        self.points: list[np.ndarray] = []
        self.light: list[np.ndarray] = []
        for scene in scenes:
            pixels = np.argwhere(scene > 0)
            points = (pixels[:, None] + inside).reshape(-1, 2) / shape
            self.points.append(points[:, ::-1])
            self.light.append(scene[tuple(pixels.T)].repeat(len(inside)))
        # standard deviation of light spread evenly over a point
        self.spacing = self.cells / (shape * fine * np.sqrt(12))

    def images(self, view: np.ndarray) -> np.ndarray:
        """Pictures (spots, down, across), all of brightness 1."""
        from scipy import special

        matrix = np.append(view[:8], 1).reshape(3, 3)
        width = np.hypot(view[8] * self.side, self.spacing)
        out = np.empty((len(self.points), *self.cells))
        for image, points, light in zip(out, self.points, self.light, strict=True):
            x, y, scale = matrix @ np.stack([*points.T, np.ones(len(points))])
            shares = []  # of each point's light, (points, cells), down and across
            for axis, position in enumerate((y / scale, x / scale)):
                edges = np.arange(self.cells[axis] + 1)
                offsets = edges - (position * self.cells[axis])[:, None]
                shares.append(np.diff(special.ndtr(offsets / width[axis]), axis=1))
            image[:] = (shares[0] * light[:, None]).T @ shares[1]
        return out


def _fit_view(
    spots: DisplayedScenes, pictures: np.ndarray, view: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Least-squares view (9,) and its covariance (9, 9); the brightness of each spot is free."""
    from scipy import optimize

    def misfit(view: np.ndarray) -> np.ndarray:
        images = spots.images(view)
        power = (images**2).sum(axis=(1, 2))
        match = (images * pictures).sum(axis=(1, 2))
        # the least-squares brightness of each spot; negative light does not exist
        brightness = match.clip(0) / np.maximum(power, 1e-12)
        return (pictures - brightness[:, None, None] * images).ravel()

    fit = optimize.least_squares(
        misfit,
        view,
        bounds=([-np.inf] * 8 + [0.0], [np.inf] * 8 + [2.0]),  # blur of up to 2 cells
        x_scale=[0.01] * 8 + [0.1],
        xtol=1e-6,
        ftol=1e-6,
    )
    # Bright cells are noisier: this covariance does not assume equal noise in all cells
    inverse = np.linalg.pinv(fit.jac)
    return fit.x, (inverse * fit.fun**2) @ inverse.T


def _corner_error(spots: DisplayedScenes, view: np.ndarray, covariance: np.ndarray) -> float:
    """Standard error, cells, of a corner of the display on the device: the worst of four."""
    worst = 0.0
    for corner in ((0, 0), (0, 1), (1, 0), (1, 1)):
        point = np.array([*corner, 1.0])
        x, y, scale = np.append(view[:8], 1).reshape(3, 3) @ point
        slopes = np.zeros((2, 8))
        slopes[0, :3] = slopes[1, 3:6] = point / scale
        slopes[:, 6:] = -np.outer([x, y], point[:2]) / scale**2
        slopes *= spots.cells[::-1, None]
        worst = max(worst, float(np.trace(slopes @ covariance[:8, :8] @ slopes.T)))
    return float(np.sqrt(worst))


SCAN_NAMES = ("raster", "hadamard")
"""Scans by name: one cell after another, or Hadamard masks of two frames each."""


def scan_rails(name: str, cells: tuple[int, int], detectors: int = 1) -> DesignRails:
    """Rails of a scan with equal dwells, whose mean scene is uniform white.

    Hadamard masks are cut to size where a side is no power of two.
    """
    from scipy.linalg import hadamard

    down, across = cells
    pixels = down * across
    if not 2 <= pixels <= 4096:
        raise InputError(
            f"a scan of {down} x {across} cells is not allowed: give 2 to 4096 cells, such "
            "as 32x32; a calibration with larger cells serves masks with smaller ones"
        )
    if name == "raster":
        rails = np.eye(pixels)[None] / pixels
    else:
        axes = [hadamard(1 << (side - 1).bit_length())[:, :side] for side in cells]
        masks = np.kron(*axes)
        # the first mask is all ones and has one frame, the others have two
        rails = np.stack([masks > 0, masks < 0]) / (2 * len(masks) - 1)
    detector_map = DetectorMap(count=detectors) if detectors > 1 else None
    return DesignRails(rails, "equal-dwell", cells, float(math.prod(cells)), detectors=detector_map)


def find_gains(white: Path) -> tuple[float, ...]:
    """Efficiency of each detector over their mean, from a counted run of a uniform white scene.

    Each is the detector's counts in all masks, over the light that its cells send.
    """
    run = Recording.read(white)
    counts = run.read_counts().check_photons(white)
    manifest = run.manifest
    # unequal gains are what this run is recorded for
    spoilt = [fault.kind in SPOILING and fault.kind != "gain" for fault in counts.faults]
    if counts.gains or any(spoilt):
        raise InputError(
            "the flat field's light is not what it should be, or it was corrected itself: record "
            "uniform white, and count it without a flat field"
        )
    detectors = manifest.detectors
    if manifest.inputs == 1 or (detectors is not None and detectors.cells is None):
        raise InputError(
            "these patterns do not say which cells each of several detectors sees: leave the flat "
            "field out, or record it with patterns of a design for several detectors"
        )
    rails = run.patterns.rails
    cells = np.zeros(rails.shape[-1], int) if detectors is None else np.array(detectors.cells)
    count = manifest.detector_count
    usable = counts.expand_to_counts(counts.valid)
    signal = counts.signal().sum(axis=(0, 1), where=usable)
    variance = counts.variance.sum(axis=(0, 1), where=usable)
    lit = np.stack([rails[..., cells == label].sum(axis=-1) for label in range(count)], axis=-1)
    # (arms, D): two arms count one rail each, one arm counts all rails
    shape = (manifest.arms, -1, count)
    counted, noise, sent = (values.reshape(shape).sum(axis=1) for values in (signal, variance, lit))
    if not (np.sqrt(noise) < 0.01 * counted).all():
        raise InputError(
            "the flat field does not tell each detector's share to 1.0%: record it longer, or with "
            "more light"
        )
    gains = (counted / sent).ravel()
    return tuple((gains / gains.mean()).tolist())


def reconstruct(run: Recording, counts: Counts) -> np.ndarray:
    """Least-squares pictures (S, *shape) of the scenes of a run, from mean counts less background.

    Of equally good pictures the one of least norm is taken. Scenes without valid exposures are NaN.
    """
    from scipy.linalg import lstsq

    patterns = run.patterns
    stated = run.acquisition.flux
    flux = np.nanmean(counts.flux) if stated is None else stated
    budget = float(flux * counts.exposure_s)
    if not budget > 0:
        raise InputError(
            f"{run.folder} has no light: its all-ON frames are not brighter than the dark"
        )
    valid = np.asarray(counts.valid.any(axis=1))
    weights = counts.valid / np.maximum(counts.valid.sum(axis=1, keepdims=True), 1)
    mean = np.einsum("sr,sr...->s...", weights, counts.signal())[valid]
    if patterns.manifest.detector_axis:
        mean = mean.sum(axis=-1)
    read = counts.lengths_s > 0
    out = np.full((len(valid), patterns.on.shape[1]), np.nan)
    # `cond`: least singular value in use, of the largest; smaller ones amplify noise
    solution = lstsq(patterns.rails[read], mean[:, read].T, cond=1e-3)[0].T
    out[valid] = solution * (patterns.manifest.summed_reflectance / budget)
    return out.reshape(len(valid), *patterns.manifest.image_shape)

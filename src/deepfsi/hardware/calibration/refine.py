"""View of a camera fitted to all pictures of spots at once.

The centre of one spot in a picture is biased where a spot is smaller than a cell, and lost where it
is faint. So each picture is compared with what the view would show of its spot, light averaged over
the cells, and all of them share one homography and one blur; the brightness of each is its own.
Cells weigh by their noise, which grows with the light where a picture is of raster patterns.
"""

from dataclasses import dataclass

import numpy as np
from scipy import optimize, special

from deepfsi.camera.layout import Grid

POINTS = 4
"""Points of a displayed pixel in each direction that stand for its light."""

WIDEST_BLUR_CELLS = 2.0
"""Largest blur that is looked for, cells."""

OUTLIER_CELLS = 0.5
"""Distance beyond which a spot is left out of the fit, cells."""

LEAST_BRIGHTNESS_STD = 5.0
"""A spot is part of the fit where its brightness is this many of its standard errors."""

LEAST_VARIANCE = 1e-3
"""Least variance of a cell, of the largest: a cell without photons is not known exactly."""

STEP_CELLS = 0.02
"""Step of the derivatives by a spot's place, cells."""


@dataclass(frozen=True)
class FittedView:
    """Homography and blur fitted to pictures of spots."""

    matrix: np.ndarray  # (3, 3): Display → device in unit squares
    blur: tuple[float, float]  # standard deviation down and across, in the device's unit square
    used: np.ndarray  # (spots,): Spots that it rests on
    residual: float  # root mean square distance of those from it, cells
    error: float  # standard error of the place of the display's worst corner, cells


class DisplayedScenes:
    """Displayed scenes, and what cells see of them through a view (8 of its homography, blur)."""

    def __init__(self, scenes: np.ndarray, grid: Grid) -> None:
        self.grid = grid
        self.cells = np.array([grid.down, grid.across])
        self.side = np.sqrt(grid.mirrors) / np.array([grid.height, grid.width])
        shape = np.array(scenes.shape[1:])
        inside = (np.indices((POINTS, POINTS)).reshape(2, -1).T + 0.5) / POINTS
        self.points: list[np.ndarray] = []
        self.light: list[np.ndarray] = []
        for scene in scenes:
            pixels = np.argwhere(scene > 0)
            places = (pixels[:, None] + inside).reshape(-1, 2) / shape
            self.points.append(places[:, ::-1])
            self.light.append(scene[tuple(pixels.T)].repeat(len(inside)))
        self.spacing = self.cells / (shape * POINTS * np.sqrt(12))

    def images(self, view: np.ndarray, shift: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
        """Pictures (spots, down, across), all of brightness 1; shifted by cells down and across."""
        matrix = np.append(view[:8], 1).reshape(3, 3)
        width = np.hypot(view[8] * self.side, self.spacing)
        out = np.empty((len(self.points), *self.cells))
        for image, points, light in zip(out, self.points, self.light, strict=True):
            x, y, scale = matrix @ np.stack([*points.T, np.ones(len(points))])
            down, across = (
                np.diff(special.ndtr((np.arange(n + 1) - place[:, None]) / std), axis=1)
                for n, place, std in zip(
                    self.cells,
                    (y / scale * self.cells[0] + shift[0], x / scale * self.cells[1] + shift[1]),
                    width,
                    strict=True,
                )
            )
            image[:] = (down * light[:, None]).T @ across
        return out


def fit_view(
    scenes: np.ndarray, pictures: np.ndarray, grid: Grid, matrix: np.ndarray, agreed: np.ndarray
) -> FittedView:
    """Fit homography and blur to pictures of spots, from a first homography."""
    # scenes (spots, h, w); pictures (spots, down, across); matrix (3, 3); agreed (spots,)
    spots = DisplayedScenes(scenes, grid)
    used, view = agreed, np.append((matrix / matrix[2, 2]).ravel()[:8], 0.3)
    for _ in range(3):
        view, jacobian, noise = _solve(DisplayedScenes(scenes[used], grid), pictures[used], view)
        shifts, bright = _shifts(spots, pictures, view)
        near = bright & (np.hypot(*shifts.T) < OUTLIER_CELLS)
        if near.sum() < 4 or (near == used).all():
            break
        used = near
    across = view[8] * spots.side / spots.cells
    return FittedView(
        matrix=np.append(view[:8], 1).reshape(3, 3),
        blur=(float(across[0]), float(across[1])),
        used=used,
        residual=float(np.sqrt((shifts[used] ** 2).sum(axis=1).mean())),
        error=_corner_error(spots, view, jacobian, noise),
    )


def _solve(
    spots: DisplayedScenes, pictures: np.ndarray, view: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Least-squares view, the Jacobian of its weighted misfit, and the misfit's variance."""
    weight = np.ones_like(pictures)

    def fitted(view: np.ndarray) -> np.ndarray:
        images = spots.images(view)
        power = (weight**2 * images**2).sum(axis=(1, 2))
        match = (weight**2 * images * pictures).sum(axis=(1, 2))
        brightness = np.divide(match, power, out=np.zeros_like(power), where=power > 1e-12)
        return np.asarray(brightness.clip(0)[:, None, None] * images)

    def misfit(view: np.ndarray) -> np.ndarray:
        return (weight * (pictures - fitted(view))).ravel()

    for weighted in (False, True):
        if weighted:
            weight = _weights(pictures, fitted(view))
        found = optimize.least_squares(
            misfit,
            view,
            bounds=([-np.inf] * 8 + [0.0], [np.inf] * 8 + [WIDEST_BLUR_CELLS]),
            x_scale=[0.01] * 8 + [0.1],
            xtol=1e-6,
            ftol=1e-6,
        )
        view = found.x
    free = max(pictures.size - len(view) - len(pictures), 1)
    return view, found.jac, float(2 * found.cost / free)


def _weights(pictures: np.ndarray, model: np.ndarray) -> np.ndarray:
    """One over the noise of each cell: a variance of its own for darkness, and more with light."""
    squares = (pictures - model).ravel() ** 2
    (dark, light), _ = optimize.nnls(np.stack([np.ones(model.size), model.ravel()], 1), squares)
    variance = dark + light * model.ravel()
    most = variance.max()
    if most <= 0:
        return np.ones_like(pictures)
    return np.asarray(1 / np.sqrt(variance / most + LEAST_VARIANCE)).reshape(pictures.shape)


def _shifts(
    spots: DisplayedScenes, pictures: np.ndarray, view: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distance of spots from where the view shows them, cells (spots, 2), and which are bright."""
    # A distance that a picture does not tell, since the spot lies within one cell or is faint, is
    # taken to be small beside `OUTLIER_CELLS`
    centre = spots.images(view)
    slopes = [
        (spots.images(view, step) - spots.images(view, (-step[0], -step[1]))) / (2 * STEP_CELLS)
        for step in ((STEP_CELLS, 0.0), (0.0, STEP_CELLS))
    ]
    shifts, bright = np.zeros((len(pictures), 2)), np.zeros(len(pictures), dtype=bool)
    for k, picture in enumerate(pictures):
        power = (centre[k] ** 2).sum()
        if not (np.isfinite(picture).all() and power > 1e-12):
            continue
        brightness = (centre[k] * picture).sum() / power
        rest = picture - brightness * centre[k]
        variance = (rest**2).mean() + 1e-300
        bright[k] = brightness > LEAST_BRIGHTNESS_STD * np.sqrt(variance / power)
        slope = brightness * np.stack([each[k].ravel() for each in slopes], axis=1)
        prior = variance / OUTLIER_CELLS**2 * np.eye(2)
        shifts[k] = np.linalg.solve(slope.T @ slope + prior, slope.T @ rest.ravel())
    return shifts, bright


def _corner_error(
    spots: DisplayedScenes, view: np.ndarray, jacobian: np.ndarray, noise: float
) -> float:
    """Standard error, cells, of the place on the device of the display's worst corner."""
    spread = np.linalg.pinv(jacobian.T @ jacobian)[:8, :8] * noise
    worst = 0.0
    for corner in ((0, 0), (0, 1), (1, 0), (1, 1)):
        place = np.array([*corner, 1.0])
        x, y, scale = np.append(view[:8], 1).reshape(3, 3) @ place
        slopes = np.zeros((2, 8))
        slopes[0, :3] = slopes[1, 3:6] = place / scale
        slopes[:, 6:] = -np.outer([x, y], place[:2]) / scale**2
        slopes *= spots.cells[::-1, None]
        worst = max(worst, float(np.trace(slopes @ spread @ slopes.T)))
    return float(np.sqrt(worst))

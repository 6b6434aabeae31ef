"""Test of a run: whether the camera sees its scenes as the training did.

A picture that is mirrored, blurred, shifted or mixed with stray light cannot be told from another
scene by one exposure. Over a run it can: the counts behind all masks are then far likelier for the
scenes of the training *seen so* than for those scenes as they are.

The test takes scenes of a class for normal about their mean scene, with one covariance for all
classes (`SceneModel`); their counts behind any masks, with photon noise, are then normal, too. The
evidence for a fault of the view is the ratio of the likelihoods of all counts with and without it,
where the share of each class in the run is learned, scene after scene, from the counts themselves.
The mean of the ratios over the faults exceeds 1 / `FALSE_ALARM` in a sound run, whenever one looks,
with a chance of at most `FALSE_ALARM` (Ville 1939; Shafer and Vovk's test martingales), as far as
the model holds. Each scene must be another one. Where one scene, shown again and again, explains
the counts as well, the fault is named and the run is not refused.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from math import log

import numpy as np

from deepfsi.designfile.misfit import FALSE_ALARM, FEWEST_LEFT_OUT, SceneLight

BRIGHTNESS_FREE = 0.3
"""Standard deviation of the brightness of scenes, relative to the mean, that no test minds."""

GAIN_FREE = 0.03
"""Standard deviation of the efficiency of each detector that no test minds."""

DIM_NOISE = 0.1
"""Variance added to each readout, over their mean count: few photons are far from normal."""

EXPOSURES_AT_ONCE = 256
"""Exposures whose distances from all classes are in memory at a time."""

MOST_AXES = 40
"""Principal axes of the scenes about their classes' means that are kept."""


@dataclass(frozen=True)
class _ViewFault:
    """Fault in how a camera sees scenes."""

    words: str  # "the picture on the device is ..."
    transform: Callable[[np.ndarray], np.ndarray]  # of images (n, h, w), linear in them
    stray: float = 0.0  # even light beside that of the scenes, over their mean light


def view_faults(image_shape: tuple[int, ...], harmless: bool = False) -> Iterator[_ViewFault]:
    """Faults of the view of scenes of a shape; spectra are images of one row.

    Harmless ones are small: a run is refused only if none of these explains its counts.
    """
    from scipy.ndimage import affine_transform, gaussian_filter, rotate, shift

    blurs = (0.5,) if harmless else (1.0, 2.0)  # cells, standard deviation
    strays = (0.2,) if harmless else (0.5, 1.0, 3.0)  # stray light over the scenes' light
    corners = (0.2,) if harmless else (0.4, 0.7)  # light that the corners lose
    tilt = 0.15 if harmless else 0.4  # half of the difference of light of two sides, over the mean
    share = 1 / 40 if harmless else 1 / 16  # shift over the frame's side
    height, width = _rows(image_shape)
    flat = height == 1
    across, down = (
        np.linspace(-1, 1, size) if size > 1 else np.zeros(1) for size in (width, height)
    )
    down = down[:, None]
    radius = (across**2 + down**2) / (1 if flat else 2)
    between = {"order": 1, "mode": "grid-constant"}  # pixels are areas, and black is around them
    sides = {"right": (0, 1), "left": (0, -1)}
    if not flat:
        sides |= {"bottom": (1, 0), "top": (-1, 0)}
    for cells in blurs:
        words = f"blurred by about {cells:g} cells (standard deviation)"
        axes = (2,) if flat else (1, 2)
        blur = partial(gaussian_filter, sigma=cells, mode="constant", axes=axes)
        yield _ViewFault(words, blur)
    for stray in strays:
        words = f"mixed with stray light of about {stray:g} of the scenes'"
        yield _ViewFault(words, lambda x: x, stray)
    for lost in corners:
        light = 1 - lost * radius
        words = f"darker at its corners, to about {1 - lost:g}"
        yield _ViewFault(words, partial(np.multiply, light))
    for side, (dy, dx) in sides.items():
        light = 1 + tilt * (dy * down + dx * across)
        yield _ViewFault(f"lit unevenly, brighter at the {side}", partial(np.multiply, light))
    for side, (dy, dx) in sides.items():
        cells_moved = (0.0, dy * share * height, dx * share * width)
        yield _ViewFault(f"shifted to the {side}", partial(shift, shift=cells_moved, **between))
    if flat:
        return
    for degrees in (-2, 2) if harmless else (-15, -6, 6, 15):
        way = "clockwise" if degrees < 0 else "counter-clockwise"
        words = f"turned by about {abs(degrees)} degrees {way}"
        turned = partial(rotate, angle=degrees, axes=(1, 2), reshape=False, **between)
        yield _ViewFault(words, turned)
    if harmless:
        return
    for top, left in product((0, 1), repeat=2):
        corner = f"{'bottom' if top else 'top'} {'right' if left else 'left'}"
        words = f"smaller by about 1/8, at its {corner} corner"
        offset = (0, 1 / 14 - top * height / 7, 1 / 14 - left * width / 7)
        smaller = partial(affine_transform, matrix=[1, 8 / 7, 8 / 7], offset=offset, **between)
        yield _ViewFault(words, smaller)


def dark_faults(image_shape: tuple[int, ...]) -> Iterator[_ViewFault]:
    """Rows, columns, and places where these meet, without light: an eighth of each side or more."""
    height, width = _rows(image_shape)
    if height * width > 32**2:  # these views would take gigabytes
        return
    rows, columns = (np.array_split(np.arange(n), min(n, 8)) for n in (height, width))
    bands = [(down, np.arange(width)) for down in rows if height > 1]
    bands += [(np.arange(height), across) for across in columns if height > 1]
    for down, across in [*bands, *product(rows, columns)]:
        light = np.ones((height, width))
        light[np.ix_(down, across)] = 0
        place = f"rows {down[0] + 1} to {down[-1] + 1}, columns {across[0] + 1} to {across[-1] + 1}"
        yield _ViewFault(f"dark in its {place}", partial(np.multiply, light))


def orientation_faults(image_shape: tuple[int, ...]) -> Iterator[_ViewFault]:
    """Orientations of the scenes that differ from the training's."""
    height, width = _rows(image_shape)
    yield _ViewFault("mirrored left to right", lambda x: x[..., ::-1])
    if height > 1:
        yield _ViewFault("mirrored top to bottom", lambda x: x[..., ::-1, :])
        yield _ViewFault("turned by 180 degrees", lambda x: x[..., ::-1, ::-1])
    if height == width:
        turned = "turned by {} degrees"
        yield _ViewFault(turned.format(90), lambda x: x[..., ::-1, :].swapaxes(-1, -2))
        yield _ViewFault(turned.format(270), lambda x: x.swapaxes(-1, -2)[..., ::-1, :])
        mirrored = "mirrored at its {} diagonal"
        yield _ViewFault(mirrored.format("falling"), lambda x: x.swapaxes(-1, -2))
        yield _ViewFault(mirrored.format("rising"), lambda x: x[..., ::-1, ::-1].swapaxes(-1, -2))


def _rows(image_shape: tuple[int, ...]) -> tuple[int, int]:
    height, width = (1, *image_shape)[-2:]
    return height, width


@dataclass(frozen=True)
class SceneReadouts:
    """Counts of a scene, or of scenes at one budget, readout by readout."""

    masks: np.ndarray  # (k, N), counts that each pixel of reflectance 1 gives to each readout
    counts: np.ndarray  # (..., k), photons, less the background
    noise: np.ndarray  # (k,), variance beyond that of the scene's own photons
    inputs: np.ndarray  # (k,), detector that counted each

    @classmethod
    def of(
        cls,
        masks: np.ndarray,
        counts: np.ndarray,
        noise: np.ndarray | float,
        cells: np.ndarray | None,
        arms: np.ndarray,
    ) -> "SceneReadouts":
        """Readouts by detectors that see these cells (N,), of each of `masks` (..., N).

        Counts are (s, ..., [D]) of scenes, their noise is of one; `arms` (...) count the masks.
        """
        cells = np.zeros(masks.shape[-1], int) if cells is None else cells
        detectors = np.arange(cells.max() + 1)
        # (D, N): cells of each detector; one detector sees all
        seen = masks[..., None, :] * np.equal.outer(detectors, cells)
        inputs = np.broadcast_to(arms[..., None] * len(detectors) + detectors, seen.shape[:-1])
        return cls(
            masks=seen.reshape(-1, seen.shape[-1]),
            counts=counts.reshape(len(counts), -1),
            noise=np.broadcast_to(np.ravel(noise), inputs.size),
            inputs=inputs.ravel(),
        )

    @classmethod
    def all_on(cls, counts: np.ndarray, gain: float, noise: float, pixels: int) -> "SceneReadouts":
        """Counts (s,) of all detectors in an all-ON frame; `gain` is those of a pixel."""
        one = np.zeros(1, int)
        return cls(np.full((1, pixels), gain), counts[:, None], np.full(1, noise), one)


@dataclass(frozen=True)
class SceneModel:
    """Scenes of the training: the mean of each class, and how scenes lie about it."""

    means: np.ndarray  # (C, N), mean scene of each class, reflectance
    axes: np.ndarray  # (d, N)
    rest: np.ndarray  # (N,), variance of each pixel beyond these
    shares: np.ndarray  # (C,), of each class in the training

    @staticmethod
    def are_enough(sizes: np.ndarray) -> bool:
        """Whether counts can be tested with these numbers (C,) of training scenes of each class."""
        return bool(sizes.min() >= 20 and sizes.sum() >= FEWEST_LEFT_OUT)

    @classmethod
    def fit(cls, x: np.ndarray, labels: np.ndarray) -> "SceneModel":
        """Model of scenes (n, N) of classes (n,), each of which has scenes."""
        sizes = np.bincount(labels)
        means = np.stack([x[labels == k].mean(axis=0, dtype=float) for k in range(len(sizes))])
        residuals = np.asarray(x, float) - means[labels]
        axes = min(MOST_AXES, len(x) // 5)  # five scenes or more for each axis
        return cls.of(means, residuals / np.sqrt(len(x) - len(sizes)), sizes / len(x), axes)

    @classmethod
    def of(
        cls, means: np.ndarray, residuals: np.ndarray, shares: np.ndarray, axes: int = MOST_AXES
    ) -> "SceneModel":
        """Model of class means (C, N), and residuals (n, N) whose squares sum to the covariance."""
        from scipy.linalg import eigh

        count = min(axes, *residuals.shape)
        # the smaller square: both have the same eigenvalues
        wide = residuals.shape[1] > len(residuals)
        square = residuals @ residuals.T if wide else residuals.T @ residuals
        last = len(square) - 1
        values, vectors = eigh(square, subset_by_index=[last + 1 - count, last])
        scaled = vectors.T @ residuals if wide else (vectors * np.sqrt(values.clip(min=0))).T
        rest = ((residuals**2).sum(axis=0) - (scaled**2).sum(axis=0)).clip(min=0)
        return cls(
            means=means.astype(np.float16),
            axes=scaled[::-1].astype(np.float16),
            rest=rest.astype(np.float16),
            shares=shares.astype(np.float16),
        )

    @property
    def mean(self) -> np.ndarray:
        """Mean scene (N,)."""
        shares = np.asarray(self.shares, float)
        return shares / shares.sum() @ np.asarray(self.means, float)

    def misfit(self, rows: SceneReadouts) -> np.ndarray:
        """Squared distance (s,) of counts from those of the nearest class, at any brightness."""
        scenes = [self.means, self.axes, BRIGHTNESS_FREE * self.mean[None]]
        views = np.concatenate(scenes, dtype=float)[None]
        known = views, len(self.means), self.mean, np.asarray(self.rest, float)
        rows = replace(rows, noise=rows.noise + DIM_NOISE * (rows.masks @ self.mean).mean())
        distances = []
        for start in range(0, len(rows.counts), EXPOSURES_AT_ONCE):
            block = replace(rows, counts=rows.counts[start : start + EXPOSURES_AT_ONCE])
            precision, projections, squares = _distances(*known, block)
            factor = np.linalg.inv(np.linalg.cholesky(precision))  # one for all scenes
            solved = projections @ factor.swapaxes(1, 2)
            distances.append((squares - (solved**2).sum(axis=2)).min(axis=1))
        return np.concatenate(distances)

    def light(self, rows: SceneReadouts, usual: np.ndarray) -> SceneLight:
        """Light of scenes in all readouts, over that of the mean scene; `usual` (2,) as there."""
        mask = rows.masks.sum(axis=0)
        expected = mask @ self.mean
        between = (np.asarray(self.means, float) - self.mean) @ mask
        variance = np.asarray(self.shares, float) @ between**2
        variance += ((np.asarray(self.axes, float) @ mask) ** 2).sum() + mask**2 @ self.rest
        noise = np.sqrt(expected + rows.noise.sum())
        return SceneLight(
            share=rows.counts.sum(axis=1) / expected,
            spread=float(np.sqrt(variance) / expected),
            noise=float(noise / expected),
            usual=usual,
        )

    @classmethod
    def restored(cls, arrays: Mapping[str, np.ndarray], pixels: int, classes: int) -> "SceneModel":
        """Model from a file, or `ValueError` if its arrays do not fit these scenes."""
        shapes = {"means": (classes, pixels), "rest": (pixels,), "shares": (classes,)}
        shapes["axes"] = (len(arrays["axes"]), pixels)
        fits = {name: array.shape for name, array in arrays.items()} == shapes
        least = min(arrays["rest"].min(), arrays["shares"].min())
        if not fits or least < 0 or not arrays["means"].any():
            raise ValueError("the model of the scenes is not of these masks")
        return cls(**arrays)


@dataclass(frozen=True)
class ViewResult:
    """Evidence of a run for each fault of the view."""

    scenes: int
    faults: tuple[str, ...]  # "the picture on the device is ..."
    odds: np.ndarray  # (V,), logarithm of the likelihood with each fault, over that without
    alike: float = 0.0  # like `odds`, 0 or more, for one scene shown again and again, seen soundly
    refused_before: bool = False  # whether the run was refused after fewer scenes
    told: int | None = None  # the first faults, of which a run says that they stay possible

    @property
    @np.errstate(under="ignore")
    def evidence(self) -> float:
        """Logarithm of the mean of the likelihood ratios: all faults are as likely."""
        from scipy.special import logsumexp

        return float(logsumexp(self.odds + np.log(1 / len(self.odds))))

    @property
    def named(self) -> bool:
        """Whether a sound run has this evidence with a chance below `FALSE_ALARM`."""
        return self.refused or self.evidence > -log(FALSE_ALARM)

    @property
    def refused(self) -> bool:
        """Whether a single scene, shown again and again, does not explain the counts either."""
        return self.refused_before or self.evidence - self.alike > -log(FALSE_ALARM)

    @property
    def likeliest(self) -> str:
        """The fault that explains the counts best."""
        return self.faults[int(self.odds.argmax())]

    @property
    def refusal(self) -> str:
        """Sentence on the fault, and on what to do."""
        alike = "" if self.refused else ", or all are one and the same"
        return (
            f"over {self.scenes} scenes the counts are as if the picture on the device were "
            f"{self.likeliest}, or the scenes differ from those of the training{alike} (evidence "
            f"10^{self.evidence / np.log(10):.1f}; a sound run reaches {1 / FALSE_ALARM:g} once in "
            f"as many): record the reference target and use `deepfsi camera check`"
        )

    @property
    def open(self) -> dict[str, float]:
        """Faults that this run does not exclude, and from how many scenes on it would; or inf."""
        needed = -log(FALSE_ALARM)
        return {
            words: self.scenes * needed / -odds if odds < 0 else np.inf
            for words, odds in zip(self.faults, self.odds[: self.told].tolist(), strict=False)
            if odds > -needed
        }

    @property
    def remark(self) -> str | None:
        """Sentence on the fault, or on faults that stay possible, if any."""
        if self.named:
            return self.refusal
        possible = self.open
        if not possible:
            return None
        counts = [scenes for scenes in possible.values() if np.isfinite(scenes)]
        enough = f"about {max(counts):.0f} scenes would" if counts else "more light or scenes would"
        first = list(possible)[:3]
        more = f" or {len(possible) - 3} others" if len(possible) > 3 else ""
        return (
            f"{self.scenes} scenes do not exclude that the picture on the device is "
            f"{' or '.join(first)}{more}: {enough}, or a recording of the reference target "
            "(`deepfsi camera check`)"
        )

    def as_dict(self) -> dict[str, object]:
        """JSON types only."""
        return {
            "refused": bool(self.refused),
            "named": bool(self.named),
            "false_alarms": FALSE_ALARM,
            "scenes": self.scenes,
            "evidence": self.evidence,
            "likeliest": self.likeliest,
            "log_odds": dict(zip(self.faults, self.odds.tolist(), strict=True)),
            "open": list(self.open),
        }


class ViewTest:
    """Test of a run, scene after scene."""

    def __init__(self, model: SceneModel, image_shape: tuple[int, ...]) -> None:
        dark = tuple(dark_faults(image_shape))
        faults = (*orientation_faults(image_shape), *view_faults(image_shape), *dark)
        harmless = tuple(view_faults(image_shape, harmless=True))
        means = np.asarray(model.means, float)
        shares = np.asarray(model.shares, float)
        self._shares = shares / shares.sum()
        self._rest = np.asarray(model.rest, float)
        self._mean = model.mean
        self._classes = len(means)
        scenes = np.concatenate([means, np.asarray(model.axes, float)])
        views = [scenes]
        for fault in (*harmless, *faults):
            image = fault.transform(scenes.reshape(len(scenes), *_rows(image_shape)))
            image = image.reshape(scenes.shape)
            lit = image[: self._classes]
            # the light of a run is measured: each view has that of the training
            image = image * (self._mean.sum() / (self._shares @ lit).sum())
            image[: self._classes] += fault.stray * self._mean.mean()
            # The all-ON frames that measure the light see the stray light, too
            views.append(image / (1 + fault.stray))
        # Brightness is evidence for no view
        free = [BRIGHTNESS_FREE * self._shares @ view[None, : self._classes] for view in views]
        self._views = np.stack([np.concatenate(pair) for pair in zip(views, free, strict=True)])
        self._faults = tuple(fault.words for fault in faults)
        self._told = len(faults) - len(dark)
        self._sound = 1 + len(harmless)  # views that pass; the first is the training's
        # Scenes of each class so far, with those that a Dirichlet law of the shares starts from
        count = self._sound + len(self._faults)
        self._class_counts = np.tile(self._shares * self._classes, (count, 1))
        self._log = np.zeros(count)
        self._scenes = 0
        self._refused = False
        # Sums over scenes of the arguments of `_log_densities`, seen as in training
        self._sums = [np.zeros((1, 1)), np.zeros((1, 1)), np.zeros(1)]

    @np.errstate(under="ignore")
    def add(self, rows: SceneReadouts) -> None:
        """Take in the counts of another scene."""
        from scipy.special import logsumexp

        if not (rows.masks @ self._mean > 0).any():
            return
        precision, projections, squares = _distances(
            self._views, self._classes, self._mean, self._rest, rows
        )
        logs = _log_densities(precision, projections, squares)
        class_counts = self._class_counts
        joint = logs + np.log(class_counts / class_counts.sum(axis=1, keepdims=True))
        total = logsumexp(joint, axis=1)
        self._log += total
        # each scene counts for the classes by their probabilities
        self._class_counts = class_counts + np.exp(joint - total[:, None])
        self._scenes += 1
        sums = precision[0] - np.eye(len(precision[0])), projections[0], squares[0]
        self._sums = [before + added for before, added in zip(self._sums, sums, strict=True)]
        self._refused |= self.result.refused

    @property
    def result(self) -> ViewResult:
        """Evidence of the scenes so far."""
        sound = float(self._log[: self._sound].max())
        alike = max(self._all_alike - sound, 0.0)
        odds = self._log[self._sound :] - sound
        return ViewResult(
            scenes=self._scenes,
            faults=self._faults,
            odds=odds,
            alike=alike,
            refused_before=self._refused,
            told=self._told,
        )

    @property
    @np.errstate(under="ignore")
    def _all_alike(self) -> float:
        """Logarithm of the likelihood of all counts if every scene were the same sound one."""
        from scipy.special import logsumexp

        precision, projections, squares = self._sums
        logs = _log_densities(precision + np.eye(len(precision)), projections, squares)
        return float(logsumexp(logs + np.log(self._shares)))


def _distances(
    views: np.ndarray, classes: int, mean: np.ndarray, rest: np.ndarray, rows: SceneReadouts
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Arguments of `_log_densities` for views (V, C + d, N) of C class means and d axes.

    The noise is that of the mean scene (N,). Either one view or one scene is given.
    """
    expected = rows.masks @ mean
    noise = expected + rows.noise + rows.masks**2 @ rest
    lit = expected > 0
    scale = 1 / np.sqrt(noise[lit])
    light = views @ rows.masks[lit].T * scale  # (V, C + axes, k)
    residuals = rows.counts[:, None, lit] * scale - light[:, :classes]
    gains = rows.inputs[lit, None] == np.unique(rows.inputs)
    free = (GAIN_FREE * (expected[lit] * scale)[:, None] * gains).T
    axes = np.concatenate(
        [light[:, classes:], np.broadcast_to(free, (len(light), *free.shape))], axis=1
    )
    precision = np.eye(axes.shape[1]) + axes @ axes.swapaxes(1, 2)
    projections = residuals @ axes.swapaxes(1, 2)
    return precision, projections, (residuals**2).sum(axis=2)


def _log_densities(
    precision: np.ndarray, projections: np.ndarray, squares: np.ndarray
) -> np.ndarray:
    """Logarithms (..., C) of normal densities of counts, by Woodbury's identity.

    The covariance is that of the noise, 1 a readout, and of d axes. Shapes: precision (..., d, d)
    of the axes; projections (..., C, d) of the residuals on them; squared residuals (..., C).
    """
    factor = np.linalg.cholesky(precision)
    solved = np.linalg.solve(factor, projections.swapaxes(-1, -2))
    half = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
    return np.asarray(-(squares - (solved**2).sum(axis=-2)) / 2 - half[..., None])

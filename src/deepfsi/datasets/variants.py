"""Data sets made of another one: under stray light, displaced, or of one class against anomalies.

Of one class, a training knows scenes of the normal class alone. Its anomalies are these scenes
changed: in half of them a piece of another scene is pasted elsewhere (Li et al., *CutPaste*, CVPR
2021), the others are displaced by a smooth random field. The test scenes are real: those of the
normal class, and those of all other classes.
"""

import math
from dataclasses import replace

import numpy as np

from deepfsi.base.errors import InputError, closest_choice
from deepfsi.datasets.dataset import Dataset, Reflectance

ANOMALY = "anomaly"
"""Name of the class of all that is not normal."""

PIECE = 0.25, 0.6
"""Smallest and largest side of a pasted piece, in sides of the scene."""

SMOOTH = 5 / 32
"""Standard deviation of the filter of a displacement, in sides of the scene."""

DISPLACED = 6 / 32
"""Largest displacement of a scene, in its sides."""


def one_class(data: Dataset, normal: str, seed: int = 0) -> Dataset:
    """Data set of one class against anomalies."""
    if not data.classes:
        raise InputError(
            "{name} has values and no classes: leave {normal} out", setting="normal", name=data.name
        )
    if normal not in data.classes:
        raise InputError(
            "{name} has no class {given!r}: {advice}, as {normal}",
            setting="normal",
            name=data.name,
            given=normal,
            advice=closest_choice(normal, data.classes),
        )
    label = data.classes.index(normal)
    rng = np.random.default_rng(seed)
    scenes = data.x_train[data.y_train == label]
    made = anomalies_of(scenes.reshape(-1, *data.image_shape), rng).reshape(scenes.shape)
    x = np.concatenate([scenes, made])
    y = np.repeat([0, 1], len(scenes))
    order = rng.permutation(len(y))
    return replace(
        data,
        name=f"{data.name}, {normal}",
        x_train=x[order],
        y_train=y[order],
        y_test=(data.y_test != label).astype(np.int64),
        classes=(normal, ANOMALY),
        measure="AUC",
        drawn=False,
    )


def anomalies_of(scenes: Reflectance, rng: np.random.Generator) -> Reflectance:
    """Anomalies (n, *shape) of scenes: a piece pasted in half of them, the others displaced."""
    half = len(scenes) // 2
    others = scenes[rng.permutation(len(scenes))]
    return np.stack(
        [
            _pasted(scene, other, rng) if index < half else _distorted(scene, rng)
            for index, (scene, other) in enumerate(zip(scenes, others, strict=True))
        ]
    )


def _pasted(scene: Reflectance, other: Reflectance, rng: np.random.Generator) -> Reflectance:
    """Scene with a piece of another one at another place."""
    shape = np.array(scene.shape)
    size = np.ceil(rng.uniform(*PIECE, scene.ndim) * shape).astype(int)
    there, here = (
        tuple(slice(at, at + side) for at, side in zip(corner, size, strict=True))
        for corner in rng.integers(0, shape - size + 1, (2, scene.ndim))
    )
    pasted = scene.copy()
    pasted[here] = other[there]
    return pasted


def _distorted(scene: Reflectance, rng: np.random.Generator) -> Reflectance:
    """Scene whose parts are moved along a smooth random field."""
    from scipy import ndimage

    points = np.indices(scene.shape, dtype=np.float64)
    sigma = [SMOOTH * side for side in scene.shape]
    for axis, side in enumerate(scene.shape):
        field = ndimage.gaussian_filter(rng.standard_normal(scene.shape), sigma)
        points[axis] += DISPLACED * side * field / np.abs(field).max()
    return ndimage.map_coordinates(scene, points, order=1, mode="nearest")


def ambient(data: Dataset, share: float) -> Dataset:
    """Scenes under stray light, the same on every pixel.

    A feature's mean over scenes is subtracted before it is classified, and stray light changes
    nothing else but its noise: so this is light whose mean is known and subtracted. Every scene is
    dimmed by one factor, so that reflectance stays in [0, 1]. A budget is then of all the light:
    (1 + share) times that of the scene.
    """
    if not (math.isfinite(share) and share >= 0):
        raise InputError(f"ambient light {share!r} is not allowed: give a share, 0 or more")
    stray = share * float(data.x_train.mean(dtype=np.float64))
    x_train, x_test = (
        ((x + stray) / (1 + stray)).astype(np.float32)
        for x in map(np.asarray, (data.x_train, data.x_test))
    )
    words = f"{data.preprocessing}; ambient light of {share:g} times the scenes' mean"
    return replace(data, x_train=x_train, x_test=x_test, preprocessing=words, origin=None)


def jitter(data: Dataset, shift: float, turn: float = 0.0, *, seed: int = 0) -> Dataset:
    """Scenes displaced at random, each by itself, training and test scenes alike."""
    if len(data.image_shape) != 2:
        raise InputError(f"{data.name} has scenes of {data.image_shape}: jitter is for images")
    if not (math.isfinite(shift) and math.isfinite(turn) and min(shift, turn) >= 0):
        raise InputError(f"jitter by {shift!r} pixels and {turn!r}° is not allowed: give 0 or more")
    rng = np.random.default_rng(seed)
    x_train, x_test = (
        _displaced(x.reshape(-1, *data.image_shape), shift, turn, rng)
        for x in map(np.asarray, (data.x_train, data.x_test))
    )
    words = f"{data.preprocessing}; displaced at random by {shift:g} pixels and {turn:g}° (1 σ)"
    return replace(data, x_train=x_train, x_test=x_test, preprocessing=words, origin=None)


def _displaced(
    scenes: Reflectance, shift: float, turn: float, rng: np.random.Generator
) -> Reflectance:
    from scipy import ndimage

    centre = (np.array(scenes.shape[1:]) - 1) / 2
    shifts = rng.normal(0, shift, (len(scenes), 2))
    angles = np.deg2rad(rng.normal(0, turn, len(scenes)))
    moved = np.empty_like(scenes)
    for scene, by, angle, out in zip(scenes, shifts, angles, moved, strict=True):
        cos = math.cos(angle)
        sin = math.sin(angle)
        matrix = np.array([[cos, -sin], [sin, cos]])
        offset = centre - matrix @ (centre + by)
        out[:] = ndimage.affine_transform(scene, matrix, offset, order=1, mode="nearest")
    return moved.reshape(len(scenes), -1)

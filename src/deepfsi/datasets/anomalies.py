"""One class of a data set against anomalies, which are made of its own scenes.

A training knows scenes of the normal class alone. Its anomalies are these scenes changed: in half
of them a piece of another scene is pasted elsewhere (Li et al., *CutPaste*, CVPR 2021), the others
are displaced by a smooth random field. The test scenes are real: those of the normal class, and
those of all other classes.
"""

from dataclasses import replace

import numpy as np

from deepfsi.base import InputError, closest_choice
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
    """Data set of one class against anomalies.

    Parameters
    ----------
    data : Dataset
        With classes.
    normal : str
        Class whose scenes are normal.
    seed : int
        Draws the anomalies of the training part, as many as it has normal scenes.

    Returns
    -------
    Dataset
        Its classes are `normal` and ``"anomaly"``; all test scenes stay.

    Raises
    ------
    InputError
        If there is no such class, or it is the only one, or scenes have values.
    """
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
    own = data.classes.index(normal)
    rng = np.random.default_rng(seed)
    scenes = data.x_train[data.y_train == own]
    made = changed(scenes.reshape(-1, *data.image_shape), rng).reshape(scenes.shape)
    x, y = np.concatenate([scenes, made]), np.repeat([0, 1], len(scenes))
    order = rng.permutation(len(y))
    return replace(
        data,
        name=f"{data.name}, {normal}",
        x_train=x[order],
        y_train=y[order],
        y_test=(data.y_test != own).astype(np.int64),
        classes=(normal, ANOMALY),
        measure="AUC",
        drawn=False,
    )


def changed(scenes: Reflectance, rng: np.random.Generator) -> Reflectance:
    """Anomalies (n, *shape) of scenes: a piece pasted in half of them, the others displaced."""
    half, others = len(scenes) // 2, scenes[rng.permutation(len(scenes))]
    return np.stack(
        [
            _pasted(scene, other, rng) if place < half else _displaced(scene, rng)
            for place, (scene, other) in enumerate(zip(scenes, others, strict=True))
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


def _displaced(scene: Reflectance, rng: np.random.Generator) -> Reflectance:
    """Scene whose parts are moved along a smooth random field."""
    from scipy import ndimage

    places = np.indices(scene.shape, dtype=np.float64)
    for axis, side in enumerate(scene.shape):
        sigma = [SMOOTH * each for each in scene.shape]
        field = ndimage.gaussian_filter(rng.standard_normal(scene.shape), sigma)
        places[axis] += DISPLACED * side * field / np.abs(field).max()
    return ndimage.map_coordinates(scene, places, order=1, mode="nearest")

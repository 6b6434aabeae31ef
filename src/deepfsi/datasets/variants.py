"""Data sets made of another one: under stray light, or displaced."""

import math
from dataclasses import replace

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.datasets.dataset import Dataset, Reflectance


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

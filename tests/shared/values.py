"""Scenes with values: where the light of digits is, and scenes that follow values linearly."""

import numpy as np

from deepfsi import Dataset, from_arrays, load_dataset


def centroids(x: np.ndarray) -> np.ndarray:
    """Row and column (n, 2) of the centre of the light of scenes (n, 64)."""
    places = np.mgrid[:8, :8].reshape(2, -1)
    return (x @ places.T / x.sum(axis=1, keepdims=True)).astype(np.float32)


def placed_digits(scale: float = 1.0, offset: float = 0.0) -> Dataset:
    """Digits without grey background and the centres of their light, perhaps in other units."""
    data = load_dataset("digits", rescale=(0.0, 1.0))
    parts = [(x, offset + scale * centroids(x)) for x in (data.x_train, data.x_test)]
    (x, y), (x_test, y_test) = ((x.reshape(-1, 8, 8), y) for x, y in parts)
    return from_arrays(x, y, x_test, y_test, values=["row", "column"], name="placed digits")


SLOPES = np.random.default_rng(5).normal(size=(2, 16)) * 0.02
"""Reflectance of each pixel of a linear scene per unit of its two values."""

SPREAD = 0.03
"""Standard deviation of each pixel of a linear scene beside its values."""


def linear_scenes(train: int, test: int, seed: int = 0) -> Dataset:
    """Scenes 0.5 + θ · SLOPES + SPREAD ε of normal values θ and normal ε."""
    rng = np.random.default_rng(seed)
    parts = []
    for count in (train, test):
        y = rng.normal(size=(count, 2))
        x = 0.5 + y @ SLOPES + SPREAD * rng.normal(size=(count, 16))
        parts += [x.astype(np.float32), y.astype(np.float32)]
    return from_arrays(*parts, values=["first", "second"], name="linear scenes")

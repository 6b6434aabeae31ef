"""Named designs under several detectors: each detector's part of the device has masks of its own.

A frame of raster lights a pixel of every part, a mask of Hadamard or PCA is a Hadamard or PCA mask
of each part, and so on: what each detector sees is the design of its part, all at once.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.camera.detectors import ONE_DETECTOR, DetectorMap
from deepfsi.datasets.dataset import Dataset
from deepfsi.jobs.designs import DESIGNS


class _Tile(NamedTuple):
    """Pixels of a scene that a detector sees: a rectangle with its shape, any other as a row."""

    pixels: np.ndarray  # (n,): places among those of the scene
    shape: tuple[int, ...]


def _divide_scene(image_shape: tuple[int, ...], detectors: DetectorMap) -> Iterator[_Tile]:
    """Tile of each detector, in their order."""
    labels = detectors.labels
    if labels is None:
        yield _Tile(np.arange(math.prod(image_shape)), image_shape)
        return
    for detector in range(detectors.count):
        pixels = np.flatnonzero(labels == detector)
        box = tuple(int(np.ptp(axis)) + 1 for axis in np.unravel_index(pixels, image_shape))
        yield _Tile(pixels, box if math.prod(box) == len(pixels) else (len(pixels),))


def count_allowed(
    name: str, data: Dataset, detectors: DetectorMap = ONE_DETECTOR
) -> tuple[int, int]:
    """Smallest and largest number of masks that a design can have, that of the largest tile."""
    shapes = {tile.shape for tile in _divide_scene(data.image_shape, detectors)}
    ranges = [DESIGNS[name].counts(shape, len(data.classes)) for shape in shapes]
    return max(low for low, _ in ranges), max(high for _, high in ranges)


def check_count(name: str, masks: int, data: Dataset, detectors: DetectorMap = ONE_DETECTOR) -> int:
    """Return a mask count, or raise `InputError` if the design cannot have it on this data."""
    low, high = count_allowed(name, data, detectors)
    whole = not isinstance(masks, bool) and float(masks).is_integer()
    if not whole or not low <= masks <= high:
        allowed = f"exactly {low}" if low == high else f"a whole number from {low} to {high}"
        many = f" with {detectors.count} detectors" if detectors.count > 1 else ""
        raise InputError(
            f"{masks} masks are not allowed for {name} on {data.name}{many}: give {allowed}"
        )
    return int(masks)


def sensing_matrix(
    name: str, masks: int, data: Dataset, seed: int = 0, detectors: DetectorMap = ONE_DETECTOR
) -> np.ndarray:
    """Sensing matrix (m, N) of a fixed design, float64, signed; each detector sees its tile of it.

    Where a tile can have fewer masks, the others are dark there.
    """
    masks = check_count(name, masks, data, detectors)
    code = DESIGNS[name]
    if code.make is None:
        raise ValueError(f"{name} has no fixed sensing matrix")
    if detectors.count == 1:
        return code.make(data, masks, seed)
    whole = np.zeros((masks, data.pixels))
    for tile in _divide_scene(data.image_shape, detectors):
        scenes = replace(
            data,
            x_train=data.x_train[:, tile.pixels],
            x_test=data.x_test[:, tile.pixels],
            image_shape=tile.shape,
            wavelengths=None,
        )
        low, high = code.counts(tile.shape, len(data.classes))
        count = min(max(masks, low), high)
        whole[:count, tile.pixels] = code.make(scenes, count, seed)
    return np.where(whole > 0, 1 / masks, 0.0) if code.scaled else whole

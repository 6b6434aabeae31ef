"""Named designs under several detectors: each detector's part of the device has masks of its own.

A frame of raster lights a pixel of every part, a mask of Hadamard or PCA is a Hadamard or PCA mask
of each part, and so on: what each detector sees is the design of its part, all at once.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.datasets import Dataset
from deepfsi.jobs import designs as codes
from deepfsi.optics.detection import ONE, Detection

Part = tuple[np.ndarray, tuple[int, ...]]
"""Pixels of a detector's part, and its shape."""


def parts(image_shape: tuple[int, ...], detection: Detection) -> Iterator[Part]:
    """Parts of scenes: a rectangle with its shape, any other as a row of its pixels."""
    if detection.labels is None:
        yield np.arange(int(np.prod(image_shape))), image_shape
        return
    labels = detection.labels.cpu().numpy()
    for detector in range(detection.count):
        own = np.flatnonzero(labels == detector)
        box = tuple(int(np.ptp(axis)) + 1 for axis in np.unravel_index(own, image_shape))
        yield own, box if np.prod(box) == len(own) else (len(own),)


def count_allowed(name: str, data: Dataset, detection: Detection = ONE) -> tuple[int, int]:
    """Smallest and largest number of masks that a design can have, that of the largest part."""
    shapes = {shape for _, shape in parts(data.image_shape, detection)}
    each = [codes.DESIGNS[name].counts(shape, len(data.classes)) for shape in shapes]
    return max(low for low, _ in each), max(high for _, high in each)


def check_count(name: str, masks: int, data: Dataset, detection: Detection = ONE) -> int:
    """Return a mask count, or raise `InputError` if the design cannot have it on this data."""
    low, high = count_allowed(name, data, detection)
    whole = not isinstance(masks, bool) and float(masks).is_integer()
    if not whole or not low <= masks <= high:
        allowed = f"exactly {low}" if low == high else f"a whole number from {low} to {high}"
        many = f" with {detection.count} detectors" if detection.count > 1 else ""
        raise InputError(
            f"{masks} masks are not allowed for {name} on {data.name}{many}: give {allowed}"
        )
    return int(masks)


def sensing_matrix(
    name: str, masks: int, data: Dataset, seed: int = 0, detection: Detection = ONE
) -> np.ndarray:
    """Sensing matrix (m, N) of a fixed design, float64, signed; each detector sees its part of it.

    Where a part can have fewer masks, the others are dark there.
    """
    masks, code = check_count(name, masks, data, detection), codes.DESIGNS[name]
    if code.make is None:
        raise ValueError(f"{name} has no fixed sensing matrix")
    if detection.count == 1:
        return code.make(data, masks, seed)
    whole = np.zeros((masks, data.pixels))
    for own, shape in parts(data.image_shape, detection):
        part = replace(
            data, x_train=data.x_train[:, own], x_test=data.x_test[:, own], image_shape=shape,
            wavelengths=None,
        )  # fmt: skip
        low, high = code.counts(shape, len(data.classes))
        count = min(max(masks, low), high)
        whole[:count, own] = code.make(part, count, seed)
    return np.where(whole > 0, 1 / masks, 0.0) if code.scaled else whole

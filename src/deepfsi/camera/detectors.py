"""Names and maps of detectors on parts of the device (no torch)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deepfsi.base.arrays import read_npy
from deepfsi.base.errors import InputError

Detectors = str | Sequence[int] | np.ndarray
"""ROWSxCOLUMNS, bands of a spectrum as one number, or the detector of each pixel."""


def read_detectors(name: str) -> str | tuple[int, ...]:
    """Detectors of an option or a recipe: a map (N,) of a .npy file, any other name as it is."""
    if not name.lower().endswith(".npy"):
        return name.lower()
    labels = read_npy(Path(name))
    if labels.dtype.kind not in "iu":
        raise InputError(
            f"{name} holds numbers of type {labels.dtype}: give the detector of each pixel as a "
            "whole number, from 0"
        )
    return tuple(labels.ravel().tolist())


def detector_map(detectors: Detectors, image_shape: tuple[int, ...]) -> np.ndarray:
    """Detector (N,) of each pixel, 0 .. D-1, int64."""
    shape = "x".join(map(str, image_shape))
    if isinstance(detectors, str):
        if detectors == "1x1":
            return np.zeros(int(np.prod(image_shape)), dtype=np.int64)
        parts = detectors.lower().split("x")
        whole = all(part.isdecimal() for part in parts) and len(parts) == len(image_shape)
        if not whole or not all(
            1 <= int(n) <= side for n, side in zip(parts, image_shape, strict=True)
        ):
            form = "ROWSxCOLUMNS" if len(image_shape) == 2 else "a number of bands"
            raise InputError(
                f"detectors {detectors!r} do not divide scenes of {shape}: give {form} from "
                f"{'x'.join('1' for _ in image_shape)} to {shape}, or a map of each pixel's "
                "detector, a .npy file"
            )
        labels: np.ndarray = np.zeros((), dtype=np.int64)
        for n, side in zip(map(int, parts), image_shape, strict=True):
            labels = labels[..., None] * n + np.arange(side) * n // side
        return labels.ravel()
    given = np.asarray(detectors)
    pixels = int(np.prod(image_shape))
    if given.dtype.kind not in "iu" or given.size != pixels:
        raise InputError(
            f"a map of detectors of shape {given.shape} and type {given.dtype} does not fit scenes "
            f"of {shape}: give {pixels} whole numbers"
        )
    labels = given.ravel().astype(np.int64)
    found = np.unique(labels)
    if not np.array_equal(found, np.arange(len(found))):
        raise InputError(
            "a map of detectors must number them from 0 without a gap: each sees a pixel or more"
        )
    return labels

"""Parts of a device that the detectors of a virtual camera see."""

from typing import Annotated

import numpy as np
from pydantic import Field

from deepfsi.base.errors import InputError
from deepfsi.hardware.patterns.sequence import Manifest

Parts = tuple[tuple[Annotated[int, Field(ge=0)], ...], ...]
"""Detector of each part of the area of the cells, which rows and their numbers divide evenly."""


def check_parts(parts: Parts | None) -> Parts | None:
    """Parts as they are; `ValueError` unless rows are equally long and no detector is left out."""
    if parts is None:
        return None
    if len({len(row) for row in parts}) != 1 or not parts[0]:
        raise ValueError("the rows of the detectors differ in length")
    detectors = {each for row in parts for each in row}
    if detectors != set(range(len(detectors))):
        raise ValueError("the detectors are not numbered from 0 without a gap")
    return parts


def mirrors_of_detectors(manifest: Manifest, parts: Parts | None) -> list[np.ndarray | slice]:
    """Mirrors of a device (rows x columns in a row) that each detector of an arm sees."""
    # Those of the parts, or of the cells that the manifest names where they are None
    if manifest.detectors is None and parts is None:
        return [slice(None)]
    grid, count = manifest.grid, manifest.detector_count
    if parts is not None:
        labels = np.array(parts)
    elif manifest.detectors is not None and manifest.detectors.cells is not None:
        labels = np.array(manifest.detectors.cells)[grid.pixels]
    else:
        raise InputError(
            f"these patterns are for {count} detectors, and nothing says which part of the device "
            "each sees: give a `camera` with them, such as detectors = [[0, 1], [2, 3]]"
        )
    if labels.max() + 1 != count:
        raise InputError(
            f"the camera has {labels.max() + 1} detectors, and the patterns are for {count}: give "
            "one with as many, or export the patterns for it"
        )
    sides = zip(labels.shape, (grid.down * grid.height, grid.across * grid.width), strict=True)
    places = [np.arange(mirrors) * side // mirrors for side, mirrors in sides]
    of_mirrors = np.full((manifest.device.rows, manifest.device.columns), -1)
    of_mirrors[grid.window] = labels[np.ix_(*places)]
    return [np.flatnonzero(of_mirrors == each) for each in range(count)]


def mirrors_of_cells(manifest: Manifest) -> np.ndarray:
    """Mirrors of a device, in a row, that are of a cell: float32, 1 or 0."""
    out = np.zeros((manifest.device.rows, manifest.device.columns), np.float32)
    out[manifest.grid.window] = 1
    return out.ravel()

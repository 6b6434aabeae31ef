"""Detectors on parts of the device: the detector of each cell of a mask."""

import math
from collections.abc import Sequence
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.models import Amount, Share, StrictModel, WholeNumber

MOST_INPUTS = 64
"""Inputs of a counter at most."""


class DetectorMap(StrictModel):
    """Detectors of a device, or of each of its two arms."""

    count: int = Field(ge=1, le=2**16)  # D, detectors of an arm
    # Detector of each cell (N,), 0 .. D-1; None where that is not known, as before a calibration,
    # and of one detector that sees all
    cells: tuple[WholeNumber, ...] | None = None
    # Share of each detector in the light of each class of the training, (classes, D); None where
    # that is not known
    shares: tuple[tuple[Share, ...], ...] | None = None
    # Standard deviation of a scene's shares about its class's, (D,)
    spread: tuple[Amount, ...] = ()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.cells and {*self.cells} != {*range(self.count)}:
            raise ValueError("number detectors from 0 without a gap: each sees a cell or more")
        if self.shares is not None and {len(self.spread), *map(len, self.shares)} != {self.count}:
            raise ValueError("the light of the classes is of another number of detectors")
        return self

    @classmethod
    def of(cls, setting: str | Sequence[int] | np.ndarray, image_shape: tuple[int, ...]) -> Self:
        """Map on scenes of ROWSxCOLUMNS, a number of bands, or the detector of each pixel."""
        if isinstance(setting, str):
            cells = _divided(setting, image_shape)
        elif np.size(setting) == math.prod(image_shape):
            cells = np.ravel(setting)
        else:
            raise InputError(
                f"a map of {np.size(setting)} detectors does not fit scenes of "
                f"{_text(image_shape)}: give {math.prod(image_shape)} whole numbers"
            )
        count = int(cells.max()) + 1
        with as_input_error():
            return cls(count=count, cells=tuple(cells.tolist()) if count > 1 else None)

    @property
    def labels(self) -> np.ndarray | None:
        """Detector of each cell, int64 (N,); None if one sees all, or before a calibration."""
        return None if self.cells is None else np.array(self.cells, dtype=np.int64)


ONE_DETECTOR = DetectorMap(count=1)
"""One detector that sees all."""


def _divided(name: str, image_shape: tuple[int, ...]) -> np.ndarray:
    """Detector of each pixel (N,), with each side divided as evenly as possible."""
    if name == "1x1":
        return np.zeros(math.prod(image_shape), dtype=np.int64)
    numbers = [int(number) for number in name.split("x")]
    if len(numbers) != len(image_shape) or (np.array(numbers) > image_shape).any():
        form = "ROWSxCOLUMNS" if len(image_shape) == 2 else "a number of bands"
        raise InputError(
            f"detectors {name!r} do not divide scenes of {_text(image_shape)}: give {form} up to "
            f"{_text(image_shape)}, or a map of each pixel's detector, a .npy file"
        )
    labels: np.ndarray = np.zeros((), dtype=np.int64)
    for number, side in zip(numbers, image_shape, strict=True):
        labels = labels[..., None] * number + np.arange(side) * number // side
    return labels.ravel()


def _text(image_shape: tuple[int, ...]) -> str:
    return "x".join(map(str, image_shape))

"""Several detectors on one device: each sees some of the cells, and all see each frame at once."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from deepfsi.base.models import StrictModel

MOST_DETECTORS = 2**16
"""Detectors of an arm at most."""


class Detectors(StrictModel):
    """Detectors of a device, or of each of its two arms."""

    count: int = Field(ge=2, le=MOST_DETECTORS)  # D
    # Detector of each cell, 0 .. D-1; None where that is not known, as before a calibration
    cells: tuple[Annotated[int, Field(ge=0)], ...] | None = None

    # Share of each detector in the light of each class of the training, (classes, D); None where
    # that is not known
    shares: tuple[tuple[Annotated[float, Field(ge=0, le=1)], ...], ...] | None = None
    # Standard deviation of a scene's shares about those of its class, (D,)
    spread: tuple[Annotated[float, Field(ge=0, allow_inf_nan=False)], ...] = ()

    @model_validator(mode="after")
    def _numbered_without_a_gap(self) -> Self:
        found = set(self.cells or ())
        if found and (len(found) != self.count or max(found) != self.count - 1):
            raise ValueError("the detectors of the cells are not numbered from 0 without a gap")
        if self.shares is not None and {len(self.spread), *map(len, self.shares)} != {self.count}:
            raise ValueError("the light of the classes is of another number of detectors")
        return self

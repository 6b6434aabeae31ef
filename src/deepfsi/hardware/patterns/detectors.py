"""Several detectors on one device: each sees some of the cells, and all see each frame at once."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from deepfsi.frozen import Frozen


class Detectors(Frozen):
    """Detectors of a device, or of each of its two arms."""

    count: int = Field(ge=2)  # D, 2 or more
    # Detector of each cell, 0 .. D-1; None where that is not known, as before a calibration
    cells: tuple[Annotated[int, Field(ge=0)], ...] | None = None

    @model_validator(mode="after")
    def _numbered_without_a_gap(self) -> Self:
        if self.cells is not None and set(self.cells) != set(range(self.count)):
            raise ValueError("the detectors of the cells are not numbered from 0 without a gap")
        return self

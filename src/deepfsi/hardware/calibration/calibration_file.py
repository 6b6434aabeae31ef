"""Calibration of a camera and its display, and its file calibration.json."""

from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from deepfsi.errors import InputError, as_input_error
from deepfsi.files import write_atomically

FILE = "calibration.json"
"""Name of the file in its folder."""

Number = Annotated[float, Field(allow_inf_nan=False)]
"""Finite number."""

Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
"""Number from 0 to 1."""

Rate = Annotated[float, Field(ge=0, allow_inf_nan=False)]
"""Finite number from 0 on."""

Row = tuple[Number, Number, Number]
"""Row of a homography."""


class Calibration(BaseModel):
    """View of one display through one camera, and the counts that come from neither.

    Attributes
    ----------
    homography : 3 x 3 numbers
        Display → device, unit squares, (across, down, 1).
    residual : float
        Root mean square distance of the spots from it, cells.
    spots, shown : int
        Spots that it rests on, and spots that were shown.
    blur : tuple of float
        Standard deviation of a Gaussian, down and across, in the device's unit square.
    flat : rows of numbers, shape (down, across)
        Light of each cell relative to the brightest, for a uniform scene that fills the view.
    dark : float
        Counts/s with all mirrors OFF and the display black.
    ambient : float
        Counts/s that all mirrors ON add to it, the display black.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: Literal[1] = 1
    deepfsi: str = version("deepfsi")
    homography: tuple[Row, Row, Row]
    residual: Rate
    spots: int = Field(ge=4)
    shown: int = Field(ge=4)
    blur: tuple[Share, Share] = (0.0, 0.0)
    flat: tuple[tuple[Share, ...], ...] = Field(((1.0,),), min_length=1)
    dark: Rate = 0.0
    ambient: Rate = 0.0

    @model_validator(mode="after")
    def _whole(self) -> "Calibration":
        if len({len(row) for row in self.flat}) != 1 or not self.flat[0]:
            raise ValueError("the rows of the flat field differ in length")
        if not any(map(any, self.flat)):
            raise ValueError("the flat field is dark everywhere")
        if abs(np.linalg.det(np.array(self.homography))) < 1e-9:
            raise ValueError("the homography cannot be inverted")
        return self


def save_calibration(calibration: Calibration, folder: Path) -> Path:
    """Write `calibration.json` into a folder, which is made if need be."""
    return write_atomically(folder / FILE, calibration.model_dump_json(indent=1).encode())


def load_calibration(folder: Path) -> Calibration:
    """Read `calibration.json` of a folder.

    Raises
    ------
    InputError
        If it is missing or damaged.
    """
    path = Path(folder) / FILE
    try:
        with as_input_error(f"'{path}'", "calibrate the camera again"):
            return Calibration.model_validate_json(path.read_bytes())
    except OSError as error:
        raise InputError(
            f"no calibration at '{path}' ({error.strerror}): calibrate the camera first"
        ) from None

"""The file calibration.json: a camera's view of a display, beside the recordings made with it.

Places on the display and on the device are (across, down) in a *unit square* each: the displayed
image, and the area of the device that the cells of a mask fill. So a calibration made with a few
large cells serves masks with many small ones.
"""

from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from deepfsi.base import StrictModel, as_input_error, read_text, write_atomically
from deepfsi.camera import DeadTime

LEAST_SPOTS = 16
"""Spots that a calibration should rest on, or all that were shown."""

LARGEST_RESIDUAL_CELLS = 0.25
"""Distance of the spots from the fit above which a calibration is doubted, cells."""

LARGEST_ERROR_CELLS = 0.1
"""Standard error of the view above which a calibration is doubted, cells."""

LARGEST_FILE = 2**26
"""Bytes of a calibration's file at most."""

Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
"""Number from 0 to 1."""

Rate = Annotated[float, Field(ge=0, allow_inf_nan=False)]
"""Finite number from 0 on."""

Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
"""Row of a homography."""


class Calibration(StrictModel):
    """View of one display through one camera, and the counts that come from neither."""

    schema_version: Literal[1] = 1
    deepfsi: str = version("deepfsi")  # Version of the package that wrote it
    homography: tuple[Row, Row, Row]  # Display → device, unit squares, (across, down, 1)
    residual: Rate  # Root mean square distance of the spots from it, cells
    error: Rate  # Standard error of the place of the display's worst corner, cells
    spots: int = Field(ge=4)  # Spots that it rests on
    shown: int = Field(ge=4)  # Spots that were shown
    # Standard deviation of a Gaussian, down and across, in the device's unit square
    blur: tuple[Share, Share] = (0.0, 0.0)
    # (down, across): Light of each cell relative to the brightest, for a uniform scene that fills
    # the view
    flat: tuple[tuple[Share, ...], ...] = Field(((1.0,),), min_length=1)
    dark: Rate = 0.0  # Counts/s with all mirrors OFF and the display black
    ambient: Rate = 0.0  # Counts/s that all mirrors ON add to it, the display black
    dead_time: DeadTime | None = None  # Of the counter, for which the run of spots was corrected

    @model_validator(mode="after")
    def _whole(self) -> "Calibration":
        if len({len(row) for row in self.flat}) != 1 or not self.flat[0]:
            raise ValueError("the rows of the flat field differ in length")
        if not any(map(any, self.flat)):
            raise ValueError("the flat field is dark everywhere")
        if abs(np.linalg.det(np.array(self.homography))) < 1e-9:
            raise ValueError("the homography cannot be inverted")
        return self

    @property
    def doubts(self) -> list[str]:
        """Why not to trust it, one line each; none where all is well."""
        said = []
        if self.spots < min(LEAST_SPOTS, self.shown):
            said.append(
                f"only {self.spots} of {self.shown} spots are seen, and {LEAST_SPOTS} or more are "
                "wanted: expose longer, show larger spots (--side) or aim the camera"
            )
        if self.residual > LARGEST_RESIDUAL_CELLS:
            said.append(
                f"the spots lie {self.residual:.2f} cells from one perspective, and up to "
                f"{LARGEST_RESIDUAL_CELLS:g} are well: the lens bends lines, something moved, or "
                "there is too little light"
            )
        if self.error > LARGEST_ERROR_CELLS:
            said.append(
                f"the view is known to {self.error:.2f} cells, and {LARGEST_ERROR_CELLS:g} are "
                f"wanted: give {(self.error / LARGEST_ERROR_CELLS) ** 2:.2g} times the light"
            )
        return said


def save_calibration(calibration: Calibration, folder: Path) -> Path:
    """Write `calibration.json` into a folder, which is made if need be."""
    return write_atomically(
        folder / "calibration.json", calibration.model_dump_json(indent=1).encode()
    )


def load_calibration(folder: Path) -> Calibration:
    """Read `calibration.json` of a folder."""
    path = Path(folder) / "calibration.json"
    content = read_text(path, LARGEST_FILE, "calibrate the camera")
    with as_input_error(f"'{path}'", "calibrate the camera again", content):
        return Calibration.model_validate_json(content)

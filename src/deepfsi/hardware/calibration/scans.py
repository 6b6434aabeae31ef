"""Patterns that take pictures of scenes for a calibration, without a trained design."""

import math
from typing import Literal, get_args

import numpy as np
from scipy.linalg import hadamard

from deepfsi.base.errors import InputError, check_known
from deepfsi.hardware.patterns.detectors import Detectors
from deepfsi.hardware.patterns.folder import DesignRails

Scan = Literal["raster", "hadamard"]
"""Patterns of a scan: one cell after another, or Hadamard masks of two frames each."""

SCANS = get_args(Scan)
"""Names of the scans."""

MOST_CELLS = 64 * 64
"""Cells of a scan at most: a calibration with larger cells serves masks with smaller ones."""


def scan_rails(name: str, cells: tuple[int, int], detectors: int = 1) -> DesignRails:
    """Rails of a scan with equal dwells; its mean scene is one of uniform white."""
    # Hadamard masks of sides that are no power of two are those of the next larger one, cut to size
    check_known("scan", name, SCANS)
    down, across = cells
    pixels = down * across
    if not 2 <= pixels <= MOST_CELLS:
        raise InputError(
            f"a scan of {down} x {across} cells is not allowed: give 2 to {MOST_CELLS} cells, such "
            "as 32x32; a calibration with larger cells serves masks with smaller ones"
        )
    if name == "raster":
        rails = np.eye(pixels)[None] / pixels
    else:
        axes = [hadamard(1 << (side - 1).bit_length())[:, :side] for side in cells]
        masks = np.kron(*axes)
        rails = np.stack([masks > 0, masks < 0]) / (2 * len(masks) - 1)
    several = Detectors(count=detectors) if detectors > 1 else None
    return DesignRails(rails, "equal-dwell", cells, float(math.prod(cells)), detectors=several)

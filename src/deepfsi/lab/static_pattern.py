"""The static pattern of a design as a photomask's file."""

import os
from pathlib import Path

import numpy as np

from deepfsi.base import InputError, check_ending, write_atomically
from deepfsi.designfile import DesignFile, damaged_design
from deepfsi.hardware.patterns.photomask import as_png, as_svg

ENDS = (".svg", ".png")
"""Ends of the names of files of a photomask."""

LARGEST_UM = 1e5
"""Largest pixel of a photomask, micrometres: a hand's width."""


def read_pattern(file: str | os.PathLike[str]) -> np.ndarray:
    """Pattern (H, P) of a design file, dark 0 to open 1, that scenes pass.

    Raises
    ------
    InputError
        If the file is no design, or one of another exposure.
    """
    design = DesignFile.read(file)
    if design.mask_header.exposure.kind != "passing":
        raise InputError(
            f"{file} has masks that a device shows one after the other, and a photomask is one "
            "pattern that scenes pass: learn one with `bins`, or use `deepfsi dmd export`"
        )
    pattern = design.arrays.get("exposure.pattern", np.zeros(0))
    if pattern.ndim != 2 or not ((pattern >= 0) & (pattern <= 1)).all():
        raise damaged_design(file)
    return pattern


def write_photomask(
    file: str | os.PathLike[str], out: str | os.PathLike[str], pixel_um: float
) -> np.ndarray:
    """Write the pattern of a design for a photomask, and return it.

    Parameters
    ----------
    file : str or path
        Design file of scenes that pass a pattern.
    out : str or path
        ``.svg``: polygons of what is open, binary patterns alone. ``.png``: a picture.
    pixel_um : float
        Side of a pixel on the mask, micrometres: a scene's pixel there, times nothing else.

    Returns
    -------
    array, shape (H, P)

    Raises
    ------
    InputError
        If the design has no such pattern, or a grey one for polygons; then nothing is written.
    """
    check_ending(out, ENDS)
    if not 0 < pixel_um <= LARGEST_UM:
        raise InputError(
            f"a pixel of {pixel_um:g} µm is not allowed: give above 0 and up to {LARGEST_UM:g}"
        )
    pattern = read_pattern(file)
    rows, columns = pattern.shape
    about = (
        f"{rows} x {columns} pixels of {pixel_um:g} um, {rows * pixel_um:g} x "
        f"{columns * pixel_um:g} um; open is {'filled' if str(out).endswith('.svg') else 'white'}; "
        "the image of a scene, which is not mirrored, passes from left to right"
    )
    write = as_svg if Path(out).suffix == ".svg" else as_png
    write_atomically(out, write(pattern, pixel_um, about))
    return pattern

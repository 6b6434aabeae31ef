"""The static pattern of a design as a photomask's file: polygons of what is open, in micrometres.

Open pixels are rectangles, merged along rows and then along columns.
"""

import os
from typing import NamedTuple

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.files import check_ending, write_atomically
from deepfsi.designfile.design_file import DesignFile, damaged_design
from deepfsi_flow.settings import PassingEntry


class _OpenRectangle(NamedTuple):
    """Open pixels, from the first row and column to before the last."""

    top: int
    left: int
    bottom: int
    right: int


def _rectangles(pattern: np.ndarray) -> list[_OpenRectangle]:
    """Rectangles of the open pixels of a pattern (H, P) of 0 and 1, each pixel in one of them."""
    # runs of a row that the row above has, too, lengthen its rectangle
    done: list[_OpenRectangle] = []
    going: dict[tuple[int, int], int] = {}
    for row, line in enumerate(pattern):
        ends = np.flatnonzero(np.diff(line, prepend=0, append=0)).reshape(-1, 2).tolist()
        runs = {(left, right) for left, right in ends}
        closed = [run for run in going if run not in runs]
        done += [_OpenRectangle(going.pop(run), run[0], row, run[1]) for run in closed]
        going |= {run: row for run in sorted(runs) if run not in going}
    done += [_OpenRectangle(top, left, len(pattern), right) for (left, right), top in going.items()]
    return sorted(done)


def as_svg(pattern: np.ndarray, pixel_um: float, about: str) -> bytes:
    """SVG of a pattern (H, P) of 0 and 1, a unit a micrometre, whose polygons are open."""
    if not np.isin(pattern, (0, 1)).all():
        raise InputError(
            "polygons are open or dark, and this pattern has grey levels: learn it with `levels=2`"
        )
    height, width = (side * pixel_um for side in pattern.shape)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width / 1e3:.10g}mm" '
        f'height="{height / 1e3:.10g}mm" viewBox="0 0 {width:.10g} {height:.10g}">',
        f"<desc>{about}</desc>",
    ]
    for rectangle in _rectangles(pattern):
        top, left, bottom, right = (f"{side * pixel_um:.10g}" for side in rectangle)
        corners = f"{left},{top} {right},{top} {right},{bottom} {left},{bottom}"
        lines.append(f'<polygon points="{corners}"/>')
    return "\n".join([*lines, "</svg>", ""]).encode()


def _read_static_pattern(file: str | os.PathLike[str]) -> np.ndarray:
    """Pattern (H, P) of a design file, dark 0 to open 1, that scenes pass."""
    design = DesignFile.read(file)
    entry: object = design.mask_header.exposure
    if not isinstance(entry, PassingEntry):
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
    """Write the pattern of a design for a photomask, and return it."""
    check_ending(out, (".svg",))
    if not 0 < pixel_um <= 1e5:  # a hand's width
        raise InputError(
            f"a pixel of {pixel_um:g} µm is not allowed: give above 0 and up to 100000"
        )
    pattern = _read_static_pattern(file)
    rows, columns = pattern.shape
    about = (
        f"{rows} x {columns} pixels of {pixel_um:g} um, {rows * pixel_um:g} x "
        f"{columns * pixel_um:g} um; open is filled; the image of a scene, which is not mirrored, "
        "passes from left to right"
    )
    write_atomically(out, as_svg(pattern, pixel_um, about))
    return pattern

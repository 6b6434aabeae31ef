"""Cells of a mask on the mirrors of a device.

On a diamond lattice mirrors are squares that stand on a corner: a row is half a diagonal below the
one above it, and odd rows lie half a diagonal to the right. A cell is then a number of columns and
of pairs of rows: the mirrors with centres in a rectangle as wide as its columns. So all cells have
mirrors at the same places.
"""

import math
import re
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import AfterValidator

from deepfsi.base.errors import InputError
from deepfsi.base.models import StrictModel
from deepfsi.camera.device import Device

if TYPE_CHECKING:
    import numpy as np


def _region(text: str) -> str:
    if not re.fullmatch(r"[1-9]\d{0,4}x[1-9]\d{0,4}(\+\d{1,5}\+\d{1,5})?", text):
        raise ValueError(
            "give COLUMNSxROWS of mirrors, in the middle, or COLUMNSxROWS+LEFT+TOP, such as "
            "768x768 or 768x768+256+0"
        )
    return text


Region = Annotated[str, AfterValidator(_region)]
"""Part of a device: COLUMNSxROWS of mirrors, in its middle, or COLUMNSxROWS+LEFT+TOP."""


class DmdLayout(StrictModel):
    """Place of the cells of masks on a device."""

    region: Region | None = None  # that holds the cells; None for the whole device
    stretch: bool = False  # True where cells fill the region, and need not be square
    flip: bool = False  # left and right of the masks exchanged, before they are turned
    rotate: Literal[0, 90, 180, 270] = 0  # by how many degrees masks are turned, clockwise
    invert: bool = False  # True where a mirror that sends light to the detector is a 0 in the files

    @property
    def orientation(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Matrix from (across, down) of a mask to (across, down) of the device, about the middle.

        Of whole numbers: a rotation by quarter turns, after a flip.
        """
        cos, sin = {0: (1, 0), 90: (0, 1), 180: (-1, 0), 270: (0, -1)}[self.rotate]
        side = -1 if self.flip else 1
        return (cos * side, -sin), (sin * side, cos)

    def orientations(self) -> "tuple[DmdLayout, ...]":
        """The layout in each of the eight orientations, the exported one first."""
        return tuple(
            self.model_copy(update={"flip": flip, "rotate": turn})
            for flip in (False, True)
            for turn in (0, 90, 180, 270)
        )


USUAL_LAYOUT = DmdLayout()
"""Square cells in the middle, neither flipped nor turned."""


@dataclass(frozen=True)
class DmdGrid:
    """Cells of a mask on a device: as large as fit, centred; mirrors beyond them are OFF."""

    down: int
    across: int
    height: int
    width: int
    top: int
    left: int
    diamond: bool = False  # True where odd rows lie half a column to the right
    layout: DmdLayout = USUAL_LAYOUT  # place and orientation of the cells, as they were asked for

    @property
    def mirrors(self) -> int:
        """K, mirrors of a cell."""
        return self.height * self.width

    @property
    def aspect(self) -> float:
        """Width of a cell over its height."""
        return (2 if self.diamond else 1) * self.width / self.height

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns that all cells take on the device."""
        return (
            slice(self.top, self.top + self.down * self.height),
            slice(self.left, self.left + self.across * self.width),
        )

    @property
    def lattice_shape(self) -> tuple[int, int]:
        """Rows and columns of the square lattice that holds the mirrors' centres.

        For a diamond lattice its points are half a diagonal apart, and every second has a mirror.
        """
        columns = self.across * self.width
        return self.down * self.height, 2 * columns if self.diamond else columns

    def at_mirrors(self, values: "np.ndarray") -> "np.ndarray":
        """Values at the mirrors, from values on `lattice_shape`."""
        if not self.diamond:
            return values
        out = values[:, ::2].copy()
        out[1::2] = values[1::2, 1::2]
        return out

    @cached_property
    def pixels(self) -> "np.ndarray":
        """Pixel of a mask that each cell of the device shows, int (down, across)."""
        import numpy as np

        turned = self.layout.rotate in (90, 270)
        shape = (self.across, self.down) if turned else (self.down, self.across)
        pixels = np.arange(math.prod(shape)).reshape(shape)
        if self.layout.flip:
            pixels = pixels[:, ::-1]
        return np.rot90(pixels, -self.layout.rotate // 90)


def find_grid(
    device: Device, image_shape: tuple[int, ...], layout: DmdLayout = USUAL_LAYOUT
) -> DmdGrid:
    """Grid of a mask's cells; a spectrum's mask lies across the device."""
    # Cells are square unless the layout stretches them, or the mask has one axis: a spectrum's are
    # as tall as the region
    columns, rows, left, top = _find_region(device, layout.region)
    down, across = image_shape if len(image_shape) == 2 else (1, *image_shape)
    if layout.rotate in (90, 270):
        down, across = across, down
    diamond = device.lattice == "diamond"
    together = 2 if diamond else 1  # rows that are as high as a column is wide
    height = rows // (down * together) * together
    width = columns // across
    if not (height and width):
        where = device.name if layout.region is None else f"the region {layout.region}"
        raise InputError(
            f"{down} x {across} cells do not fit {where} with {rows} x {columns} mirrors: use a "
            "larger device or region, or fewer pixels"
        )
    if len(image_shape) == 2 and not layout.stretch:
        width = min(width, height // together)
        height = width * together
    top += (rows - down * height) // 2
    left += (columns - across * width) // 2
    return DmdGrid(
        down=down,
        across=across,
        height=height,
        width=width,
        top=top - top % together,  # an even row: only odd ones lie half a column to the right
        left=left,
        diamond=diamond,
        layout=layout,
    )


def _find_region(device: Device, region: Region | None) -> tuple[int, int, int, int]:
    """Columns and rows of a region, and its left and top; None is the whole device."""
    if region is None:
        return device.columns, device.rows, 0, 0
    columns, rows, *first = map(int, re.findall(r"\d+", region))
    left, top = first or ((device.columns - columns) // 2, (device.rows - rows) // 2)
    if min(left, top) < 0 or left + columns > device.columns or top + rows > device.rows:
        raise InputError(
            f"the region {region} does not lie on {device.name} with {device.columns} x "
            f"{device.rows} mirrors: give COLUMNSxROWS, or COLUMNSxROWS+LEFT+TOP, that do"
        )
    return columns, rows, left, top

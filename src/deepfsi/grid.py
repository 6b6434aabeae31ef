"""Cells of a mask on the mirrors of a device.

On a diamond lattice mirrors are squares that stand on a corner: a row is half a diagonal below the
one above it, and odd rows lie half a diagonal to the right. A cell is then as many columns and
whole pairs of rows: its mirrors are those whose centres lie in a rectangle that is as wide as its
columns, and all cells have mirrors at the same places in theirs.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from deepfsi.devices import Device
from deepfsi.errors import InputError

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True)
class Grid:
    """Cells of a mask on a device: as large as fit, centred; mirrors beyond them are OFF."""

    down: int  # cells
    across: int
    height: int  # rows and columns of mirrors of a cell
    width: int
    top: int  # rows and columns of mirrors before the first cell
    left: int
    diamond: bool = False  # true where odd rows lie half a column to the right

    @property
    def mirrors(self) -> int:
        """K, mirrors of a cell."""
        return self.height * self.width

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the mirrors of all cells, to index those of a device."""
        return (
            slice(self.top, self.top + self.down * self.height),
            slice(self.left, self.left + self.across * self.width),
        )

    @property
    def lattice_shape(self) -> tuple[int, int]:
        """Rows and columns of the square lattice on which the centres of all mirrors lie.

        On a diamond lattice every second of its places has a mirror; they are half a diagonal
        apart.
        """
        columns = self.across * self.width
        return self.down * self.height, 2 * columns if self.diamond else columns

    def at_mirrors(self, values: "np.ndarray") -> "np.ndarray":
        """Values at the mirrors of all cells, of those on `lattice_shape`."""
        if not self.diamond:
            return values
        out = values[:, ::2].copy()
        out[1::2] = values[1::2, 1::2]
        return out


def find_grid(device: Device, image_shape: tuple[int, ...]) -> Grid:
    """Grid of a mask's cells; a mask of one axis (a spectrum) lies across the device."""
    if len(image_shape) not in (1, 2) or min(image_shape) < 1:
        raise InputError(f"masks of shape {image_shape} cannot be shown: give 1 or 2 axes of cells")
    down, across = image_shape if len(image_shape) == 2 else (1, *image_shape)
    diamond = device.lattice == "diamond"
    together = 2 if diamond else 1  # rows that differ in where they lie
    height, width = device.rows // (down * together) * together, device.columns // across
    if not (height and width):
        raise InputError(
            f"{down} x {across} cells do not fit {device.name} with {device.rows} x "
            f"{device.columns} mirrors: use a larger device or fewer pixels"
        )
    top, left = (device.rows - down * height) // 2, (device.columns - across * width) // 2
    return Grid(down, across, height, width, top - top % together, left, diamond)

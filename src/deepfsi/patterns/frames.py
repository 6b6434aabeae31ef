"""Frames: which mirrors of each cell are ON, their packed bits, and the files that hold them.

A cell's grey level is the number `k` of its `K` mirrors that are ON: the first k of a fixed order
in which every beginning is spread evenly over the cell, so that k/K of the light is taken even
where a scene varies within a cell.

Bits are packed along rows, the leftmost mirror in the highest bit of a byte, ON as 1 unless the
layout inverts them; each row begins a new byte.

Files of frames are for other programs: they are written and never read, since frames are made from
the numbers of mirrors ON. A further format is a class with the methods of `_Bitmaps`, and a line in
`FRAME_FORMATS`:

npy    frames.npy, uint8 (frames, rows, bytes of a row)
raw    frames.bin, the same bytes without the header, top row first
bmp    frames/0000.bmp ..., one bit a pixel, ON white
planes images/0000.bmp ..., 24 bits a pixel: each bit of a pixel is a mirror of another frame
"""

import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from deepfsi.base.arrays import npy_header
from deepfsi.camera.device import Device
from deepfsi.camera.layout import DmdGrid

if TYPE_CHECKING:
    from PIL.Image import Image


def make_frames(on: Iterable[np.ndarray], device: Device, grid: DmdGrid) -> Iterator[np.ndarray]:
    """Make packed frames of mirrors ON in each cell (N,), one at a time."""
    order = order_mirrors(grid.height, grid.width)[None, :, None, :]
    for counts in on:
        # the first `counts` mirrors in the order of a cell are ON
        yield _pack(order < counts[grid.pixels][:, None, :, None], device, grid)


def make_frame(on: np.ndarray, device: Device, grid: DmdGrid) -> np.ndarray:
    """Make the packed frame of cells (N,), bool: all mirrors of a cell are ON, or none."""
    sides = grid.down, grid.height, grid.across, grid.width
    return _pack(np.broadcast_to(on[grid.pixels][:, None, :, None], sides), device, grid)


def _pack(lit: np.ndarray, device: Device, grid: DmdGrid) -> np.ndarray:
    """Packed frame of mirrors (down, height, across, width), inverted if the layout says so."""
    mirrors = np.zeros((device.rows, device.columns), dtype=np.bool_)
    mirrors[grid.window] = lit.reshape(grid.down * grid.height, grid.across * grid.width)
    return np.packbits(mirrors ^ grid.layout.invert, axis=1)


def unpack(frame: np.ndarray, device: Device) -> np.ndarray:
    """Mirrors, bool (rows, columns), of a packed frame (rows, bytes of a row): True for a 1."""
    return np.unpackbits(frame, axis=1, count=device.columns).view(np.bool_)


@lru_cache(maxsize=4)
def order_mirrors(height: int, width: int) -> np.ndarray:
    """Rank (height, width), 0 to height · width - 1, in which grey levels switch mirrors ON.

    The array is read only.
    """
    # Kernel herding: the next mirror brings the mean of a repelling potential over the chosen
    # mirrors closest to its mean over the cell, so that every beginning of the order represents
    # the cell. In a very large cell blocks of mirrors are chosen, each as often as it has mirrors,
    # which then follow an order of their own
    rows = height
    columns = width
    # Most mirrors of a cell that are put in order one by one: the time grows with the square
    while rows * columns > 2**12:
        if rows > columns:
            rows = -(-rows // 2)
        else:
            columns = -(-columns // 2)
    down = np.arange(height) * rows // height
    across = np.arange(width) * columns // width
    block = np.add.outer(down * columns, across).ravel()
    chosen = _herd(np.bincount(down), np.bincount(across))
    order = np.empty(height * width, dtype=np.uint32)
    order[np.lexsort((_inside(down, across), block))] = np.argsort(chosen, kind="stable")
    order.flags.writeable = False
    return order.reshape(height, width)


def _inside(down: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Order of each mirror in its block; neighbouring blocks are mirror images."""
    axes = []
    for axis in (down, across):
        most = np.bincount(axis).max()
        offsets = np.arange(len(axis)) - np.searchsorted(axis, axis)
        axes.append(np.where(axis % 2, most - 1 - offsets, offsets))
    most = tuple(int(offsets.max()) + 1 for offsets in axes)
    if most == (1, 1):
        return np.zeros(len(down) * len(across), dtype=np.uint32)
    return order_mirrors(*most)[np.ix_(*axes)].ravel()


def _herd(heights: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Blocks of a cell in the order of herding, each as often as it has mirrors."""
    # In whole numbers, so that every machine finds the same. They are exact although sums may pass
    # 64 bits on the way: what is compared is small, and what wraps around comes back
    near = []
    unit = 2**15  # potential of a mirror on itself in each direction
    for sides in (heights, widths):
        centre = (np.cumsum(sides) - sides / 2) / sides.sum()
        distance = np.abs(np.subtract.outer(centre, centre))
        # Length over which mirrors repel each other, in sides of a cell
        near.append(np.rint(unit * np.exp(-distance / 0.3)).astype(np.int64))
    down, across = near
    free = np.outer(heights, widths)
    mirrors = int(free.sum())
    wanted = 2 * np.outer(down @ heights, across @ widths)
    excess = np.full(free.shape, unit**2 * mirrors)
    chosen = np.empty(mirrors, dtype=np.intp)
    for step in range(mirrors):
        excess -= wanted
        chosen[step] = excess.argmin()
        row, column = divmod(int(chosen[step]), len(widths))
        excess += np.outer(down[row], 2 * mirrors * across[column])
        free[row, column] -= 1
        if not free[row, column]:
            excess[row, column] = 2**62  # beyond what any other reaches
    return chosen


# Files -------------------------------------------------------------------------------------------

AGAIN = "export the patterns again"
"""Advice for a file that is not as exported."""


@dataclass(frozen=True)
class _OneFile:
    """All frames in one file, with the header of a numpy file or without."""

    name: str
    header: bool

    def write(self, folder: Path, frames: Iterable[np.ndarray], total: int, device: Device) -> None:
        """Write packed frames one at a time."""
        with (folder / self.name).open("wb") as stream:
            if self.header:
                stream.write(npy_header("|u1", (total, *device.frame_shape)))
            for frame in frames:
                stream.write(frame.data)

    def location(self, index: int, total: int, device: Device) -> tuple[str, int | None]:
        """File of a frame; no bit, as it holds all frames."""
        return self.name, None


class _Bitmaps:
    """A bitmap for each frame, with a bit a pixel."""

    def write(self, folder: Path, frames: Iterable[np.ndarray], total: int, device: Device) -> None:
        """Write packed frames one at a time."""
        from PIL import Image

        (folder / "frames").mkdir()
        for index, frame in enumerate(frames):
            picture = Image.frombytes("1", (device.columns, device.rows), frame.tobytes())
            name, _ = self.location(index, total, device)
            _save_bitmap(picture, folder / name)

    def location(self, index: int, total: int, device: Device) -> tuple[str, int | None]:
        """File of a frame, numbered with as many digits as the last one, and the bit in it."""
        digits = max(4, len(str(total - 1)))
        return f"frames/{index:0{digits}d}.bmp", 0


class _Planes:
    """Frames as the bit-planes of 24-bit pictures, for controllers that take them so.

    Frames fill the pictures in the order in which they are shown. `Device.planes` says which
    colours hold bit positions 0 to 7, 8 to 15 and 16 to 23, each colour's lowest bit first.
    """

    def write(self, folder: Path, frames: Iterable[np.ndarray], total: int, device: Device) -> None:
        """Write packed frames one at a time."""
        from PIL import Image

        (folder / "images").mkdir()
        for image, picture in enumerate(self.pictures(frames, total, device)):
            _save_bitmap(Image.fromarray(picture), folder / f"images/{image:04d}.bmp")

    def pictures(
        self, frames: Iterable[np.ndarray], total: int, device: Device
    ) -> Iterator[np.ndarray]:
        """Pictures of frames, uint8 (rows, columns, red green blue), as the frames come."""
        together = device.packed_frames(total)
        picture = np.zeros((device.rows, device.columns, 3), np.uint8)
        for index, frame in enumerate(frames):
            bit = index % together
            lit = np.unpackbits(frame, axis=1, count=device.columns)
            picture[..., self._channel(device, bit)] |= lit << bit % 8
            if bit == together - 1 or index == total - 1:
                yield picture
                picture = np.zeros_like(picture)

    def location(self, index: int, total: int, device: Device) -> tuple[str, int]:
        """File of a frame, and the bit position in it."""
        image, bit = divmod(index, device.packed_frames(total))
        return f"images/{image:04d}.bmp", bit

    @staticmethod
    def _channel(device: Device, bit: int) -> int:
        """Number of a bit position's colour among red, green and blue."""
        return "RGB".index(device.planes[bit // 8])


Format = Literal["npy", "raw", "png", "bmp", "planes"]
"""Files of the frames; `png` is of earlier versions."""

PLANES_FORMAT = _Planes()

FRAME_FORMATS: dict[Format, _OneFile | _Bitmaps | _Planes] = {
    "npy": _OneFile("frames.npy", header=True),
    "raw": _OneFile("frames.bin", header=False),
    "bmp": _Bitmaps(),
    "planes": PLANES_FORMAT,
}
"""Files of frames by name."""


def _save_bitmap(picture: "Image", path: Path) -> None:
    """Write a picture."""
    file = io.BytesIO()  # Pillow itself loses what a full disk does not take
    picture.save(file, "BMP")
    path.write_bytes(file.getvalue())

"""Mirrors of a frame: how many of a cell are ON, which ones, and the packed bits.

A cell's grey level is the number `k` of its `K` mirrors that are ON, exact in both selections.
`ordered` takes the first k of a fixed order in which every beginning is spread evenly over the
cell, so that k/K of the light is taken even where a scene varies within a cell; `random` takes any
k, drawn anew for each cell of each frame.

Bits are packed along rows, the leftmost mirror in the highest bit of a byte, ON as 1 unless the
layout inverts them; each row begins a new byte.
"""

from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from deepfsi.camera import LIGHT_LAWS, Device, DmdGrid, LightLawName
from deepfsi.hardware.patterns.sequence import Rail, Selection

SMALLEST_STEP = float(np.finfo(np.float64).tiny)
"""Step between grey levels, as a share of a pixel's photons, below which a rail is dark."""

MOST_TABLE_BYTES = 2**24
"""Largest table of every grey level of a cell, packed; larger ones are not worth their memory."""

MOST_ORDERED_SINGLY = 2**12
"""Most mirrors of a cell that are put in order one by one: the time grows with the square."""

REPULSION_LENGTH = 0.3
"""Length over which mirrors repel each other, in sides of a cell."""

POTENTIAL_UNIT = 2**15
"""Repelling potential of a mirror on itself in each direction, in the whole numbers used."""


class MaskFrames(NamedTuple):
    """Frames that show the rails of masks, mask by mask, dark rails left out."""

    shown: list[tuple[int, Rail]]
    # (f,): float64; largest share of a pixel's photons in each frame, on two arms the time of the
    # mask
    peaks: np.ndarray
    # (f, N): uint32; mirrors ON in each cell, 0 to K: the rail over its peak in steps of 1/K
    on: np.ndarray

    @property
    def dimmed(self) -> float:
        """Factor to the peaks with which they sum to at most 1."""
        return min(1.0, 1 / float(self.peaks.sum()))

    @property
    def shares(self) -> np.ndarray:
        """Share of the exposure of each frame, shape (f,)."""
        return np.minimum(self.peaks * self.dimmed, 1.0)


def count_mirrors(rails: np.ndarray, light: LightLawName, mirrors: int) -> MaskFrames:
    """Mirrors that show rails, frame by frame."""
    # rails (2 or 1, m, N)
    shown: list[tuple[int, Rail]] = []
    peaks = []
    on = np.empty((rails.shape[0] * rails.shape[1], rails.shape[2]), dtype=np.uint32)
    for mask in range(rails.shape[1]):
        parts = rails[:, mask].astype(np.float64)
        sides: list[tuple[Rail, float, np.ndarray]] = []
        if LIGHT_LAWS[light].arms == 2:
            time = parts.sum(axis=0)
            sides.append(("both", time.max(), parts[0] / np.where(time > 0, time, 1.0) * mirrors))
        else:
            names: tuple[Rail, Rail] = ("plus", "minus")
            for rail, part in zip(names, parts, strict=False):
                step = max(part.max() / mirrors, SMALLEST_STEP)
                sides.append((rail, part.max(), part / step))
        for rail, peak, level in sides:
            if peak > mirrors * SMALLEST_STEP:
                on[len(shown)] = np.rint(level)
                shown.append((mask, rail))
                peaks.append(peak)
    return MaskFrames(shown, np.array(peaks), on[: len(shown)])


def make_frames(
    on: Iterable[np.ndarray],
    device: Device,
    grid: DmdGrid,
    selection: Selection = "ordered",
    seed: int = 0,
) -> Iterator[np.ndarray]:
    """Packed frames, one at a time."""
    # on (N,)
    for frame in _lit_frames((each[grid.pixels] for each in on), device, grid, selection, seed):
        yield _as_written(frame, device, grid)


def make_frame(on: np.ndarray, device: Device, grid: DmdGrid) -> np.ndarray:
    """Packed frame of cells (N,) that have all mirrors ON where true, and none elsewhere."""
    sides = grid.down, grid.height, grid.across, grid.width
    lit = np.broadcast_to(on[grid.pixels][:, None, :, None], sides)
    return _as_written(_pack(lit, device, grid), device, grid)


def _as_written(frame: np.ndarray, device: Device, grid: DmdGrid) -> np.ndarray:
    """Packed frame as the layout has it: inverted, or as it is."""
    if not grid.layout.invert:
        return frame
    return frame ^ np.packbits(np.ones((device.rows, device.columns), dtype=np.bool_), axis=1)


def _lit_frames(
    on: Iterable[np.ndarray], device: Device, grid: DmdGrid, selection: Selection, seed: int
) -> Iterator[np.ndarray]:
    """Packed frames of the cells of the device, mirrors ON as 1."""
    # on (down, across)
    if selection == "random":
        yield from _draw(on, device, grid, np.random.default_rng(seed))
    elif _aligned(device, grid):
        yield from _look_up(on, device, grid)
    else:
        yield from _compare(on, device, grid)


def unpack(frame: np.ndarray, device: Device) -> np.ndarray:
    """Mirrors of a packed frame, bool (rows, columns), True where the frame has a 1."""
    return np.unpackbits(frame, axis=1, count=device.columns).view(np.bool_)


def recount(mirrors: np.ndarray, grid: DmdGrid) -> np.ndarray:
    """Mirrors ON in each cell, shape (N,), of a frame's mirrors, bool (rows, columns)."""
    window = mirrors[grid.window].view(np.uint8)
    cells = window.reshape(grid.down, grid.height, grid.across, grid.width)
    out = np.empty(grid.pixels.size, dtype=np.uint32)
    out[grid.pixels] = cells.sum(axis=(1, 3), dtype=np.uint32)
    return out


@lru_cache(maxsize=4)
def order_mirrors(height: int, width: int) -> np.ndarray:
    """Place of each mirror of a cell in the order in which grey levels switch them ON."""
    # Each next mirror is the one that brings the mean of a repelling potential over the mirrors
    # chosen closest to its mean over the whole cell (kernel herding), so that every beginning of
    # the order represents the cell. Of very large cells whole blocks of mirrors are chosen, as
    # often as they have mirrors, and each gives those in an order of its own. Places are 0 to
    # height · width - 1, each once, in an array (height, width) that is read only
    rows, columns = height, width
    while rows * columns > MOST_ORDERED_SINGLY:
        rows, columns = (-(-rows // 2), columns) if rows > columns else (rows, -(-columns // 2))
    down, across = np.arange(height) * rows // height, np.arange(width) * columns // width
    block = np.add.outer(down * columns, across).ravel()
    chosen = _herd(np.bincount(down), np.bincount(across))
    order = np.empty(height * width, dtype=np.uint32)
    order[np.lexsort((_inside(down, across), block))] = np.argsort(chosen, kind="stable")
    order.flags.writeable = False
    return order.reshape(height, width)


def _inside(down: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Order of each mirror among those of its block; neighbouring blocks' are mirror images."""
    places = []
    for axis in (down, across):
        most = np.bincount(axis).max()
        place = np.arange(len(axis)) - np.searchsorted(axis, axis)
        places.append(np.where(axis % 2, most - 1 - place, place))
    most = tuple(int(place.max()) + 1 for place in places)
    if most == (1, 1):
        return np.zeros(len(down) * len(across), dtype=np.uint32)
    return order_mirrors(*most)[np.ix_(*places)].ravel()


def _herd(heights: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Blocks of a cell in the order of herding, each as often as it has mirrors."""
    # In whole numbers, so that every machine finds the same. They are exact although sums may pass
    # 64 bits on the way: what is compared is small, and what wraps around comes back
    near = []
    for sides in (heights, widths):
        centre = (np.cumsum(sides) - sides / 2) / sides.sum()
        distance = np.abs(np.subtract.outer(centre, centre))
        near.append(np.rint(POTENTIAL_UNIT * np.exp(-distance / REPULSION_LENGTH)).astype(np.int64))
    down, across = near
    free = np.outer(heights, widths)
    mirrors = int(free.sum())
    wanted = 2 * np.outer(down @ heights, across @ widths)
    excess = np.full(free.shape, POTENTIAL_UNIT**2 * mirrors)
    chosen = np.empty(mirrors, dtype=np.intp)
    for place in range(mirrors):
        excess -= wanted
        chosen[place] = excess.argmin()
        row, column = divmod(int(chosen[place]), len(widths))
        excess += np.outer(down[row], 2 * mirrors * across[column])
        free[row, column] -= 1
        if not free[row, column]:
            excess[row, column] = 2**62  # beyond what any other reaches
    return chosen


def _aligned(device: Device, grid: DmdGrid) -> bool:
    """True where every cell begins and ends with a byte and a table of its levels is small."""
    return (
        grid.width % 8 == 0
        and grid.left % 8 == 0
        and (grid.mirrors + 1) * grid.mirrors <= 8 * MOST_TABLE_BYTES
    )


def _look_up(on: Iterable[np.ndarray], device: Device, grid: DmdGrid) -> Iterator[np.ndarray]:
    """Frames put together from packed cells, one for each grey level."""
    order = order_mirrors(grid.height, grid.width)
    levels = np.arange(grid.mirrors + 1)[:, None, None]
    tiles = np.concatenate(
        [np.packbits(order < some, axis=2) for some in np.array_split(levels, 64)]
    ).transpose(1, 0, 2)
    whole = np.ascontiguousarray(tiles).view(f"V{grid.width // 8}")[..., 0]
    for counts in on:
        frame = np.zeros(device.frame_shape, dtype=np.uint8)
        rows = frame[grid.top : grid.top + grid.down * grid.height]
        left = grid.left // 8
        window = rows[:, left : left + grid.across * grid.width // 8]
        cells = whole[:, counts]
        shape = grid.down, grid.height, grid.across * grid.width // 8
        window.reshape(shape)[...] = cells.transpose(1, 0, 2).copy().view(np.uint8).reshape(shape)
        yield frame


def _compare(on: Iterable[np.ndarray], device: Device, grid: DmdGrid) -> Iterator[np.ndarray]:
    """Frames from comparing each mirror's place in the order with its cell's count."""
    order = order_mirrors(grid.height, grid.width)[None, :, None, :]
    for counts in on:
        lit = order < counts[:, None, :, None]
        yield _pack(lit, device, grid)


def _draw(
    on: Iterable[np.ndarray], device: Device, grid: DmdGrid, rng: np.random.Generator
) -> Iterator[np.ndarray]:
    """Frames with mirrors drawn at random, as many as counted."""
    places = np.arange(grid.mirrors, dtype=np.uint32)
    for counts in on:
        lit = places < counts.reshape(-1, 1)
        grey = ((counts > 0) & (counts < grid.mirrors)).ravel()
        lit[grey] = rng.permuted(lit[grey], axis=1)
        cells = lit.reshape(grid.down, grid.across, grid.height, grid.width)
        yield _pack(cells.transpose(0, 2, 1, 3), device, grid)


def _pack(lit: np.ndarray, device: Device, grid: DmdGrid) -> np.ndarray:
    """Packed frame of mirrors (down, height, across, width)."""
    mirrors = np.zeros((device.rows, device.columns), dtype=np.bool_)
    mirrors[grid.window] = lit.reshape(grid.down * grid.height, grid.across * grid.width)
    return np.packbits(mirrors, axis=1)

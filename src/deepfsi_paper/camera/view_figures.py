"""Figures of the camera's view, and of a mask made of mirrors."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import ConnectionPatch, Rectangle

from deepfsi.base.errors import InputError
from deepfsi.camera.layout import DmdGrid
from deepfsi.report.style import DESIGN_COLOURS, GREYS, GRID, PAGE_WIDTH, plain_bar, styled

MARGIN = 1.5
"""Width beside the scenes for words and scale, inches."""

FRAME_PIXELS = 512
"""A whole frame is averaged to at most this many pixels across."""


@styled
def views_figure(
    raw: np.ndarray,
    seen: np.ndarray,
    names: Sequence[str] = (),
    *,
    cell: tuple[float, float] = (1, 1),
) -> Figure:
    """Scenes as displayed above, and as the camera sees them below, on one scale.

    Parameters
    ----------
    raw : array, shape (n, h, w)
        Reflectance that is displayed, in [0, 1].
    seen : array, shape (n, down, across)
        Relative light at the cells, in [0, 1].
    names : sequence of str
        Heading of each scene.
    cell : tuple of float
        Height and width of a cell, in any unit: 24 and 32 mirrors on a DLP7000.

    Raises
    ------
    InputError
        If the two differ in number.
    """
    if len(raw) != len(seen) or len(raw) == 0:
        raise InputError(
            f"{len(raw)} displayed scenes and {len(seen)} views: give one view of each"
        )
    shape = seen.shape[1] * cell[0] / (seen.shape[2] * cell[1])
    tile = (PAGE_WIDTH - MARGIN) / max(len(raw), 4)
    heights = [tile * raw.shape[1] / raw.shape[2], tile * shape]
    figure = Figure(
        figsize=(tile * len(raw) + MARGIN, sum(heights) + (0.4 if names else 0.16)),
        layout=ConstrainedLayoutEngine(w_pad=0.04, h_pad=0.04, wspace=0.02, hspace=0.02),
    )
    axes = figure.subplots(2, len(raw), squeeze=False, height_ratios=heights)
    norm = Normalize(0, 1)
    for column, images in enumerate(zip(raw, seen, strict=True)):
        for ax, image, ratio in zip(axes[:, column], images, (1.0, cell[0] / cell[1]), strict=True):
            ax.imshow(image, cmap=GREYS, norm=norm, aspect=ratio, interpolation="none")
            ax.set(xticks=[], yticks=[])
            ax.spines[:].set(visible=True, color=GRID)
        if names:
            axes[0, column].set_title(names[column], loc="center")
    for ax, words in zip(axes[:, 0], ("displayed", "as the\ncamera\nsees it"), strict=True):
        ax.set_ylabel(words, rotation=0, horizontalalignment="right", verticalalignment="center")
    bar = figure.colorbar(ScalarMappable(norm, GREYS), ax=axes, aspect=16, pad=0.015)
    bar.set_label("reflectance,\nrelative light", fontsize=8)
    bar.set_ticks([0, 0.5, 1])
    plain_bar(bar)
    return figure


@styled
def mirrors_figure(
    mirrors: np.ndarray,
    grid: DmdGrid,
    close: tuple[int, int] | None = None,
    cells: tuple[int, int] = (3, 3),
) -> Figure:
    """One frame of a grey mask, whole and close by, where its mirrors can be told apart.

    White is ON. Of the whole frame, a pixel is the average of a few mirrors. Below each column
    and beside each row of the close-up stands which cell of the mask it is.

    Parameters
    ----------
    mirrors : array of bool, shape (rows, columns)
        ON mirrors, as `unpack` gives them.
    grid : Grid
        Where the cells lie.
    close : tuple of int, optional
        First cell of the close-up, down and across; by default about the middle.
    cells : tuple of int
        Cells of the close-up, down and across.

    Raises
    ------
    InputError
        If the close-up leaves the mask.
    """
    first, extent = _close_up(grid, close, cells)
    rows, columns = mirrors.shape
    top, left = np.array([grid.top, grid.left]) + first * (grid.height, grid.width)
    height, width = extent * (grid.height, grid.width)
    figure = Figure(figsize=(PAGE_WIDTH, 3.0), layout="constrained")
    whole, near = figure.subplots(1, 2, width_ratios=(columns / rows, width / height))
    factor = -(-columns // FRAME_PIXELS)
    looks: dict[str, Any] = {"cmap": GREYS, "vmin": 0, "vmax": 1, "interpolation": "none"}
    whole.imshow(_averaged(mirrors, factor), extent=(0, columns, rows, 0), **looks)
    finer = -(-256 // max(height, width))  # printers smooth pixels: leave them little to smooth
    near.imshow(
        mirrors[top : top + height, left : left + width].repeat(finer, 0).repeat(finer, 1),
        extent=(left, left + width, top + height, top),
        **looks,
    )
    _join(figure, whole, near, (left, top), (width, height))
    whole.set_title(f"one frame, {columns} × {rows} mirrors")
    whole.set(xlabel="mirror across", ylabel="mirror down")
    whole.set_xticks(_quarters(columns))
    whole.set_yticks(_quarters(rows))
    _number_cells(near, grid, first, extent)
    for ax in (whole, near):
        ax.spines[:].set(visible=True)
    return figure


def _close_up(
    grid: DmdGrid, close: tuple[int, int] | None, cells: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """First cell and extent of the close-up, down and across."""
    all_cells = np.array([grid.down, grid.across])
    extent = np.minimum(cells, all_cells)
    first = (all_cells - extent) // 2 if close is None else np.array(close)
    if (first < 0).any() or (first + extent > all_cells).any():
        raise InputError(
            f"a close-up from cell {tuple(first.tolist())} leaves a mask of {grid.down} x "
            f"{grid.across} cells: choose a smaller one, or begin nearer to the middle"
        )
    return first, extent


def _join(
    figure: Figure, whole: Axes, near: Axes, corner: tuple[int, int], size: tuple[int, int]
) -> None:
    """Frame the close-up in the whole frame, and join both by lines."""
    (left, top), (width, height) = corner, size
    colour = DESIGN_COLOURS["deepfsi"]
    frame = Rectangle(corner, width, height, fill=False, edgecolor=colour, linewidth=1.4, zorder=4)
    whole.add_patch(frame)
    for down in (0, 1):
        here, there = (left + width, top + height * down), (left, top + height * down)
        line = ConnectionPatch(
            here, there, "data", "data", axesA=whole, axesB=near, color=colour, linewidth=0.7
        )
        figure.add_artist(line)


def _number_cells(near: Axes, grid: DmdGrid, first: np.ndarray, extent: np.ndarray) -> None:
    """Border the cells of the close-up, and write which cells of the mask they are."""
    top, left = np.array([grid.top, grid.left]) + first * (grid.height, grid.width)
    looks: dict[str, Any] = {"color": DESIGN_COLOURS["deepfsi"], "linewidth": 1.2, "clip_on": False}
    for down in range(extent[0] + 1):
        near.axhline(top + down * grid.height, **looks)
    for across in range(extent[1] + 1):
        near.axvline(left + across * grid.width, **looks)
    middles = left + (np.arange(extent[1]) + 0.5) * grid.width
    near.set_xticks(middles, [str(first[1] + i + 1) for i in range(extent[1])])
    middles = top + (np.arange(extent[0]) + 0.5) * grid.height
    near.set_yticks(middles, [str(first[0] + i + 1) for i in range(extent[0])])
    near.set_title("close by")
    near.set(
        xlabel=f"cell across, {grid.width} mirrors each",
        ylabel=f"cell down, {grid.height} mirrors each",
    )
    near.tick_params(length=0)
    near.yaxis.tick_right()
    near.yaxis.set_label_position("right")


def _averaged(mirrors: np.ndarray, factor: int) -> np.ndarray:
    """Mirrors averaged over squares of `factor`, without an incomplete last square."""
    rows, columns = (size // factor * factor for size in mirrors.shape)
    tiles = mirrors[:rows, :columns].reshape(rows // factor, factor, columns // factor, factor)
    return np.asarray(tiles.mean(axis=(1, 3)))


def _quarters(size: int) -> list[int]:
    return [round(size * part / 4) for part in range(5)]

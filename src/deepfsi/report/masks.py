"""Pictures of one design's masks, and the distribution of their values."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from deepfsi.report.style import COLOURS, DIVERGING, GRID, INK, MUTED, styled

BAR_LABEL = "share of a pixel's photons, Mᵢⱼ"


def signed(rails_or_matrix: np.ndarray) -> np.ndarray:
    """Sensing matrix M (m, N) of rails (2 or 1, m, N), or the matrix itself."""
    array = np.asarray(rails_or_matrix)
    if array.ndim == 2:
        return array
    return np.asarray(array[0] - array[1] if len(array) == 2 else array[0])


def peak(rails_or_matrix: np.ndarray) -> float:
    """Largest |M_ij|, the end of every scale of masks; 1 where all is dark."""
    return float(np.abs(rails_or_matrix).max()) or 1.0


def brightest(rails_or_matrix: np.ndarray, count: int) -> np.ndarray:
    """Index of the masks that count most photons from a uniform scene, brightest first."""
    array = np.asarray(rails_or_matrix)
    light = np.abs(array).sum(axis=-1)
    total = light.sum(axis=0) if array.ndim == 3 else light
    return np.argsort(-total, kind="stable")[:count]


@styled
def masks_figure(
    rails_or_matrix: np.ndarray,
    image_shape: tuple[int, ...],
    title: str | None = None,
    count: int = 12,
    bar: bool = True,
) -> Figure:
    """Masks of one design, those that count most photons first: images, or curves for spectra.

    The scale is symmetric, from −peak to peak with 0 neutral; the peak is the largest |M_ij|.

    Parameters
    ----------
    rails_or_matrix : array, shape (2 or 1, m, N) or (m, N)
        Shares of each pixel's photons.
    image_shape : tuple of int
        Two sides, or one for spectra.
    title : str, optional
    count : int
        Masks to show at most.
    bar : bool
        Draw the colour bar (images only).
    """
    matrix = signed(rails_or_matrix)
    chosen = brightest(rails_or_matrix, count)
    end = peak(matrix)
    images = len(image_shape) == 2
    columns = 6 if images else min(3, len(chosen))
    rows = -(-len(chosen) // columns)
    width = 5.0
    tile, foot = (width / 6 * image_shape[0] / image_shape[1], 0.55 * bar) if images else (1.1, 0.3)
    height = rows * tile + foot + (0.3 if title else 0)
    layout = ConstrainedLayoutEngine(w_pad=0.02, h_pad=0.02, wspace=0.02, hspace=0.02)
    figure = Figure(figsize=(width, height), layout=layout)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for place, ax in enumerate(grid.flat):
        if place >= len(chosen):
            ax.set_visible(False)
            continue
        mask = matrix[chosen[place]]
        if images:
            mask_axes(ax, mask.reshape(image_shape), end)
        else:
            ax.axhline(0, color=MUTED, linewidth=0.6)
            ax.plot(np.arange(1, len(mask) + 1), mask, color=COLOURS["pca"], linewidth=1.1)
            ax.set_ylim(-1.05 * end, 1.05 * end)
            ax.tick_params(labelbottom=place + columns >= len(chosen))
    if not images:
        figure.supxlabel("band", fontsize=9)
        figure.supylabel("Mᵢⱼ", fontsize=9)
    if title:
        figure.suptitle(title, fontsize=10)
    if bar and images:
        _colour_bar(figure, end, ax=grid, aspect=32, shrink=0.7, pad=0.03)
    return figure


def mask_axes(ax: Axes, mask: np.ndarray, end: float, colours: str = DIVERGING) -> None:
    """Draw a mask as an image.

    Parameters
    ----------
    ax : Axes
    mask : array, shape (height, width)
    end : float
        End of the scale, which begins at −`end`.
    colours : str
        Name of a colour map.
    """
    finer = -(-128 // max(mask.shape))  # printers smooth pixels: leave them little to smooth
    ax.imshow(
        mask.repeat(finer, axis=0).repeat(finer, axis=1),
        cmap=colours,
        vmin=-end,
        vmax=end,
        interpolation="none",
    )
    ax.set(xticks=[], yticks=[])
    ax.spines[:].set(visible=True, color=GRID)


@styled
def scale_figure() -> Figure:
    """Draw the colour bar of masks alone, in parts of the peak."""
    figure = Figure(figsize=(3.4, 0.62), layout="constrained")
    bar = _colour_bar(figure, 1.0, cax=figure.subplots())
    bar.set_ticks([-1, 0, 1], labels=["−peak", "0", "peak"])
    return figure


def _colour_bar(figure: Figure, end: float, **where: Any) -> Colorbar:
    scale = ScalarMappable(Normalize(-end, end), DIVERGING)
    bar = figure.colorbar(scale, orientation="horizontal", **where)
    bar.set_label(BAR_LABEL)
    bar.set_ticks([-end, -end / 2, 0, end / 2, end])
    bar.ax.xaxis.set_major_formatter(
        FuncFormatter(lambda value, _: f"{value:.2g}".replace("-", "−"))
    )
    bar.outline.set_edgecolor(MUTED)
    return bar


@styled
def values_figure(rails_or_matrix: np.ndarray) -> Figure:
    """Shares of the values of rails (2 or 1, m, N) or masks (m, N) in bins, on a log scale."""
    values = signed(rails_or_matrix).ravel()
    end = peak(values)
    counts, edges = np.histogram(values, bins=51, range=(-end, end))
    figure = Figure(figsize=(5.0, 1.5), layout="constrained")
    ax = figure.subplots()
    floor = 0.5 / values.size
    ax.stairs(counts / values.size, edges, baseline=floor, fill=True, color=MUTED)
    ax.set_yscale("log")
    ax.set_ylim(floor, 1.5)
    ax.set_xlim(-end, end)
    ax.axvline(0, color=INK, linewidth=0.6)
    ax.yaxis.set_major_locator(LogLocator(numticks=4))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.set_xlabel("Mᵢⱼ")
    ax.set_ylabel("share of entries")
    return figure

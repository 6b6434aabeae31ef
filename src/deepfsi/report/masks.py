"""Pictures of masks."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from deepfsi.base.quantities import budget_text
from deepfsi.evaluation.results import lit_masks
from deepfsi.report import style
from deepfsi.report.style import DIVERGING

if TYPE_CHECKING:  # it imports torch
    from deepfsi.design.design import Design

BAR_LABEL = "share of a pixel's photons, Mᵢⱼ"
"""Words of a scale of mask values."""


def signed(rails_or_matrix: np.ndarray) -> np.ndarray:
    """Sensing matrix M (m, N) of rails (2 or 1, m, N), or the matrix itself."""
    array = np.asarray(rails_or_matrix)
    if array.ndim == 2:
        return array
    return np.asarray(array[0] - array[1] if len(array) == 2 else array[0])


def peak_value(rails_or_matrix: np.ndarray) -> float:
    """Largest |M_ij|, the end of every scale of masks; 1 where all is dark."""
    return float(np.abs(rails_or_matrix).max()) or 1.0


def brightest_masks(rails_or_matrix: np.ndarray, count: int) -> np.ndarray:
    """Indices of the masks that count most photons from a uniform scene, brightest first.

    Takes rails (2 or 1, m, N) or a matrix (m, N). Dark masks are left out, unless all are dark.
    """
    array = np.asarray(rails_or_matrix)
    light = np.abs(array).sum(axis=-1)
    total = light.sum(axis=0) if array.ndim == 3 else light
    return np.argsort(-total, kind="stable")[: min(count, lit_masks(array) or len(total))]


def _scale_of(matrix: np.ndarray) -> ScalarMappable:
    """Colours of masks: black at 0 to white at the peak; for signed ones symmetric about white."""
    end = peak_value(matrix)
    if matrix.min() < 0:
        return ScalarMappable(Normalize(-end, end), DIVERGING)
    return ScalarMappable(Normalize(0, end), style.GREYS)


@style.styled
def masks_figure(
    matrix: np.ndarray,
    image_shape: tuple[int, ...],
    title: str = "",
    count: int = 12,
    *,
    dwells: np.ndarray | None = None,
) -> Figure:
    """Masks of a matrix (m, N), brightest first, with dwells (m,): images, or curves of spectra.

    Above each mask stands its number, from 1 in the order in which masks are shown. The scale ends
    at the peak, the largest |M_ij|. It begins at 0, or at −peak for signed masks.
    """
    chosen = brightest_masks(matrix, count)
    images = len(image_shape) == 2
    columns = 6 if images else min(3, len(chosen))
    rows = -(-len(chosen) // columns)
    tile = 0.85 * image_shape[0] / image_shape[1] if images else 1.1
    words = 0.19 * (1 + (images and dwells is not None))  # above each mask, and below
    height = rows * (tile + words) + (0.6 if images else 0.3) + 0.18 * len(title.splitlines())
    layout = ConstrainedLayoutEngine(w_pad=0.02, h_pad=0.02, wspace=0.02, hspace=0.02)
    figure = Figure(figsize=(5.4, height), layout=layout)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for ax in grid.flat[len(chosen) :]:
        ax.set_visible(False)
    if title:
        figure.suptitle(title, fontsize=9, x=0.01, horizontalalignment="left")
    scale = _scale_of(matrix)
    for index, (ax, number) in enumerate(zip(grid.flat, chosen, strict=False)):
        dwell = "" if dwells is None else f"dwell {_percent(float(dwells[number]))}"
        heading = f"mask {number + 1}"
        if images:
            mask_axes(ax, matrix[number].reshape(image_shape), scale)
            ax.set_xlabel(dwell, fontsize=9, labelpad=2)
        else:
            _curve_axes(ax, matrix[number], scale)
            ax.tick_params(labelbottom=index + columns >= len(chosen))
            heading = ", ".join(filter(None, [heading, dwell]))
        ax.set_title(heading, fontsize=9, fontweight="normal", pad=2)
    if images:
        bar = figure.colorbar(
            scale, ax=grid, orientation="horizontal", aspect=40, shrink=0.7, pad=0.03,
            label=BAR_LABEL, ticks=np.linspace(*scale.get_clim(), 5), format="{x:.2g}",
        )  # fmt: skip
        style.plain_bar(bar)
    else:
        figure.supxlabel("band", fontsize=9)
        figure.supylabel(BAR_LABEL.replace("pixel", "band"), fontsize=9)
    return figure


def design_figure(design: "Design", count: int) -> Figure:
    """Masks of a design, with its light and its dwells."""
    exposure = design.mask_exposure
    matrix, shape, dwells = exposure.drawing()
    budget = design.info.get("job", {}).get("photons")
    title = f"{design.name}, {exposure.title}" + (
        f", {budget_text(budget)} photons" if budget else ""
    )
    if count < design.masks:
        title += f"; the {count} that count most photons"
    if dwells is not None:
        title += "\ndwell: share of the exposure"
    return masks_figure(
        matrix.cpu().numpy(),
        shape,
        title,
        count,
        dwells=None if dwells is None else dwells.detach().cpu().numpy(),
    )


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.0995 else f"{100 * share:.0f} %"


def mask_axes(ax: Axes, mask: np.ndarray, scale: ScalarMappable) -> None:
    """Draw a mask (height, width) as an image."""
    low, high = scale.get_clim()
    ax.imshow(mask, cmap=scale.cmap, vmin=low, vmax=high, interpolation="nearest")
    ax.set(xticks=[], yticks=[])
    ax.spines[:].set(visible=True, color=style.GRID)


def _curve_axes(ax: Axes, mask: np.ndarray, scale: ScalarMappable) -> None:
    """Draw a mask for spectra as a curve over its bands."""
    ax.axhline(0, color=style.MUTED, linewidth=0.6)
    ax.plot(np.arange(1, len(mask) + 1), mask, color=style.DESIGN_COLOURS["pca"], linewidth=1.1)
    low, high = scale.get_clim()
    ax.set_ylim(1.05 * low, 1.05 * high)

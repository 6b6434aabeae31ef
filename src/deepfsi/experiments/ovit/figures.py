"""Masks of image patches."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from deepfsi.report.masks import brightest, mask_axes, peak, signed
from deepfsi.report.style import GREYS, PAGE_WIDTH, power_text, styled


@dataclass(frozen=True)
class LearnedMasks:
    """Learned masks of one budget.

    Attributes
    ----------
    photons : float
    side : int
        Of a patch, pixels.
    throughput, directions : sequence of float
        Share of the budget counted, and independent directions, of each trial's masks.
    matrix : array, shape (m, side²)
        Masks of the first trial.
    """

    photons: float
    side: int
    throughput: Sequence[float]
    directions: Sequence[float]
    matrix: Sequence[Sequence[float]]


@styled
def patch_masks_figure(rows: Sequence[LearnedMasks]) -> Figure:
    """All masks of image patches, a panel for each budget.

    Masks that count most photons come first, row by row. Black is −peak, mid-grey 0 and white
    peak; the peak, the largest |M_ij| of that budget, stands below.
    """
    width = PAGE_WIDTH / max(len(rows), 3)
    figure = Figure(figsize=(width * len(rows), width + 0.5), layout="constrained")
    panels = figure.subplots(1, len(rows), squeeze=False)[0]
    for ax, row in zip(panels, rows, strict=True):
        matrix, side = signed(np.asarray(row.matrix)), row.side
        across = math.ceil(math.sqrt(len(matrix)))
        down = -(-len(matrix) // across)
        sheet = np.full((down * (side + 1) - 1, across * (side + 1) - 1), np.nan)
        for place, index in enumerate(brightest(matrix, len(matrix))):
            y, x = (part * (side + 1) for part in divmod(place, across))
            sheet[y : y + side, x : x + side] = matrix[index].reshape(side, side)
        end = peak(matrix)
        mask_axes(ax, sheet, end, GREYS)
        ax.spines[:].set_visible(False)
        ax.set_title(f"{power_text(row.photons)} photons")
        ax.set_xlabel(f"peak {end:.2g}", fontsize=8)
    return figure

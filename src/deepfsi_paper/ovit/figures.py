"""Masks of image patches."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from deepfsi.report.masks import BAR_LABEL, brightest_masks, mask_axes, peak_value, signed
from deepfsi.report.style import GREYS, PAGE_WIDTH, SMALL, plain_bar, styled
from deepfsi_paper.report.scales import power_text

SHOWN = 16
"""Masks of a budget that are drawn at most."""


@dataclass(frozen=True)
class LearnedMasks:
    """Learned masks of one budget."""

    photons: float
    side: int  # of a patch, pixels
    throughput: Sequence[float]
    directions: Sequence[float]
    matrix: Sequence[Sequence[float]]  # (m, side²), Masks of the first trial


@styled
def patch_masks_figure(rows: Sequence[LearnedMasks]) -> Figure:
    """Masks of image patches, a panel for each budget with a scale of its own.

    Those that count most photons, row by row. Black is −peak, mid-grey 0 and white peak; the peak
    is the largest |M_ij| of that budget.
    """
    width = PAGE_WIDTH / max(len(rows), 3)
    figure = Figure(figsize=(width * len(rows), width + 0.45), layout="constrained")
    panels = figure.subplots(1, len(rows), squeeze=False)[0]
    for ax, row in zip(panels, rows, strict=True):
        matrix, side = signed(np.asarray(row.matrix)), row.side
        shown = brightest_masks(matrix, SHOWN)
        across = math.ceil(math.sqrt(len(shown)))
        down = -(-len(shown) // across)
        sheet = np.full((down * (side + 1) - 1, across * (side + 1) - 1), np.nan)
        for place, index in enumerate(shown):
            y, x = (part * (side + 1) for part in divmod(place, across))
            sheet[y : y + side, x : x + side] = matrix[index].reshape(side, side)
        end = peak_value(matrix)
        scale = ScalarMappable(Normalize(-end, end), GREYS)
        mask_axes(ax, sheet, scale)
        ax.spines[:].set_visible(False)
        ax.set_title(
            f"{power_text(row.photons)} photons: {len(shown)} of {len(matrix)} masks", fontsize=8
        )
        bar = figure.colorbar(
            scale, ax=ax, location="bottom", pad=0.02,
            aspect=28,
        )  # fmt: skip
        bar.set_ticks([-end, 0, end], labels=[f"−{end:.2g}", "0", f"{end:.2g}"])
        plain_bar(bar)
        bar.set_label(BAR_LABEL, fontsize=SMALL)
    return figure

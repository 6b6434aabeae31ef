"""Figure of rail sums: in the order in which they were shown, and by the fineness of the masks."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from deepfsi.report.style import GRID, INK, PAGE_WIDTH, SMALL, plain_bar, styled

TONES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")


@styled
def rail_light_figure(sums: np.ndarray, fine: np.ndarray, names: Sequence[str]) -> Figure:
    """Rail sums (runs, m) over their mean, with the band of 95 % of Poisson's."""
    # fine (m, axes)
    relative = sums / sums.mean(axis=1, keepdims=True)
    figure = Figure(figsize=(PAGE_WIDTH, 3.1), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
    for run, (row, name) in enumerate(zip(relative, names, strict=True)):
        tone = TONES[run % len(TONES)]
        left.plot(row, ".", ms=2.5, color=tone, label=name, alpha=0.7)
    half = 1.96 / np.sqrt(sums.mean(axis=1).max())
    left.axhspan(1 - half, 1 + half, color=GRID, zorder=0)
    left.set_xlabel("pair of mask and inverse, in order")
    left.set_ylabel("light of the pair / mean")
    figure.legend(fontsize=SMALL, frameon=False, markerscale=3, loc="outside upper left", ncols=4)
    every = relative.mean(axis=0)
    if fine.shape[1] == 1:
        right.plot(fine[:, 0], every, ".", ms=2.5, color=INK)
        right.set_xlabel("edges of a mask")
        return figure
    order = np.argsort(every)
    dots = right.scatter(fine[order, 1], fine[order, 0], c=every[order], s=12, marker="s", lw=0)
    right.set_aspect("equal")
    right.set_xlabel("edges of a mask across")
    right.set_ylabel("edges down")
    plain_bar(figure.colorbar(dots, ax=right, label="light / mean"))
    return figure

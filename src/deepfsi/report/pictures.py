"""Figures of what a camera counted: least-squares pictures of scenes, and sums of rails."""

from collections.abc import Sequence

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from deepfsi.base.errors import InputError
from deepfsi.report.style import GREYS, GRID, PAGE_WIDTH, SMALL, plain_bar, styled

_MOST_PICTURES = 48
"""Pictures that one figure holds."""

_MOST_LETTERS = 16
"""Letters of a picture's caption."""


@styled
def pictures_figure(pictures: np.ndarray, names: Sequence[str]) -> Figure:
    """Least-squares pictures (S, down, across), or spectra (S, bands), of counts, on one scale.

    The scale ends at the brightest cell, and begins at 0 or at the darkest cell below it.
    """
    if len(pictures) != len(names) or len(pictures) == 0:
        raise InputError(f"{len(pictures)} pictures and {len(names)} names: give one name of each")
    drawn = np.asarray(pictures, dtype=float)[:_MOST_PICTURES]
    if drawn.ndim == 2:
        drawn = drawn[:, None, :]
    finite = drawn[np.isfinite(drawn)]
    low = min(0.0, finite.min(initial=0.0))
    high = finite.max(initial=0.0)
    norm = Normalize(low, high if high > low else low + 1)
    columns = min(6, len(drawn))
    rows = -(-len(drawn) // columns)
    tile = (PAGE_WIDTH - 0.8) / max(columns, 3)
    shape = max(drawn.shape[1] / drawn.shape[2], 0.2)
    figure = Figure(
        figsize=(tile * columns + 0.8, rows * (tile * shape + 0.24) + 0.2), layout="constrained"
    )
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax, picture, name in zip(axes.flat, drawn, names, strict=False):
        ax.imshow(
            np.ma.masked_invalid(picture),
            cmap=GREYS,
            norm=norm,
            aspect="auto" if drawn.shape[1] == 1 else "equal",
            interpolation="none",
        )
        ax.set(xticks=[], yticks=[])
        ax.spines[:].set(visible=True, color=GRID)
        # of long names of files the ends differ
        caption = name if len(name) <= _MOST_LETTERS else f"…{name[1 - _MOST_LETTERS :]}"
        ax.set_title(caption, fontsize=SMALL)
    for ax in list(axes.flat)[len(drawn) :]:
        ax.remove()
    bar = figure.colorbar(
        ScalarMappable(norm, GREYS), ax=list(figure.axes), aspect=24, pad=0.015, label="light"
    )
    plain_bar(bar)
    return figure

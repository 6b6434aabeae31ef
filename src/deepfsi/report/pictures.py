"""Least-squares pictures of an acquisition's scenes."""

from collections.abc import Sequence

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from deepfsi.base import InputError
from deepfsi.report.style import GREYS, GRID, PAGE_WIDTH, SMALL, plain_bar, styled

MOST_PICTURES = 48
"""Pictures that one figure holds."""

MOST_LETTERS = 16
"""Letters of a picture's caption."""


@styled
def pictures_figure(pictures: np.ndarray, names: Sequence[str]) -> Figure:
    """Least-squares pictures from the counts of an acquisition, on one scale."""
    # Pictures (S, down, across) or (S, bands), NaN where a scene was lost; at most the first 48.
    # The scale ends at the brightest cell, and begins at 0 or at the darkest cell below it
    if len(pictures) != len(names) or len(pictures) == 0:
        raise InputError(f"{len(pictures)} pictures and {len(names)} names: give one name of each")
    shown = np.asarray(pictures, dtype=float)[:MOST_PICTURES]
    if shown.ndim == 2:
        shown = shown[:, None, :]
    known = shown[np.isfinite(shown)]
    low, high = min(0.0, known.min(initial=0.0)), known.max(initial=0.0)
    norm = Normalize(low, high if high > low else low + 1)
    columns = min(6, len(shown))
    rows = -(-len(shown) // columns)
    tile = (PAGE_WIDTH - 0.8) / max(columns, 3)
    shape = max(shown.shape[1] / shown.shape[2], 0.2)
    figure = Figure(
        figsize=(tile * columns + 0.8, rows * (tile * shape + 0.24) + 0.2), layout="constrained"
    )
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax, picture, name in zip(axes.flat, shown, names, strict=False):
        ax.imshow(
            np.ma.masked_invalid(picture),
            cmap=GREYS,
            norm=norm,
            aspect="auto" if shown.shape[1] == 1 else "equal",
            interpolation="none",
        )
        ax.set(xticks=[], yticks=[])
        ax.spines[:].set(visible=True, color=GRID)
        ax.set_title(_caption(name), fontsize=SMALL)
    for ax in list(axes.flat)[len(shown) :]:
        ax.remove()
    bar = figure.colorbar(
        ScalarMappable(norm, GREYS), ax=list(figure.axes), aspect=24, pad=0.015, label="light"
    )
    plain_bar(bar)
    return figure


def _caption(name: str) -> str:
    """End of a scene's name, where the names of files differ."""
    return name if len(name) <= MOST_LETTERS else f"…{name[1 - MOST_LETTERS :]}"

"""Picture of one exposure with adaptive masks: what was shown, and what was known by then."""

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from deepfsi.base import budget_text
from deepfsi.report.masks import mask_axes
from deepfsi.report.style import COLOURS, GREYS, GRID, styled

if TYPE_CHECKING:  # it imports torch
    from deepfsi.design import Design

COLUMNS = 8
"""Looks that are drawn, at most."""

TILE = 0.75
"""Width of a look, inches."""

ROWS = ("mask", "mean scene\nby then", "probability\nby then")


def drawn_looks(looks: int) -> list[int]:
    """Places of the looks that are drawn, from 0: the first, the last, and some between."""
    return np.unique(np.rint(np.geomspace(1, looks, min(looks, COLUMNS))).astype(int) - 1).tolist()


@styled
def looks_figure(design: "Design", scene: np.ndarray, label: str, photons: float) -> Figure:
    """Looks at a scene with adaptive masks: each mask, and the scene and class as known after it.

    Parameters
    ----------
    design : Design
    scene : array, shape (N,)
        Reflectance.
    label : str
        Its class.
    photons : float
        Budget Φ.
    """
    masks, scenes, chances = design.looks_at(scene, photons)  # (K, N), (K, N) and (K, C)
    answer = design.classes[chances[-1].argmax()]
    title = (
        f"one exposure of {budget_text(photons)} photons in {design.masks} looks. Class: {label}. "
        f"Answer: {answer}, with probability {chances[-1].max():.3f}"
    )
    scene = scene.reshape(design.image_shape)
    places, shape = drawn_looks(len(masks)), scene.shape
    layout = ConstrainedLayoutEngine(w_pad=0.02, h_pad=0.03, wspace=0.02, hspace=0.02)
    wide = TILE * (len(places) + 1)
    figure = Figure(figsize=(wide, 2 * TILE * shape[0] / shape[1] + 1.6), layout=layout)
    told = textwrap.fill(title, int(12 * wide))
    figure.suptitle(told, fontsize=9, x=0.01, horizontalalignment="left")
    grid = figure.subplots(3, len(places) + 1, squeeze=False)
    light = ScalarMappable(Normalize(0, float(scene.max()) or 1.0), GREYS)
    mask_axes(grid[1, 0], scene, light)
    grid[1, 0].set_title("scene", fontsize=9, fontweight="normal", pad=2)
    for ax in (grid[0, 0], grid[2, 0]):
        ax.set_visible(False)
    for place, (top, middle, bottom) in zip(places, grid[:, 1:].T, strict=True):
        mask_axes(top, masks[place].reshape(shape), ScalarMappable(Normalize(0, 1), GREYS))
        top.set_title(f"look {place + 1}", fontsize=9, fontweight="normal", pad=2)
        mask_axes(middle, scenes[place].clip(0).reshape(shape), light)
        _bars(bottom, chances[place], design.classes, place == 0)
    for ax, words in zip(grid[:, 1], ROWS, strict=True):
        ax.set_ylabel(words, fontsize=8)
    return figure


def _bars(ax: Axes, chances: np.ndarray, classes: Sequence[str], labelled: bool) -> None:
    """Probabilities (C,) of the classes, the largest in colour."""
    colours = [GRID] * len(chances)
    colours[int(chances.argmax())] = COLOURS["adaptive"]
    ax.bar(np.arange(len(chances)), chances, color=colours, edgecolor="none")
    ax.set(ylim=(0, 1), xlim=(-0.6, len(chances) - 0.4), xticks=[int(chances.argmax())])
    ax.set_xticklabels([classes[int(chances.argmax())]], fontsize=8)
    ax.set_yticks([0, 1] if labelled else [])
    ax.tick_params(length=2, labelsize=8)

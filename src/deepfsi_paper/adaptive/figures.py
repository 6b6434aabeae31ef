"""Accuracy against flux, in exposures of fixed length."""

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from deepfsi.report.style import ACCURACY_AXIS, PANEL_HEIGHT, styled
from deepfsi_paper.report.lines import Line, draw_lines


@styled
def clock_figure(panels: Mapping[str, Sequence[Line]]) -> Figure:
    """Lines along logarithmic axes without marks: a panel for each label of an axis."""
    figure = Figure(figsize=(4.6 * len(panels), PANEL_HEIGHT), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for ax, (label, lines) in zip(axes, panels.items(), strict=True):
        draw_lines(ax, lines)
        ax.set_xscale("log")
        ax.set_xlabel(label)
    axes[0].set_ylabel(ACCURACY_AXIS)
    return figure

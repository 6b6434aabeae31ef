"""Lines of accuracy along an axis, side by side."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from math import isfinite
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from deepfsi.report.style import (
    ACCURACY_AXIS,
    GRID,
    INK,
    MUTED,
    PANEL_HEIGHT,
    photons_text,
    styled,
)
from deepfsi.sweeps.results import Point


@dataclass(frozen=True)
class Line:
    """Accuracies along an axis."""

    name: str  # for the key; empty for none
    look: Mapping[str, Any]  # colour, marker and kind of the line, as matplotlib's keywords
    across: Sequence[float]  # rising
    accuracy: Sequence[float]  # with its interval; none is drawn where both ends are left out
    low: Sequence[float] = ()
    high: Sequence[float] = ()

    @classmethod
    def through(
        cls, name: str, look: Mapping[str, Any], at: Iterable[tuple[float, Point]]
    ) -> "Line":
        """Line through accuracies, each with its place on the axis; with intervals if all have."""
        across, every = zip(*sorted(at, key=lambda each: each[0]), strict=True)
        ends = [(each.low, each.high) for each in every]
        low, high = zip(*ends, strict=True) if all(map(isfinite, chain(*ends))) else ((), ())
        return cls(name, look, across, [each.accuracy for each in every], low, high)


@styled
def lines_figure(
    panels: Mapping[str, Sequence[Line]],
    value: str = ACCURACY_AXIS,
    across: Callable[[float], str] = lambda value: photons_text(round(value)),
) -> Figure:
    """Accuracy along logarithmic axes: a panel for each label of an axis, with a key of its own."""
    # or other values, where their axis is named; `across` writes the ticks
    figure = Figure(figsize=(4.6 * len(panels), PANEL_HEIGHT), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for ax, (label, lines) in zip(axes, panels.items(), strict=True):
        _draw_lines(ax, lines)
        ax.set_xscale("log")
        ticks = sorted({value for line in lines for value in line.across})
        ax.xaxis.set_major_locator(FixedLocator(ticks))
        ax.xaxis.set_minor_locator(NullLocator())
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: across(value)))
        ax.set_xlabel(label)
    axes[0].set_ylabel(value)
    return figure


def _draw_lines(ax: Axes, lines: Iterable[Line]) -> None:
    """Draw lines with their intervals, and a key."""
    for line in lines:
        ax.plot(line.across, line.accuracy, label=line.name or "_", **line.look)
        if line.low:
            ax.vlines(line.across, line.low, line.high, color=line.look["color"], linewidth=1)
    ax.grid(visible=True, color=GRID)
    ax.tick_params(colors=MUTED, labelcolor=INK)
    ax.legend(frameon=False, fontsize=8, loc="best")

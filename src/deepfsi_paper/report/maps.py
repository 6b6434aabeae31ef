"""Accuracy over photon budget and compression ratio, as heat maps."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, FuncFormatter

from deepfsi.base.intervals import Difference
from deepfsi.report import style
from deepfsi.sweeps.results import Point, accuracy_difference
from deepfsi_paper.report import scales

LEAST_REACH = 0.05
"""Least end of a scale of differences: those of a thousandth look small."""


class _Scale(NamedTuple):
    """Colours of values."""

    norm: Normalize
    colours: str


def accuracy_grid(
    points: Iterable[Point], budgets: Sequence[float], ratios: Sequence[float]
) -> np.ndarray:
    """Accuracy of one design's points by compression ratio and budget."""
    grid = np.full((len(ratios), len(budgets)), np.nan)
    for point in points:
        if point.ratio in ratios and point.photons in budgets:
            grid[ratios.index(point.ratio), budgets.index(point.photons)] = point.accuracy
    return grid


@style.styled
def heat_figure(
    panels: Mapping[str, np.ndarray],
    budgets: Sequence[float],
    ratios: Sequence[float],
    trained_at: float | None = None,
) -> Figure:
    """Accuracy by photon budget and compression ratio, a heat map for each design.

    All panels share one colour scale. Values stand in the cells where they fit.

    Shapes: panels (len(ratios), len(budgets)).
    """
    edges = _edges(np.log10(budgets))
    columns = 2 if len(panels) == 4 else min(3, len(panels))
    rows = -(-len(panels) // columns)
    height = 0.9 + max(1.0, 0.24 * len(ratios))
    width = style.PAGE_WIDTH * (0.28 + 0.24 * columns)
    figure = Figure(figsize=(width, rows * height), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    scale = _accuracy_scale(panels.values())
    labels = []
    for ax, (heading, accuracy) in zip(axes.flat, panels.items(), strict=False):
        _cells(ax, edges, accuracy, scale)
        _name_axes(ax, heading, budgets, ratios)
        if trained_at is not None and trained_at in budgets:
            _frame_column(ax, edges, list(budgets).index(trained_at), len(ratios))
        texts = [[_short(value) for value in row] for row in accuracy]
        labels += _cell_labels(ax, edges, accuracy, texts, scale)
    for ax in list(axes.flat)[len(panels) :]:
        ax.remove()
    framed = "; framed: training" if trained_at in budgets else ""
    figure.supxlabel(f"budget Φ of the test (photons){framed}", fontsize=9)
    figure.supylabel("compression ratio m/N", fontsize=9)
    _bar(figure, figure.axes, scale, style.ACCURACY_AXIS)
    _keep_if_they_fit(figure, labels, edges)
    return figure


def _cells(ax: Axes, edges: np.ndarray, values: np.ndarray, scale: _Scale) -> None:
    """Draw a cell for each value, blank where there is none."""
    ax.pcolormesh(
        edges,
        np.arange(len(values) + 1),
        np.ma.masked_invalid(values),
        cmap=scale.colours,
        norm=scale.norm,
        edgecolors=style.PAPER,
        linewidth=0.4,
    )
    ax.spines[:].set_visible(False)
    ax.tick_params(length=0, labelsize=style.SMALL)


def _name_axes(ax: Axes, heading: str, budgets: Sequence[float], ratios: Sequence[float]) -> None:
    """Write the heading of a panel, and budgets and ratios at the edges of the figure."""
    ax.set_title(heading)
    ax.xaxis.set_major_locator(
        FixedLocator([math.log10(value) for value in scales.thinned(budgets)])
    )
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: scales.power_text(10**value)))
    ax.set_yticks(np.arange(len(ratios)) + 0.5, [_percent(ratio) for ratio in ratios])
    ax.label_outer()


def _bar(figure: Figure, axes: Iterable[Axes], scale: _Scale, label: str) -> None:
    """Draw the colour bar of some panels at their right."""
    colours = ScalarMappable(*scale)
    style.plain_bar(figure.colorbar(colours, ax=list(axes), label=label, aspect=30, pad=0.02))


def _frame_column(ax: Axes, edges: np.ndarray, column: int, rows: int) -> None:
    """Frame one column of cells, dark on light ink."""
    corner, wide = (edges[column], 0), edges[column + 1] - edges[column]
    for colour, width in ((scales.ON_DARK, 3.0), (scales.ON_LIGHT, 1.3)):
        frame = Rectangle(corner, wide, rows, fill=False, clip_on=False, zorder=4)
        frame.set(edgecolor=colour, linewidth=width)
        ax.add_patch(frame)


@style.styled
def difference_figure(pair: "Pair", names: tuple[str, str]) -> Figure:
    """Accuracies of two tests as heat maps, and the second less the first.

    A difference that is larger than its 95 % interval stands in its cell, in hundredths.
    """
    edges = _edges(np.log10(pair.budgets))
    height = 0.9 + max(1.0, 0.24 * len(pair.ratios))
    figure = Figure(figsize=(style.PAGE_WIDTH, height), layout="constrained")
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    difference = pair.second - pair.first
    reach = max(LEAST_REACH, np.nanmax(np.abs(difference), initial=0.0))
    scale = _accuracy_scale((pair.first, pair.second))
    signed = _Scale(Normalize(-reach, reach), style.DIVERGING)
    for ax, heading, values in zip(axes, names, (pair.first, pair.second), strict=False):
        _cells(ax, edges, values, scale)
        _name_axes(ax, heading, pair.budgets, pair.ratios)
    _cells(axes[2], edges, difference, signed)
    _name_axes(axes[2], "difference", pair.budgets, pair.ratios)
    texts = [[*map(_hundredths, *row)] for row in zip(difference, pair.apart, strict=True)]
    labels = _cell_labels(axes[2], edges, difference, texts, signed)
    figure.supxlabel("budget Φ (photons); hundredths: beyond the 95 % interval", fontsize=9)
    figure.supylabel("compression ratio m/N", fontsize=9)
    _bar(figure, axes[:2], scale, style.ACCURACY_AXIS)
    _bar(figure, axes[2:], signed, f"{names[1]} − {names[0]}")
    _keep_if_they_fit(figure, labels, edges)
    return figure


@dataclass(frozen=True)
class Pair:
    """Accuracies (ratios, budgets) of two tests, and their differences by (ratio, budget)."""

    budgets: list[float]
    ratios: list[float]
    first: np.ndarray
    second: np.ndarray
    differences: dict[tuple[float, float], Difference]

    @property
    def largest(self) -> tuple[Difference, str]:
        """The largest difference, and where it is."""
        ratio, budget = max(self.differences, key=lambda place: abs(self.differences[place].mean))
        where = f"{ratio:.0%} and {style.photons_text(budget)} photons"
        return self.differences[(ratio, budget)], where

    @property
    def apart(self) -> np.ndarray:
        """Where (ratios, budgets) the difference is larger than its interval."""
        return np.array(
            [
                [
                    (each := self.differences[(ratio, budget)]).low > 0 or each.high < 0
                    for budget in self.budgets
                ]
                for ratio in self.ratios
            ]
        )


def pair(one: Sequence[Point], other: Sequence[Point]) -> Pair:
    """Two tests at the same ratios and budgets: the second less the first."""
    lights = sorted({point.photons for point in one})
    ratios = sorted({point.ratio for point in one})
    there = {(point.ratio, point.photons): point for point in one}
    return Pair(
        lights,
        ratios,
        accuracy_grid(one, lights, ratios),
        accuracy_grid(other, lights, ratios),
        {
            (point.ratio, point.photons): accuracy_difference(
                point, there[(point.ratio, point.photons)]
            )
            for point in other
        },
    )


def _percent(ratio: float) -> str:
    return f"{100 * ratio:.0f} %" if ratio >= 0.0095 else f"{100 * ratio:.2g} %"


def _edges(centres: np.ndarray) -> np.ndarray:
    """Edges of cells about rising centres: half-way between them, and as far beyond the ends."""
    if len(centres) == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middles = (centres[1:] + centres[:-1]) / 2
    return np.array([2 * centres[0] - middles[0], *middles, 2 * centres[-1] - middles[-1]])


def _accuracy_scale(grids: Iterable[np.ndarray]) -> _Scale:
    """Scale from the tenth below the lowest accuracy, at most 0.9, to 1."""
    values = np.concatenate([np.asarray(grid, dtype=float).ravel() for grid in grids])
    known = values[np.isfinite(values)]
    low = math.floor(10 * known.min() + 1e-9) / 10 if known.size else 0.0
    return _Scale(Normalize(min(low, 0.9), 1.0), scales.SEQUENTIAL)


def _short(value: float) -> str:
    """An accuracy in a cell, a dash where there is none."""
    return f"{value:.2f}".removeprefix("0") if np.isfinite(value) else "–"


def _hundredths(value: float, is_clear: bool) -> str:
    """A difference in a cell, if it is larger than its interval."""
    return f"{100 * value:+.0f}".replace("-", "−") if is_clear else ""


def _cell_labels(
    ax: Axes,
    edges: np.ndarray,
    values: np.ndarray,
    texts: Sequence[Sequence[str]],
    scale: _Scale,
) -> list[Text]:
    """Write texts into the cells of values, in an ink that can be read there."""
    labels = []
    for (row, column), value in np.ndenumerate(values):
        ink = style.MUTED
        if np.isfinite(value):
            ink = scales.readable_ink(scale.colours, scale.norm(value))
        labels.append(
            ax.text(
                (edges[column] + edges[column + 1]) / 2,
                row + 0.5,
                texts[row][column],
                color=ink,
                fontsize=6.5,
                horizontalalignment="center",
                verticalalignment="center_baseline",
            )
        )
    return labels


def _keep_if_they_fit(figure: Figure, labels: list[Text], edges: np.ndarray) -> None:
    """Take all labels of cells away where the narrowest cell cannot hold the widest."""
    figure.draw_without_rendering()
    ax = labels[0].axes
    assert ax is not None, "labels are drawn in axes"
    ends = ax.transData.transform([(edge, row) for row, edge in enumerate(edges)])
    narrowest = np.diff(ends[:, 0]).min()
    lowest = np.diff(ends[:, 1]).min()
    boxes = [label.get_window_extent() for label in labels]
    if max(b.width for b in boxes) > 0.96 * narrowest or max(b.height for b in boxes) > lowest:
        for label in labels:
            label.remove()

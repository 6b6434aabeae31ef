"""Accuracy over photon budget and compression ratio: heat maps and contour maps."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import BoundaryNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, FuncFormatter

from deepfsi.base.numeric.intervals import Difference, accuracy_difference
from deepfsi.report import style
from deepfsi.sweeps.results import Point
from deepfsi_paper.report import scales

DRAWN = 0.01
"""Smallest largest difference of two accuracies that is drawn in a panel of its own."""

WIDE = 6.0
"""Inches of a figure below whose panels two keys stand side by side."""

_DIM = (
    Line2D([], [], color=style.MUTED, linestyle=(0, (4, 2)), linewidth=1.4),
    "0.1 photons per pixel and measurement; fewer above and left of it",
)


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
    norm = _accuracy_range(panels.values())
    labels = []
    for ax, (heading, accuracy) in zip(axes.flat, panels.items(), strict=False):
        _cells(ax, edges, accuracy, norm)
        ax.set_title(heading)
        _budget_ticks(ax, budgets)
        ax.set_yticks(np.arange(len(ratios)) + 0.5, [_percent(ratio) for ratio in ratios])
        ax.label_outer()
        if trained_at is not None and trained_at in budgets:
            _frame_column(ax, edges, list(budgets).index(trained_at), len(ratios))
        labels += _cell_labels(ax, edges, accuracy, norm)
    for ax in list(axes.flat)[len(panels) :]:
        ax.remove()
    framed = "; framed: training" if trained_at in budgets else ""
    figure.supxlabel(f"budget Φ of the test (photons){framed}", fontsize=9)
    figure.supylabel("compression ratio m/N", fontsize=9)
    bar = figure.colorbar(
        ScalarMappable(norm, scales.SEQUENTIAL),
        ax=list(figure.axes),
        label=style.ACCURACY_AXIS,
        aspect=30,
        pad=0.02,
    )
    style.plain_bar(bar)
    _keep_if_they_fit(figure, labels, edges)
    return figure


def _cells(ax: Axes, edges: np.ndarray, accuracy: np.ndarray, norm: Normalize) -> None:
    """Draw a cell for each accuracy, blank where there is none."""
    ax.pcolormesh(
        edges,
        np.arange(len(accuracy) + 1),
        np.ma.masked_invalid(accuracy),
        cmap=scales.SEQUENTIAL,
        norm=norm,
        edgecolors=style.PAPER,
        linewidth=0.4,
    )
    ax.spines[:].set_visible(False)
    ax.tick_params(length=0, labelsize=style.SMALL)


def _frame_column(ax: Axes, edges: np.ndarray, column: int, rows: int) -> None:
    """Frame one column of cells, dark on light ink."""
    corner, wide = (edges[column], 0), edges[column + 1] - edges[column]
    for colour, width in ((scales.ON_DARK, 3.0), (scales.ON_LIGHT, 1.3)):
        frame = Rectangle(corner, wide, rows, fill=False, clip_on=False, zorder=4)
        frame.set(edgecolor=colour, linewidth=width)
        ax.add_patch(frame)


@style.styled
def contour_figure(
    first: np.ndarray,
    second: np.ndarray,
    budgets: Sequence[float],
    ratios: Sequence[float],
    names: tuple[str, str],
    *,
    pixels: int | None = None,
    apart: np.ndarray | None = None,
) -> Figure:
    """Two accuracies as contour maps over budget and compression ratio, and their difference.

    Contours are interpolated between the grid's points on logarithmic axes; a grid of one row or
    column has points only.

    The accuracies share one scale; the difference, second minus first, has one that is
    symmetric about 0. Where no difference reaches `DRAWN`, words take the place of its panel.

    Shapes: first, second (len(ratios), len(budgets)); apart (len(ratios), len(budgets)).
    """
    difference = second - first
    largest = np.nanmax(np.abs(difference), initial=0.0)
    drawn = 2 + (largest >= DRAWN)
    figure = Figure(figsize=(0.6 + 2.2 * drawn, 3.1), layout="constrained")
    axes = figure.subplots(1, drawn, sharex=True, sharey=True)
    for ax in axes:
        _logarithmic(ax, budgets, ratios)
    axes[0].set_ylabel("compression ratio m/N")
    x, y = np.log10(budgets), np.log10(ratios)
    _accuracy_panels(axes[:2], x, y, dict(zip(names, (first, second), strict=True)))
    keys = [_DIM] if pixels and _dim_lines(axes, pixels) else []
    if drawn == 3:
        keys += _difference_panel(axes[2], x, y, difference, apart, f"{names[1]}\n− {names[0]}")
    else:
        words = f"{names[1]} − {names[0]}: no difference above {_rounded_up(largest)} anywhere"
        keys.append((Line2D([], [], linestyle="none"), words))
    _name_keys(figure, keys)
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

    def figure(self, names: tuple[str, str], pixels: int | None = None) -> Figure:
        """Contour maps of both accuracies and of their difference; see `contour_figure`."""
        return contour_figure(
            self.first,
            self.second,
            self.budgets,
            self.ratios,
            names,
            pixels=pixels,
            apart=self.apart,
        )

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


def _accuracy_panels(
    axes: np.ndarray, x: np.ndarray, y: np.ndarray, panels: Mapping[str, np.ndarray]
) -> None:
    """Draw accuracies by heading, in log10 coordinates, on one scale."""
    norm = _accuracy_range(panels.values())
    levels = [*(k / 10 for k in range(round(10 * float(norm.vmin or 0)), 10)), 0.95, 1.0]
    steps = BoundaryNorm(levels, 256)
    for ax, (heading, values) in zip(axes, panels.items(), strict=True):
        _contours(ax, x, y, values, steps, scales.SEQUENTIAL)
        _dots(ax, x, y, values, np.isfinite(values), "o", steps, scales.SEQUENTIAL)
        ax.set_title(heading)
    bar, ticks = _bar_beside(axes, steps, scales.SEQUENTIAL, style.ACCURACY_AXIS), levels[::-2]
    bar.set_ticks(ticks, labels=[f"{level:g}" for level in ticks])


def _rounded_up(value: float) -> str:
    """A small difference with one digit, not below itself."""
    return f"{math.ceil(1000 * value) / 1000:.3f}"


def _name_keys(figure: Figure, keys: Sequence[tuple[Line2D, str]]) -> None:
    """Say below the panels what their markers and lines are."""
    if keys:
        lines, words = zip(*keys, strict=True)
        columns = 2 if figure.get_figwidth() > WIDE else 1
        figure.legend(
            lines, words, loc="outside lower center", ncols=columns, frameon=False, fontsize=8,
            handlelength=2, columnspacing=1.4,
        )  # fmt: skip


def _difference_panel(
    ax: Axes,
    x: np.ndarray,
    y: np.ndarray,
    values: np.ndarray,
    apart: np.ndarray | None,
    label: str,
) -> list[tuple[Line2D, str]]:
    """Draw differences, as triangles where they are clear, in log10 coordinates.

    Returns what its markers mean.
    """
    steps = difference_levels(values)
    norm, middles = BoundaryNorm(steps, 256), (steps[1:] + steps[:-1]) / 2
    _contours(ax, x, y, values, norm, style.DIVERGING)
    clear = np.zeros(values.shape, dtype=bool) if apart is None else np.asarray(apart)
    up, down = clear & (values > 0), clear & (values < 0)
    same = np.isfinite(values) & ~up & ~down
    ax.set_title("difference")
    keys = []
    for marker, where, words in (
        ("o", same, "difference within its 95 % interval" if clear.any() else ""),
        ("^", up, "higher, beyond that interval"),
        ("v", down, "lower, beyond that interval"),
    ):
        _dots(ax, x, y, values, where, marker, norm, style.DIVERGING)
        if where.any() and words:
            look = Line2D([], [], linestyle="none", marker=marker, color=style.PAPER)
            look.set(markeredgecolor=style.INK, markersize=5.5)
            keys.append((look, words))
    bar = _bar_beside(np.array([ax]), norm, style.DIVERGING, label)
    bar.set_ticks(middles, labels=[scales.signed_text(value) for value in middles])
    return keys


def _logarithmic(ax: Axes, budgets: Sequence[float], ratios: Sequence[float]) -> None:
    """Limits and ticks of axes of log10 budget and log10 ratio."""
    x, y = np.log10(budgets), np.log10(ratios)
    ax.set_xlim(x[0] - 0.06 * max(np.ptp(x), 1), x[-1] + 0.06 * max(np.ptp(x), 1))
    ax.set_ylim(y[0] - 0.06 * max(np.ptp(y), 1), y[-1] + 0.06 * max(np.ptp(y), 1))
    _budget_ticks(ax, budgets)
    ax.yaxis.set_major_locator(FixedLocator([math.log10(r) for r in _ratio_ticks(ratios)]))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: _percent(10**value)))
    ax.tick_params(labelsize=style.SMALL)
    ax.set_xlabel("budget Φ (photons)")


def _bar_beside(axes: np.ndarray, norm: BoundaryNorm, colours: str, label: str) -> Colorbar:
    """Draw the colour bar of some panels at their right."""
    bar = axes[0].figure.colorbar(
        ScalarMappable(norm, colours),
        ax=list(axes),
        label=label,
        spacing="proportional",
        location="right",
        aspect=22,
        pad=0.02,
    )
    style.plain_bar(bar)
    return bar


def _percent(ratio: float) -> str:
    return f"{100 * ratio:.0f} %" if ratio >= 0.0095 else f"{100 * ratio:.2g} %"


def _edges(centres: np.ndarray) -> np.ndarray:
    """Edges of cells about rising centres: half-way between them, and as far beyond the ends."""
    if len(centres) == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middles = (centres[1:] + centres[:-1]) / 2
    return np.array([2 * centres[0] - middles[0], *middles, 2 * centres[-1] - middles[-1]])


def _accuracy_range(grids: Iterable[np.ndarray]) -> Normalize:
    """Scale from the tenth below the lowest accuracy, at most 0.9, to 1."""
    values = np.concatenate([np.asarray(grid, dtype=float).ravel() for grid in grids])
    known = values[np.isfinite(values)]
    low = math.floor(10 * known.min() + 1e-9) / 10 if known.size else 0.0
    return Normalize(min(low, 0.9), 1.0)


def difference_levels(difference: np.ndarray) -> np.ndarray:
    """Levels at ±½, ±1½, … steps, so that the middle colour means none; steps of 0.005 or more.

    Differences of a thousandth would otherwise look as large as those of a tenth.
    """
    known = np.abs(difference[np.isfinite(difference)])
    largest = known.max(initial=0.0)
    steps = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
    step = next(step for step in steps if largest <= 4.5 * step)
    reach = max(2, math.ceil(largest / step - 0.5))
    return step * (np.arange(-reach, reach + 2) - 0.5)


def _cell_labels(ax: Axes, edges: np.ndarray, accuracy: np.ndarray, norm: Normalize) -> list[Text]:
    """Write each value into its cell, a dash where there is none."""
    texts = []
    for (row, column), value in np.ndenumerate(accuracy):
        known = np.isfinite(value)
        texts.append(
            ax.text(
                (edges[column] + edges[column + 1]) / 2,
                row + 0.5,
                f"{value:.2f}".removeprefix("0") if known else "–",
                color=scales.readable_ink(scales.SEQUENTIAL, norm(value)) if known else style.MUTED,
                fontsize=6.5,
                horizontalalignment="center",
                verticalalignment="center_baseline",
            )
        )
    return texts


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


def _contours(
    ax: Axes, x: np.ndarray, y: np.ndarray, values: np.ndarray, norm: BoundaryNorm, colours: str
) -> None:
    """Fill between contour lines where the grid has two rows and columns, in log10 coordinates."""
    if min(values.shape) < 2 or not np.isfinite(values).any():
        return
    known = np.ma.masked_invalid(values)
    ax.contourf(x, y, known, levels=norm.boundaries, norm=norm, cmap=colours)
    ax.contour(
        x, y, known, levels=norm.boundaries, colors=scales.ON_LIGHT, linewidths=0.4, linestyles="-"
    )


def _dots(
    ax: Axes,
    x: np.ndarray,
    y: np.ndarray,
    values: np.ndarray,
    where: np.ndarray,
    marker: str,
    norm: BoundaryNorm,
    colours: str,
) -> None:
    """Mark points of the grid, filled with the colour of their value."""
    across, up = np.meshgrid(x, y)
    ax.scatter(
        across[where],
        up[where],
        c=values[where],
        norm=norm,
        cmap=colours,
        marker=marker,
        s=13 if marker == "o" else 26,
        edgecolors=scales.ON_LIGHT,
        linewidths=0.6,
        zorder=4,
    )


def _dim_lines(axes: Iterable[Axes], pixels: int) -> bool:
    """Line of 0.1 photons per pixel and measurement: Φ = 0.1 N m = 0.1 N² · m/N, in log10.

    Returns whether it crosses the panels.
    """
    offset = math.log10(0.1 * pixels**2)
    for ax in axes:
        (left, right), ratios = ax.get_xlim(), ax.get_ylim()
        budgets = [ratio + offset for ratio in ratios]
        if budgets[0] > right or budgets[1] < left:
            return False
        for colour, width, dashes in (
            (scales.ON_DARK, 3.0, "-"),
            (scales.ON_LIGHT, 1.3, (0, (4, 2))),
        ):
            (line,) = ax.plot(budgets, ratios, color=colour, scalex=False, scaley=False, zorder=3)
            line.set(linewidth=width, linestyle=dashes)
    return True


def _ratio_ticks(ratios: Sequence[float]) -> list[float]:
    """Ratios that stand a readable way apart on a logarithmic axis, the largest among them."""
    room = (math.log10(ratios[-1] / ratios[0]) or 1.0) / 10
    kept: list[float] = []
    for ratio in reversed(ratios):
        if not kept or math.log10(kept[-1] / ratio) >= room:
            kept.append(ratio)
    return kept[::-1]


def _budget_ticks(ax: Axes, budgets: Sequence[float]) -> None:
    """Ticks at budgets, on an axis of log10 photons."""
    ax.xaxis.set_major_locator(
        FixedLocator([math.log10(value) for value in scales.thinned(budgets)])
    )
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: scales.power_text(10**value)))

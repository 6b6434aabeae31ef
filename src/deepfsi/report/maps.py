"""Figures of the paper's study on MNIST: noise axis, compression, masks, and what changes them.

Like `figures`, each function returns a `matplotlib.figure.Figure` for `figures.svg` or a file.
Colours on top of a colour map are not the page's own, which change with light and dark.
"""

import itertools
import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import BoundaryNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from deepfsi.errors import InputError
from deepfsi.optics.budget import impulse_imaging_error
from deepfsi.report.figures import (
    COLOURS,
    DIVERGING,
    INK,
    LINES,
    MUTED,
    PANEL_HEIGHT,
    PAPER,
    Point,
    Results,
    accuracy_axes,
    brightest,
    mask_axes,
    noise_text,
    noises,
    peak,
    photons_text,
    series_axes,
    signed,
    styled,
)

PAGE_WIDTH = 7.2  # inches, of a printed page's text
SMALL = 7.5  # points
ON_LIGHT, ON_DARK = "#101010", "#fefefe"  # ink on colour maps
SEQUENTIAL = "cividis"
GREYS = "gray"
AXIS_NOISES: tuple[Literal["gaussian", "poisson"], ...] = ("gaussian", "poisson")
LOOKS: dict[str, dict[str, Any]] = {
    "gaussian": {"color": COLOURS["pca"], "marker": "s", "linestyle": (0, (5, 1.6))},
    "poisson": {"color": COLOURS["deepfsi"], "marker": "o", "linestyle": "-"},
}
PLAIN: tuple[dict[str, Any], ...] = (
    {"color": INK, "marker": "D", "linestyle": "-"},
    {"color": MUTED, "marker": "", "linestyle": (0, (1, 1))},
    {"color": COLOURS["truncated-hadamard"], "marker": "^", "linestyle": (0, (3, 1.6))},
)


@styled
def error_figure(results: Results) -> Figure:
    """Accuracy against the impulse-imaging error, on which both noises can be compared.

    Parameters
    ----------
    results : mapping
        Content of a `results.json`; each design at its chosen mask count is drawn.

    Returns
    -------
    Figure
        A panel for gaussian and one for photon noise, as far as they were tested, with the same
        axes. Less noise is on the right, as in figures against the budget. Bars are the points'
        intervals; circles are feature-specific designs, squares others.

    Raises
    ------
    InputError
        If neither noise was tested.
    """
    data, sigma = results["data"], results["recipe"]["sigma"]
    pixels = math.prod(data["image_shape"])
    panels = [noise for noise in AXIS_NOISES if noise in noises(results)]
    if not panels:
        raise InputError(
            f"no impulse-imaging error for {', '.join(noises(results))}: give results of tests "
            "under gaussian or poisson noise"
        )
    points: dict[str, list[Point]] = {
        noise: [
            {
                **(point if isinstance(point, dict) else vars(point)),
                "error": impulse_imaging_error(
                    point["photons"], data["mean_reflectance"], pixels, noise, sigma
                ),
            }
            for point in results["points"]
            if point["noise"] == noise and point["best"]
        ]
        for noise in panels
    }
    errors = {point["error"] for members in points.values() for point in members}
    figure = Figure(figsize=(4.2 * len(panels), PANEL_HEIGHT), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False, sharex=True, sharey=True)[0]
    for ax, noise in zip(axes, panels, strict=True):
        accuracy_axes(
            ax,
            results,
            points[noise],
            series_axes(results),
            "error",
            values=errors,
            falling=True,
        )
        ax.set_title(noise_text(noise))
        ax.label_outer()
        ax.xaxis.set_major_locator(LogLocator(numticks=8))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: power_text(value)))
    gap = "; " if len(panels) > 1 else "\n"
    label = f"impulse-imaging reconstruction error (RMSE, reflectance){gap}less noise →"
    figure.supxlabel(label, fontsize=9)
    return figure


def accuracy_grid(
    points: Iterable[Point], budgets: Sequence[float], ratios: Sequence[float]
) -> np.ndarray:
    """Accuracy of one design's points by compression ratio and budget.

    Parameters
    ----------
    points : iterable of mapping
        Points of a `results.json` that differ in `ratio` and `photons` only.
    budgets : sequence of float
        Photons.
    ratios : sequence of float
        m / N, as in the points.

    Returns
    -------
    array, shape (len(ratios), len(budgets))
        NaN where there is no point.

    Raises
    ------
    ValueError
        If two points have the same place.
    """
    grid = np.full((len(ratios), len(budgets)), np.nan)
    for point in points:
        if point["ratio"] in ratios and point["photons"] in budgets:
            place = ratios.index(point["ratio"]), budgets.index(point["photons"])
            if not np.isnan(grid[place]):
                raise ValueError(f"two points at {point['photons']} photons, {place[0]}th ratio")
            grid[place] = point["accuracy"]
    return grid


@styled
def heat_figure(
    panels: Mapping[str, np.ndarray],
    budgets: Sequence[float],
    ratios: Sequence[float],
    trained_at: float | None = None,
) -> Figure:
    """Accuracy by photon budget and compression ratio, a heat map for each design.

    Parameters
    ----------
    panels : mapping of str to array, shape (len(ratios), len(budgets))
        Heading → accuracy, 0 to 1; NaN where it is missing.
    budgets : sequence of float
        Budgets of the tests, photons, rising.
    ratios : sequence of float
        m / N, rising; drawn as categories.
    trained_at : float, optional
        Budget of the training, photons; its column is framed.

    Returns
    -------
    Figure
        All panels share one colour scale. Values stand in the cells where they fit.
    """
    edges = _edges(np.log10(budgets))
    columns = 2 if len(panels) == 4 else min(3, len(panels))
    rows = -(-len(panels) // columns)
    height = 0.9 + max(1.0, 0.24 * len(ratios))
    width = PAGE_WIDTH * (0.28 + 0.24 * columns)
    figure = Figure(figsize=(width, rows * height), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    norm = _accuracy_range(panels.values())
    labels = []
    for ax, (heading, accuracy) in zip(axes.flat, panels.items(), strict=False):
        ax.pcolormesh(
            edges,
            np.arange(len(ratios) + 1),
            np.ma.masked_invalid(accuracy),
            cmap=SEQUENTIAL,
            norm=norm,
            edgecolors=PAPER,
            linewidth=0.4,
        )
        ax.set_title(heading)
        ax.spines[:].set_visible(False)
        ax.tick_params(length=0, labelsize=SMALL)
        _budget_ticks(ax, budgets)
        ax.set_yticks(np.arange(len(ratios)) + 0.5, [_percent(ratio) for ratio in ratios])
        ax.label_outer()
        if trained_at is not None and trained_at in budgets:
            column = list(budgets).index(trained_at)
            corner, wide = (edges[column], 0), edges[column + 1] - edges[column]
            for colour, width in ((ON_DARK, 3.0), (ON_LIGHT, 1.3)):
                frame = Rectangle(corner, wide, len(ratios), fill=False, clip_on=False, zorder=4)
                frame.set(edgecolor=colour, linewidth=width)
                ax.add_patch(frame)
        labels += _cell_labels(ax, edges, accuracy, norm)
    for ax in list(axes.flat)[len(panels) :]:
        ax.remove()
    framed = "; framed: of the training" if trained_at in budgets else ""
    figure.supxlabel(f"photon budget Φ of the test{framed}", fontsize=9)
    figure.supylabel("compression ratio m/N", fontsize=9)
    bar = figure.colorbar(
        ScalarMappable(norm, SEQUENTIAL),
        ax=list(figure.axes),
        label="accuracy",
        aspect=30,
        pad=0.02,
    )
    plain_bar(bar)
    _keep_if_they_fit(figure, labels, edges)
    return figure


@styled
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

    Parameters
    ----------
    first, second : array, shape (len(ratios), len(budgets))
        Accuracy, 0 to 1; NaN where it is missing.
    budgets : sequence of float
        Photons, rising.
    ratios : sequence of float
        m / N, rising.
    names : tuple of str
        Headings of the two accuracies.
    pixels : int, optional
        N; with it a line is drawn where Φ / (N m) is 0.1 photons per pixel and measurement.
    apart : array of bool, shape (len(ratios), len(budgets)), optional
        Where the difference is larger than its uncertainty. These points are triangles that point
        up where the second is higher and down where it is lower.

    Returns
    -------
    Figure
        The accuracies share one scale; the difference, second minus first, has one that is
        symmetric about 0.
    """
    difference = second - first
    norm, top = _accuracy_range((first, second)), _difference_levels(difference)
    low = round(10 * float(norm.vmin or 0))
    levels = [*(k / 10 for k in range(low, 10)), 0.95, 1.0]
    accuracy_norm = BoundaryNorm(levels, 256)
    difference_norm = BoundaryNorm(top, 256)
    figure = Figure(figsize=(PAGE_WIDTH, 2.9), layout="constrained")
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    x, y = np.log10(budgets), np.log10(ratios)
    for ax, values, heading in zip(axes, (first, second), names, strict=False):
        _contours(ax, x, y, values, accuracy_norm, SEQUENTIAL)
        _dots(ax, x, y, values, np.isfinite(values), "o", accuracy_norm, SEQUENTIAL)
        ax.set_title(heading)
    ax = axes[2]
    _contours(ax, x, y, difference, difference_norm, DIVERGING)
    clear = np.zeros(difference.shape, dtype=bool) if apart is None else np.asarray(apart)
    up, down = clear & (difference > 0), clear & (difference < 0)
    same = np.isfinite(difference) & ~up & ~down
    for marker, where in (("o", same), ("^", up), ("v", down)):
        _dots(ax, x, y, difference, where, marker, difference_norm, DIVERGING)
    ax.set_title("difference")
    for ax in axes:
        ax.set_xlim(x[0] - 0.06 * max(np.ptp(x), 1), x[-1] + 0.06 * max(np.ptp(x), 1))
        ax.set_ylim(y[0] - 0.06 * max(np.ptp(y), 1), y[-1] + 0.06 * max(np.ptp(y), 1))
        _budget_ticks(ax, budgets)
        ax.yaxis.set_major_locator(FixedLocator([math.log10(r) for r in _ratio_ticks(ratios)]))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: _percent(10**value)))
        ax.tick_params(labelsize=SMALL)
        ax.set_xlabel("photon budget Φ")
    if pixels and _dim_lines(axes, pixels):
        key = Line2D([], [], color=MUTED, linestyle=(0, (4, 2)), linewidth=1.4)
        words = "0.1 photons per pixel and measurement; fewer above and left of it"
        figure.legend(
            [key], [words], loc="outside lower center", frameon=False, fontsize=8, handlelength=3
        )
    axes[0].set_ylabel("compression ratio m/N")
    beside: dict[str, Any] = {"location": "right", "aspect": 22, "pad": 0.02}
    middles = (top[1:] + top[:-1]) / 2
    for scale, colours, label, panels, ticks, text in (
        (accuracy_norm, SEQUENTIAL, "accuracy", axes[:2], levels[::-2], "{:g}".format),
        (difference_norm, DIVERGING, f"{names[1]}\n− {names[0]}", axes[2:], middles, _signed_text),
    ):
        bar = figure.colorbar(
            ScalarMappable(scale, colours),
            ax=list(panels),
            label=label,
            spacing="proportional",
            **beside,
        )
        plain_bar(bar)
        bar.set_ticks(ticks, labels=[text(value) for value in ticks])
    return figure


@styled
def masks_table_figure(rows: Sequence[Point], count: int = 6) -> Figure:
    """Masks learned under both noises, and the distributions of their values, by photon budget.

    Parameters
    ----------
    rows : sequence of mapping
        `photons`, the budget; `image_shape`, two sides; and `gaussian` and `poisson`, the masks
        under each noise, array of shape (m, N) or rails (2 or 1, m, N).
    count : int
        Masks of each to show at most, those that count most photons first.

    Returns
    -------
    Figure
        A row for each budget. Black is −peak, mid-grey 0 and white peak, as in the paper; the
        peak, the largest |M_ij| of that budget and noise, stands below. Distributions are over
        the values in parts of the peak, on a log scale.
    """
    height, width = rows[0]["image_shape"]
    tile, gap, head, foot = 0.7, 0.05, 0.25, 0.6  # inches, as all that follows
    across, down = 3, -(-count // 3)
    tall, block = tile * height / width, across * (tile + gap) + 0.1
    row_height = down * (tall + gap) + 0.23
    total = head + row_height * len(rows) + foot
    figure = Figure(figsize=(PAGE_WIDTH, total))
    floor = 0.5 / max(signed(row[noise]).size for row in rows for noise in AXIS_NOISES)

    def at(left: float, bottom: float, wide: float, high: float) -> Axes:
        page = (PAGE_WIDTH, total, PAGE_WIDTH, total)
        return figure.add_axes(tuple(np.divide((left, bottom, wide, high), page)))

    for place, row in enumerate(rows):
        top = total - head - place * row_height
        bottom = top - down * (tall + gap) + gap
        name = figure.text(0.12 / PAGE_WIDTH, (top + bottom) / 2 / total, "", fontweight="bold")
        name.set(text=f"{power_text(row['photons'])} photons", rotation=90)
        name.set(horizontalalignment="center", verticalalignment="center")
        for noise, left in zip(AXIS_NOISES, (0.27, 0.27 + block), strict=True):
            matrix = signed(row[noise])
            end = peak(matrix)
            for spot, index in enumerate(brightest(row[noise], count)):
                below, right = divmod(spot, across)
                corner = left + right * (tile + gap), top - below * (tall + gap) - tall
                ax = at(*corner, tile, tall)
                mask_axes(ax, matrix[index].reshape(height, width), end, GREYS)
                if place == spot == 0:
                    ax.set_title(noise_text(noise))
            words = figure.text(left / PAGE_WIDTH, (bottom - 0.04) / total, f"peak {end:.2g}")
            words.set(fontsize=8, verticalalignment="top")
        left = 0.27 + 2 * block + 0.5
        ax = at(left, bottom, PAGE_WIDTH - left - 0.15, top - bottom)
        _value_shares(ax, row, floor)
        ax.tick_params(labelsize=SMALL, labelbottom=place == len(rows) - 1)
        if place == 0:
            ax.set_title("distribution of values")
    ax.set_xlabel("Mᵢⱼ / peak")
    figure.legend(
        *ax.get_legend_handles_labels(),
        loc="lower right",
        ncols=2,
        frameon=False,
        fontsize=SMALL,
        handlelength=2.2,
        columnspacing=1.0,
    )
    bar = figure.colorbar(
        ScalarMappable(Normalize(-1, 1), GREYS),
        cax=at(0.7, 0.36, 3.0, 0.1),
        orientation="horizontal",
    )
    bar.set_ticks([-1, 0, 1], labels=["−peak", "0", "peak"])
    plain_bar(bar)
    return figure


@styled
def patch_masks_figure(rows: Sequence[Point]) -> Figure:
    """All masks of image patches, a panel for each budget.

    Parameters
    ----------
    rows : sequence of mapping
        `photons`, the budget; `side` of a patch; and `matrix`, array (m, side²).

    Returns
    -------
    Figure
        Masks that count most photons come first, row by row. Black is −peak, mid-grey 0 and white
        peak; the peak, the largest |M_ij| of that budget, stands below.
    """
    width = PAGE_WIDTH / max(len(rows), 3)
    figure = Figure(figsize=(width * len(rows), width + 0.5), layout="constrained")
    panels = figure.subplots(1, len(rows), squeeze=False)[0]
    for ax, row in zip(panels, rows, strict=True):
        matrix, side = signed(row["matrix"]), row["side"]
        across = math.ceil(math.sqrt(len(matrix)))
        down = -(-len(matrix) // across)
        sheet = np.full((down * (side + 1) - 1, across * (side + 1) - 1), np.nan)
        for place, index in enumerate(brightest(matrix, len(matrix))):
            y, x = (part * (side + 1) for part in divmod(place, across))
            sheet[y : y + side, x : x + side] = matrix[index].reshape(side, side)
        end = peak(matrix)
        mask_axes(ax, sheet, end, GREYS)
        ax.spines[:].set_visible(False)
        ax.set_title(f"{power_text(row['photons'])} photons")
        ax.set_xlabel(f"peak {end:.2g}", fontsize=8)
    return figure


@styled
def measures_figure(rows: Sequence[Point]) -> Figure:
    """Measures of learned masks against the photon budget, one small panel for each measure.

    Parameters
    ----------
    rows : sequence of mapping
        `measure`, the panel's heading; `series`, what its line shows: "gaussian", "poisson" or
        other words; `photons`; `value`, `low` and `high`, all three in the measure's own unit,
        the last two None where there is no interval.

    Returns
    -------
    Figure
        Panels and lines are in the order of their first appearance; axes begin at 0. Bars run from
        `low` to `high`.
    """
    measures = list(dict.fromkeys(row["measure"] for row in rows))
    columns = min(3, len(measures))
    lines = -(-len(measures) // columns)
    figure = Figure(figsize=(PAGE_WIDTH * columns / 3, 2.4 * lines), layout="constrained")
    axes = figure.subplots(lines, columns, squeeze=False)
    names = list(dict.fromkeys(row["series"] for row in rows))
    others = itertools.cycle(PLAIN)
    looks = {name: LOOKS.get(name) or next(others) for name in names}
    handles = {}
    for ax, measure in zip(axes.flat, measures, strict=False):
        members = [row for row in rows if row["measure"] == measure]
        for name in dict.fromkeys(row["series"] for row in members):
            own = [row for row in members if row["series"] == name]
            handles[name] = _line(ax, own, "value", looks[name])
        ax.set_title(textwrap.fill(measure, 28))
        ax.set_xlabel("photon budget Φ")
        ax.set_ylim(0, None)
        ax.grid(axis="y")
        _budget_axis(ax, [row["photons"] for row in members])
    for ax in list(axes.flat)[len(measures) :]:
        ax.remove()
    _legend(figure, {noise_text(n) if n in LOOKS else n: line for n, line in handles.items()})
    return figure


@styled
def starts_figure(results: Results) -> Figure:
    """What learned masks gain from the matrix that they start from.

    Parameters
    ----------
    results : mapping
        `data`, as in a `results.json`; `points`, its points with `start`, the name of the initial
        matrix, added; and `differences`, mappings with `noise`, `start`, `photons`, `difference`,
        `low` and `high`: accuracy less that of the start "pca" in the same trial, and its interval,
        None where there is none (one trial).

    Returns
    -------
    Figure
        A row for each noise: accuracies on the left, paired differences to pca on the right. Bars
        are the intervals.
    """
    rows = noises(results)
    figure = Figure(figsize=(PAGE_WIDTH, 2.7 * len(rows) + 0.3), layout="constrained")
    axes = figure.subplots(len(rows), 2, squeeze=False)
    starts = list(dict.fromkeys(point["start"] for point in results["points"]))
    dotted: dict[str, Any] = {"color": MUTED, "linewidth": 0.9, "linestyle": (0, (1, 1))}
    handles = {}
    for (left, right), noise in zip(axes, rows, strict=True):
        left.axhline(1 / len(results["data"]["classes"]), **dotted)
        right.axhline(0, color=COLOURS["pca"], linewidth=1.2)
        for place, start in enumerate(starts):
            look = {
                "color": COLOURS.get(start, INK),
                "linestyle": LINES.get(start, "-"),
                "marker": "os^D"[place % 4],
            }
            shift = place - (len(starts) - 1) / 2
            for ax, field, members in (
                (left, "accuracy", results["points"]),
                (right, "difference", results["differences"]),
            ):
                own = [row for row in members if (row["noise"], row["start"]) == (noise, start)]
                if own:
                    handles[start] = _line(ax, own, field, look, shift)
        left.set_ylim(0, 1)
        left.set_ylabel("accuracy")
        right.set_ylabel("accuracy less that of pca in a trial")
        right.yaxis.set_major_formatter(FuncFormatter(lambda value, _: _signed_text(value)))
        several = f"{noise_text(noise)}: " if len(rows) > 1 else ""
        left.set_title(f"{several}accuracy")
        right.set_title(f"{several}difference")
        budgets = {point["photons"] for point in results["points"] if point["noise"] == noise}
        for ax in (left, right):
            ax.grid(axis="y")
            ax.set_xlabel("photon budget Φ")
            _budget_axis(ax, budgets)
    _legend(figure, {**handles, "chance": Line2D([], [], **dotted)})
    return figure


def _legend(figure: Figure, lines: Mapping[str, Line2D]) -> None:
    """Name lines below all panels."""
    figure.legend(
        lines.values(),
        lines.keys(),
        loc="outside lower center",
        ncols=max(1, int(figure.get_figwidth() / 1.8)),
        frameon=False,
        handlelength=3,
    )


def _line(
    ax: Axes, rows: Iterable[Point], field: str, look: Mapping[str, Any], shift: float = 0
) -> Line2D:
    """Draw one line over photons with bars from `low` to `high`, `shift` steps to the right."""
    ordered = sorted(rows, key=lambda row: row["photons"])
    photons, value, low, high = (
        np.array([row[name] for row in ordered], dtype=float)
        for name in ("photons", field, "low", "high")
    )
    decades = max(1.0, math.log10(photons[-1] / photons[0]))
    bars = ax.errorbar(
        photons * 10 ** (0.012 * decades * shift),
        value,
        yerr=np.clip([value - low, high - value], 0, None),
        elinewidth=1,
        capsize=2,
        **look,
    )
    return bars.lines[0]


def _budget_axis(ax: Axes, budgets: Iterable[float]) -> None:
    """Logarithmic budget axis with a tick at each budget, or at some where there are many."""
    values = sorted(set(budgets))
    margin = 10 ** (0.07 * max(1.0, math.log10(values[-1] / values[0])))
    ax.set_xscale("log")
    ax.set_xlim(values[0] / margin, values[-1] * margin)
    ax.xaxis.set_major_locator(FixedLocator(_some(values)))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: power_text(value)))


def _some(values: Sequence[float], most: int = 7) -> list[float]:
    """Every value, or every second, third, …, so that there are at most `most`."""
    return list(values[:: -(-len(values) // most)])


def power_text(value: float) -> str:
    """A number as a power of ten if it is one, which is shorter on an axis than 1000 or 0.001."""
    exponent = round(math.log10(value))
    if not math.isclose(value, 10.0**exponent, rel_tol=1e-6):
        return photons_text(value)
    return "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _percent(ratio: float) -> str:
    return f"{100 * ratio:.0f} %" if ratio >= 0.0095 else f"{100 * ratio:.2g} %"


def _signed_text(value: float) -> str:
    """Difference with its sign, the minus as long as the plus."""
    return "0" if abs(value) < 1e-9 else f"{value:+.3g}".replace("-", "−")


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


def _difference_levels(difference: np.ndarray) -> np.ndarray:
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
                color=readable_ink(SEQUENTIAL, norm(value)) if known else MUTED,
                fontsize=6.5,
                horizontalalignment="center",
                verticalalignment="center_baseline",
            )
        )
    return texts


def readable_ink(colours: str, place: float) -> str:
    """Ink for text on a colour map, by the luminance beneath it."""
    luminance = np.dot(colormaps[colours](place)[:3], (0.2126, 0.7152, 0.0722))
    return ON_LIGHT if luminance > 0.45 else ON_DARK


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
    ax.contour(x, y, known, levels=norm.boundaries, colors=ON_LIGHT, linewidths=0.4)


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
        edgecolors=ON_LIGHT,
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
        for colour, width, dashes in ((ON_DARK, 3.0, "-"), (ON_LIGHT, 1.3, (0, (4, 2)))):
            (line,) = ax.plot(budgets, ratios, color=colour, scalex=False, scaley=False, zorder=3)
            line.set(linewidth=width, linestyle=dashes)
    return True


def _value_shares(ax: Axes, row: Point, floor: float) -> None:
    """Share of all entries per bin of M/peak, an outline for each noise; `floor` is below all."""
    for noise in AXIS_NOISES:
        values = signed(row[noise]).ravel()
        counts, edges = np.histogram(values / peak(values), bins=41, range=(-1, 1))
        look = LOOKS[noise]
        ax.stairs(
            counts / values.size,
            edges,
            baseline=floor,
            color=look["color"],
            linestyle=look["linestyle"],
            linewidth=1.2,
            label=noise_text(noise),
        )
    ax.set_yscale("log")
    ax.set_ylim(floor, 1.5)
    ax.set_xlim(-1, 1)
    ax.yaxis.set_major_locator(LogLocator(numticks=4))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: power_text(value)))
    ax.set_ylabel("share of entries", fontsize=8)


def plain_bar(bar: Colorbar) -> None:
    """Give a colour bar a faint outline and small numbers."""
    bar.outline.set_edgecolor(MUTED)
    bar.ax.tick_params(labelsize=SMALL)


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
    ax.xaxis.set_major_locator(FixedLocator([math.log10(value) for value in _some(budgets)]))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: power_text(10**value)))

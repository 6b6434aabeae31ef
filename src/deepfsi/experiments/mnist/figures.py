"""Figures of the study on MNIST: noise axis, masks and their measures, and starts."""

import itertools
import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from deepfsi.errors import InputError
from deepfsi.optics.budget import impulse_imaging_error
from deepfsi.report.accuracy import Point, Results, accuracy_axes, noises, series_axes
from deepfsi.report.masks import brightest, mask_axes, peak, signed
from deepfsi.report.style import (
    AXIS_NOISES,
    COLOURS,
    GREYS,
    INK,
    LINES,
    MUTED,
    PAGE_WIDTH,
    PANEL_HEIGHT,
    SMALL,
    noise_text,
    plain_bar,
    power_text,
    signed_text,
    styled,
    thinned,
)

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
        right.yaxis.set_major_formatter(FuncFormatter(lambda value, _: signed_text(value)))
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
    ax.xaxis.set_major_locator(FixedLocator(thinned(values)))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: power_text(value)))


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

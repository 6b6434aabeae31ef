"""Figures of the study on MNIST: noise axis, masks and their measures."""

import itertools
import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from deepfsi.camera.names import noise_text
from deepfsi.report import style
from deepfsi.report.accuracy import accuracy_axes, noises, series_axes
from deepfsi.report.masks import brightest_masks, mask_axes, peak_value, signed
from deepfsi.sweeps.results import Point, Results
from deepfsi_paper.measures import impulse_imaging_error
from deepfsi_paper.report import scales

LOOKS: dict[str, dict[str, Any]] = {
    "gaussian": {"color": style.DESIGN_COLOURS["pca"], "marker": "s", "linestyle": (0, (5, 1.6))},
    "poisson": {"color": style.DESIGN_COLOURS["deepfsi"], "marker": "o", "linestyle": "-"},
}

ACROSS = 3
"""Masks beside each other in the table of masks."""

PLAIN: tuple[dict[str, Any], ...] = (
    {"color": style.INK, "marker": "D", "linestyle": "-"},
    {"color": style.MUTED, "marker": "", "linestyle": (0, (1, 1))},
    {
        "color": style.DESIGN_COLOURS["truncated-hadamard"],
        "marker": "^",
        "linestyle": (0, (3, 1.6)),
    },
)


@dataclass(frozen=True)
class Measure:
    """Measure of learned masks at a budget."""

    measure: str  # what is measured
    series: str  # masks that are measured: "gaussian", "poisson" or other words
    photons: float
    value: float  # mean over trials, in the measure's own unit
    low: float | None  # its 95 % interval; None where there is none
    high: float | None  # its 95 % interval; None where there is none
    values: Sequence[float] = ()  # of each trial


@dataclass(frozen=True)
class LearnedMasks:
    """Masks learned under both noises at one budget."""

    photons: float
    image_shape: Sequence[int]  # height and width
    gaussian: Any  # (m, N) or (2 or 1, m, N), Masks, or rails
    poisson: Any  # (m, N) or (2 or 1, m, N), Masks, or rails

    def under(self, noise: str) -> np.ndarray:
        """Masks under a noise."""
        return np.asarray(getattr(self, noise))


@style.styled
def error_figure(results: Results) -> Figure:
    """Accuracy against the impulse-imaging error, on which both noises can be compared.

    Each design is drawn at its chosen mask count. A panel for gaussian and one for photon noise, as
    far as they were tested, with the same axes. Less noise is on the right, as in figures against
    the budget. Bars are the points' intervals; circles are feature-specific designs, squares
    others.
    """
    panels = [noise for noise in scales.AXIS_NOISES if noise in noises(results)]
    mean, [sigma] = results.data.mean_reflectance, results.recipe["camera"]["sigma"]
    pixels = math.prod(results.data.image_shape)

    def error(point: Point) -> float:
        noise = scales.AXIS_NOISES[scales.AXIS_NOISES.index(point.noise)]
        return impulse_imaging_error(point.photons, mean, pixels, noise, sigma)

    chosen = [point for point in results.points if point.noise in panels and point.best]
    errors = [error(point) for point in chosen]
    figure = Figure(figsize=(5.0 * len(panels), style.PANEL_HEIGHT + 0.3), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False, sharex=True, sharey=True)[0]
    for ax, noise in zip(axes, panels, strict=True):
        accuracy_axes(
            ax,
            [point for point in chosen if point.noise == noise],
            series_axes(results),
            error,
            chance=1 / len(results.data.classes),
        )
        ax.set_xlim(1.3 * max(errors), min(errors) / 1.3)
        ax.set_title(noise_text(noise))
        ax.label_outer()
        ax.set_xlabel("noise: RMS error of impulse imaging (reflectance)\nless noise →")
        ax.xaxis.set_major_locator(LogLocator(numticks=8))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: scales.power_text(value)))
    return figure


@style.styled
def masks_table_figure(rows: Sequence[LearnedMasks], count: int = 6) -> Figure:
    """Masks learned under both noises, and the distributions of their values, by photon budget.

    A row for each budget, of `count` masks at most, those that count most photons first. Black is
    −peak, mid-grey 0 and white peak, as in the paper; the peak, the largest |M_ij| of that budget
    and noise, stands below. Distributions are over the values in parts of the peak, on a log scale.
    """
    height, width = rows[0].image_shape
    tile, gap, head, foot = 0.7, 0.05, 0.25, 0.6  # inches, as all that follows
    tall, down = tile * height / width, -(-count // ACROSS)
    row_height = down * (tall + gap) + 0.23
    total = head + row_height * len(rows) + foot
    figure = Figure(figsize=(style.PAGE_WIDTH, total))
    floor = 0.5 / max(signed(row.under(noise)).size for row in rows for noise in scales.AXIS_NOISES)
    block = ACROSS * (tile + gap) + 0.1
    for place, row in enumerate(rows):
        top = total - head - place * row_height
        bottom = top - down * (tall + gap) + gap
        name = figure.text(
            0.12 / style.PAGE_WIDTH, (top + bottom) / 2 / total, "", fontweight="bold"
        )
        name.set(text=f"{scales.power_text(row.photons)} photons", rotation=90)
        name.set(horizontalalignment="center", verticalalignment="center")
        for noise, left in zip(scales.AXIS_NOISES, (0.27, 0.27 + block), strict=True):
            end, first = _tiles(figure, row, noise, count, (left, top, tile, tall, gap))
            if place == 0:
                first.set_title(noise_text(noise))
            words = figure.text(left / style.PAGE_WIDTH, (bottom - 0.04) / total, f"peak {end:.2g}")
            words.set(fontsize=8, verticalalignment="top")
        left = 0.27 + 2 * block + 0.5
        ax = _axes_at(figure, left, bottom, style.PAGE_WIDTH - left - 0.15, top - bottom)
        _value_shares(ax, row, floor)
        ax.tick_params(labelsize=style.SMALL, labelbottom=place == len(rows) - 1)
        if place == 0:
            ax.set_title("distribution of values")
    _name_values(figure, ax)
    return figure


def _axes_at(figure: Figure, left: float, bottom: float, wide: float, high: float) -> Axes:
    """Axes at a place, in inches."""
    page = (*figure.get_size_inches(), *figure.get_size_inches())
    return figure.add_axes(tuple(np.divide((left, bottom, wide, high), page)))


def _tiles(
    figure: Figure, row: LearnedMasks, noise: str, count: int, inches: tuple[float, ...]
) -> tuple[float, Axes]:
    """Draw the brightest masks under a noise; returns the peak and the first mask's axes.

    `inches` are the left and top edge of all, a mask's width and height, and the gap between two.
    """
    left, top, tile, tall, gap = inches
    matrix = signed(row.under(noise))
    end, drawn = peak_value(matrix), []
    scale = ScalarMappable(Normalize(-end, end), style.GREYS)
    for spot, index in enumerate(brightest_masks(row.under(noise), count)):
        below, right = divmod(spot, ACROSS)
        corner = left + right * (tile + gap), top - below * (tall + gap) - tall
        drawn.append(_axes_at(figure, *corner, tile, tall))
        mask_axes(drawn[-1], matrix[index].reshape(row.image_shape), scale)
    return end, drawn[0]


def _name_values(figure: Figure, ax: Axes) -> None:
    """Label the values below the last panel, name its lines, and draw the scale of all masks."""
    ax.set_xlabel("Mᵢⱼ / peak")
    figure.legend(
        *ax.get_legend_handles_labels(),
        loc="lower right",
        ncols=2,
        frameon=False,
        fontsize=style.SMALL,
        handlelength=2.2,
        columnspacing=1.0,
    )
    bar = figure.colorbar(
        ScalarMappable(Normalize(-1, 1), style.GREYS),
        cax=_axes_at(figure, 0.7, 0.36, 3.0, 0.1),
        orientation="horizontal",
    )
    bar.set_ticks([-1, 0, 1], labels=["−peak", "0", "peak"])
    style.plain_bar(bar)


@style.styled
def measures_figure(
    rows: Sequence[Measure],
    panels: Mapping[str, tuple[str, str]],
    names: Mapping[str, str] = MappingProxyType({}),
) -> Figure:
    """Measures of learned masks against the photon budget, one small panel for each measure.

    A panel for each `measure` and a line for each `series`, in the order of their first
    appearance; axes begin at 0. Bars run from `low` to `high`.
    """
    measures = list(dict.fromkeys(row.measure for row in rows))
    columns = min(3, len(measures))
    lines = -(-len(measures) // columns)
    figure = Figure(figsize=(3.0 * columns, 2.5 * lines), layout="constrained")
    axes = figure.subplots(lines, columns, squeeze=False)
    others = itertools.cycle(PLAIN)
    kinds = dict.fromkeys(row.series for row in rows)
    looks = {kind: LOOKS.get(kind) or next(others) for kind in kinds}
    handles = {}
    for ax, measure in zip(axes.flat, measures, strict=False):
        members = [row for row in rows if row.measure == measure]
        for name in dict.fromkeys(row.series for row in members):
            own = [row for row in members if row.series == name]
            handles[name] = _line(ax, own, looks[name])
        heading, label = panels[measure]
        ax.set_title(textwrap.fill(heading, 28))
        ax.set_ylabel(label)
        ax.set_xlabel(style.BUDGET_AXIS)
        ax.set_ylim(0, 1.08 * max(row.value if row.high is None else row.high for row in members))
        ax.grid(axis="y")
        _budget_axis(ax, [row.photons for row in members])
    for ax in list(axes.flat)[len(measures) :]:
        ax.remove()
    known = {kind: noise_text(kind) if kind in LOOKS else kind for kind in kinds}
    named = {**known, **names}
    bar = Line2D([], [], color=style.MUTED, linestyle="none", marker="|", markersize=9)
    _legend(figure, {named[kind]: line for kind, line in handles.items()} | {"95 % interval": bar})
    return figure


def _legend(figure: Figure, lines: Mapping[str, Line2D]) -> None:
    """Name lines below all panels."""
    figure.legend(
        lines.values(),
        lines.keys(),
        loc="outside lower center",
        ncols=max(1, int(figure.get_figwidth() / 2.2)),
        frameon=False,
        handlelength=3,
    )


def _line(ax: Axes, rows: Iterable[Measure], look: Mapping[str, Any]) -> Line2D:
    """Draw one line over photons with bars from `low` to `high`."""
    ordered = sorted(rows, key=attrgetter("photons"))
    photons, value, low, high = (
        np.array([getattr(row, name) for row in ordered], dtype=float)
        for name in ("photons", "value", "low", "high")
    )
    bars = ax.errorbar(
        photons,
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
    ax.xaxis.set_major_locator(FixedLocator(scales.thinned(values)))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: scales.power_text(value)))


def _value_shares(ax: Axes, row: LearnedMasks, floor: float) -> None:
    """Share of all entries per bin of M/peak, an outline for each noise; `floor` is below all."""
    for noise in scales.AXIS_NOISES:
        values = signed(row.under(noise)).ravel()
        counts, edges = np.histogram(values / peak_value(values), bins=41, range=(-1, 1))
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
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: scales.power_text(value)))
    ax.set_ylabel("share of entries", fontsize=8)

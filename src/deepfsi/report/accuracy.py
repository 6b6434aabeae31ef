"""Figures of accuracy: against photons, against the number of masks, and of measured readouts."""

import math
from collections.abc import Callable, Iterable
from operator import attrgetter, itemgetter
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from deepfsi.camera.names import noise_text
from deepfsi.evaluation.measures import main_measure
from deepfsi.report import style
from deepfsi.report.style import photons_text
from deepfsi.sweeps.results import Results

Measured: TypeAlias = Any
"""Accuracy of a design with its interval: a `Point`, or an object with its attributes."""

DESIGN_AND_OPTICS = ("design", "light", "rails", "detectors")
"""Fields that tell series apart in every comparison, the design first."""

SeriesKey = tuple[str, ...]
"""Values of the fields that tell series apart."""


class Series:
    """Points by the fields that tell their series apart, in the order in which they appear."""

    def __init__(self, points: Iterable[Measured], axes: tuple[str, ...]) -> None:
        self.axes = axes
        self.groups: dict[SeriesKey, list[Measured]] = {}
        for point in points:
            self.groups.setdefault(self.key(point), []).append(point)

    @classmethod
    def of(cls, results: Results, points: Iterable[Measured] | None = None) -> "Series":
        """Series of points of a comparison, by default all of them."""
        return cls(results.points if points is None else points, series_axes(results))

    def key(self, point: Measured) -> SeriesKey:
        """Key of the series that a point is of."""
        return tuple(str(getattr(point, axis)) for axis in self.axes)

    def name(self, point: Measured, field: str = "title") -> str:
        """Name of a point's series: the design, and the axes that tell its series apart."""
        key = self.key(point)
        kin = [other for other in self.groups if other[0] == key[0]]
        # Its variant says that the budget is a mean
        shares = shares_light(self.groups[key][0])
        apart = [
            _axis_text(axis, getattr(self.groups[key][0], axis))
            for index, axis in enumerate(self.axes)
            if index
            and (len({other[index] for other in kin}) > 1 or (shares and axis == "variant"))
        ]
        return " ".join(filter(None, [getattr(self.groups[key][0], field), *apart]))

    def figure_names(self) -> dict[SeriesKey, str]:
        """Names of series in a figure: titles, or labels where one title would be too long."""
        firsts = {key: members[0] for key, members in self.groups.items()}
        names = {key: self.name(point) for key, point in firsts.items()}
        if max(map(len, names.values())) <= 32:  # letters beside a panel
            return names
        return {key: self.name(point, "label") for key, point in firsts.items()}


def series_axes(results: Results) -> tuple[str, ...]:
    """Fields, beside noise and budget, that tell the series of a comparison apart."""
    points = results.points
    apart = [axis for axis in ("variant", "levels") if len({getattr(p, axis) for p in points}) > 1]
    if "variant" not in apart and any(map(shares_light, points)):
        apart.append("variant")
    if any(p.trained_at != p.photons for p in points):
        apart.append("trained_at")
    # Where one noise of the test has several of the training
    pairs = {(p.noise, p.trained_under) for p in points}
    if len(pairs) > len({noise for noise, _ in pairs}):
        apart.append("trained_under")
    optics = {(p.light, p.rails, p.readout) for p in points}
    if len(optics) > len({(light, rails) for light, rails, _ in optics}):
        apart.append("readout")
    if results.chosen_on == "nothing":
        apart.append("masks")
    return (*DESIGN_AND_OPTICS, *apart)


def shares_light(point: Measured) -> bool:
    """True for exposures that end when a class is certain: their budget is a mean."""
    return "mean_light" in getattr(point, "further", {})


def _axis_text(axis: str, value: Any) -> str:
    """Value of a field, as the name of a series writes it."""
    if axis == "levels":
        return f"{value} levels" if value else "continuous"
    if axis == "trained_at":
        return f"from {photons_text(value)}"
    if axis == "detectors":
        return f"{value} detectors"
    return f"from {value}" if axis == "trained_under" else str(value)


def noises(results: Results) -> list[str]:
    """Noise models of a comparison, in the order in which they appear."""
    return list(dict.fromkeys(point.noise for point in results.points))


@style.styled
def accuracy_figure(results: Results, top: float = 1.0) -> Figure:
    """Accuracy against photons, each design at its chosen mask count; one panel a noise.

    Error bars are the points' intervals. Circles are feature-specific designs, squares others.
    """
    panels = noises(results)
    figure = Figure(figsize=(5.4 * len(panels), style.PANEL_HEIGHT), layout="constrained")
    grid = figure.subplots(1, len(panels), squeeze=False)[0]
    for ax, noise in zip(grid, panels, strict=True):
        points = [point for point in results.points if point.best and point.noise == noise]
        photons = attrgetter("photons")
        accuracy_axes(
            ax, points, series_axes(results), photons, chance=results.data.chance, top=top
        )
        ax.set_ylabel(main_measure(results.data.measure).axis)
        ax.set_xlabel(style.BUDGET_AXIS)
        budgets = sorted({point.photons for point in points})
        short = all(len(photons_text(budget)) <= 4 for budget in budgets)
        ax.xaxis.set_major_locator(
            FixedLocator(budgets) if len(budgets) <= 8 and short else LogLocator(numticks=8)
        )
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: photons_text(value)))
        if len(panels) > 1:
            ax.set_title(noise_text(noise))
    return figure


@style.styled
def count_figure(results: Results) -> Figure:
    """Accuracy against the number of masks, of results under one noise at one budget."""
    figure = Figure(figsize=(4.9, style.PANEL_HEIGHT), layout="constrained")
    ax = figure.subplots()
    axes = tuple(axis for axis in series_axes(results) if axis != "masks")
    accuracy_axes(ax, results.points, axes, attrgetter("masks"), chance=results.data.chance)
    ax.set_ylabel(main_measure(results.data.measure).axis)
    ax.set_xlabel("number of masks m")
    ax.xaxis.set_major_locator(LogLocator(base=2, numticks=12))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    return figure


def accuracy_axes(
    ax: Axes,
    points: Iterable[Measured],
    axes: tuple[str, ...],
    across: Callable[[Measured], float],
    *,
    chance: float,
    top: float = 1.0,
) -> None:
    """Draw accuracies over a quantity, a line for each series, named at the right."""
    series = Series(points, axes)
    groups = series.groups
    names = series.figure_names()
    values = [across(point) for members in groups.values() for point in members]
    decades = max(1.0, math.log10(max(values) / min(values)))
    # Between series, whose bars at one budget would overlap
    apart = 10 ** (0.004 * decades)
    lines: list[tuple[float, Any]] = []
    for index, (key, members) in enumerate(groups.items()):
        variant = sum(other[0] == key[0] for other in list(groups)[:index])
        rows = sorted(members, key=across)
        x = np.array([across(point) for point in rows]) * apart ** (index - (len(groups) - 1) / 2)
        y = np.array([point.accuracy for point in rows])
        bars = [y - [point.low for point in rows], [point.high for point in rows] - y]
        design = rows[0].design
        colour = style.DESIGN_COLOURS.get(design, style.INK)
        drawn = ax.errorbar(
            x,
            y,
            # matplotlib refuses negative bars, which rounding may give
            yerr=np.clip(bars, 0, None),
            label=names[key],
            linestyle=(0, (1 + variant,) * 2) if variant else style.DESIGN_LINES.get(design, "-"),
            marker="o" if rows[0].specific else "s",
            markerfacecolor=style.PAPER if variant else colour,
            color=colour,
            elinewidth=1,
            capsize=2,
            zorder=3 + index / 100,
        )
        lines.append((float(y[-1]), drawn))
    ax.set_xscale("log")
    margin = 10 ** (0.06 * decades)
    ax.set_xlim(min(values) / margin, max(values) * margin)
    dotted: dict[str, Any] = {"color": style.MUTED, "linewidth": 0.9, "linestyle": (0, (1, 1))}
    guessing = ax.axhline(chance, zorder=2, label="chance", **dotted)
    ax.set_ylim(0, top)
    ax.set_ylabel(style.ACCURACY_AXIS)
    ax.grid(axis="y")
    ax.xaxis.set_minor_locator(NullLocator())
    # In the order in which the lines end at the right
    handles = [drawn for _, drawn in sorted(lines, key=itemgetter(0), reverse=True)]
    ax.legend(handles=[*handles, guessing], loc="upper left", bbox_to_anchor=(1, 1), frameon=False)

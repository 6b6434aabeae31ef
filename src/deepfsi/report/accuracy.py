"""Figures of accuracy: against photons, against the number of masks, and of measured readouts."""

import math
from collections.abc import Callable, Iterable, Sequence
from operator import attrgetter
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, MultipleLocator, NullLocator

from deepfsi.camera.names import noise_text
from deepfsi.evaluation.measures import main_measure
from deepfsi.report import style
from deepfsi.report.style import columns, inches, photons_text
from deepfsi.sweeps.results import Results

Measured: TypeAlias = Any
"""Accuracy of a design with its interval: a `Point`, or what has its names, as other cameras do."""

DESIGN_AND_OPTICS = ("design", "light", "rails", "detectors")
"""Fields that tell series apart in every comparison, the design first."""

SeriesKey = tuple[str, ...]
"""Values of the fields that tell series apart."""

_CHANCE: dict[str, Any] = {"color": style.MUTED, "linewidth": 0.9, "linestyle": (0, (1, 1))}
"""Line of the accuracy that chance gives."""


class Series:
    """Points by the fields that tell their series apart, in the order in which they appear."""

    def __init__(self, points: Iterable[Measured], axes: tuple[str, ...]) -> None:
        self.axes = axes
        self.groups: dict[SeriesKey, list[Measured]] = {}
        for point in points:
            self.groups.setdefault(self.key(point), []).append(point)

    @classmethod
    def of(cls, results: Results, points: Iterable[Measured] | None = None) -> "Series":
        """Series of some points of a comparison; None for all."""
        return cls(results.points if points is None else points, series_axes(results))

    def key(self, point: Measured) -> SeriesKey:
        """Key of the series that a point is of."""
        return tuple(str(getattr(point, axis)) for axis in self.axes)

    def name(self, point: Measured, field: str = "title") -> str:
        """Name of a point's series: the design's, and other axes where these tell two apart."""
        key = self.key(point)
        kin = [other for other in self.groups if other[0] == key[0]]
        shares = shares_light(self.groups[key][0])  # their variant says so
        apart = [
            _axis_text(axis, getattr(self.groups[key][0], axis))
            for index, axis in enumerate(self.axes)
            if index
            and (len({other[index] for other in kin}) > 1 or (shares and axis == "variant"))
        ]
        return " ".join(filter(None, [getattr(self.groups[key][0], field), *apart]))

    def figure_names(self) -> dict[SeriesKey, str]:
        """Name of each series in a figure: written out, or short where one would be too long."""
        firsts = {key: members[0] for key, members in self.groups.items()}
        names = {key: self.name(point) for key, point in firsts.items()}
        if max(map(len, names.values())) <= 32:  # letters beside a panel
            return names
        return {key: self.name(point, "label") for key, point in firsts.items()}


def series_axes(results: Results) -> tuple[str, ...]:
    """Fields that tell series apart, of those in which points differ beside noise and budget."""
    points = results.points
    apart = [axis for axis in ("variant", "levels") if len({getattr(p, axis) for p in points}) > 1]
    if "variant" not in apart and any(map(shares_light, points)):
        apart.append("variant")
    if any(p.trained_at != p.photons for p in points):
        apart.append("trained_at")
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
    """True of exposures that stop when a class is sure, so that their budget is a mean."""
    return "mean_light" in getattr(point, "further", {})


def _axis_text(axis: str, value: Any) -> str:
    """Value of a field as a name of a series has it."""
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
    Where all were tested at one budget, each design has a line of its own, the most accurate on
    top.
    """
    panels = noises(results)
    chosen = [point for point in results.points if point.best]
    one_budget = len({point.photons for point in chosen}) == 1
    series = Series.of(results, chosen)
    if one_budget:
        wide = 2.5 + 0.075 * max(map(len, series.figure_names().values()))
        figsize = (wide * len(panels), 0.26 * len(series.groups) + 1.3)
    else:
        figsize = (5.4 * len(panels), style.PANEL_HEIGHT)
    figure = Figure(figsize=figsize, layout="constrained")
    grid = figure.subplots(1, len(panels), squeeze=False)[0]
    for ax, noise in zip(grid, panels, strict=True):
        points = [point for point in chosen if point.noise == noise]
        if one_budget:
            _ranking_axes(ax, points, series, results, top=top)
        else:
            _budget_axes(ax, points, results, top)
        if len(panels) > 1:
            ax.set_title(noise_text(noise), **({"pad": 14} if one_budget else {}))
    kinds = {Series(chosen, DESIGN_AND_OPTICS).key(point) for point in chosen}
    several = not one_budget and len(kinds) > len({point.design for point in chosen})
    hollow = "hollow: further light laws, rails or detectors" if several else ""
    marker_key(figure, chosen, hollow)
    return figure


def _budget_axes(ax: Axes, points: Sequence[Measured], results: Results, top: float) -> None:
    """Accuracies against photons under one noise."""
    photons = attrgetter("photons")
    accuracy_axes(ax, points, series_axes(results), photons, chance=results.data.chance, top=top)
    ax.set_ylabel(main_measure(results.data.measure).axis)
    ax.set_xlabel(style.BUDGET_AXIS)
    budgets = sorted({point.photons for point in points})
    short = all(len(style.photons_text(budget)) <= 4 for budget in budgets)
    ax.xaxis.set_major_locator(
        FixedLocator(budgets) if len(budgets) <= 8 and short else LogLocator(numticks=8)
    )
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: style.photons_text(value)))


def _ranking_axes(
    ax: Axes, points: Sequence[Measured], series: Series, results: Results, *, top: float
) -> None:
    """Accuracies at one budget, under one noise: a line for each series."""
    names = series.figure_names()
    rows = sorted(points, key=lambda point: point.accuracy)
    for row, point in enumerate(rows):
        ax.errorbar(
            point.accuracy,
            row,
            xerr=_bar_lengths([point]),
            color=style.DESIGN_COLOURS.get(point.design, style.INK),
            marker=_marker(point),
            capsize=2,
            elinewidth=1,
        )
    ax.set_yticks(range(len(rows)), [names[series.key(point)] for point in rows])
    ax.set_ylim(-0.6, len(rows) - 0.4)
    ax.set_xlim(0, top)
    ax.xaxis.set_major_locator(MultipleLocator(top / 4))
    ax.set_xlabel(main_measure(results.data.measure).axis)
    ax.grid(axis="x")
    chance = results.data.chance
    ax.axvline(chance, **_CHANCE)
    ax.annotate(
        "chance", (chance, 1), (3, 2), xycoords=ax.get_xaxis_transform(),
        textcoords="offset points", color=style.MUTED,
    )  # fmt: skip


def marker_key(figure: Figure, points: Iterable[Measured], *words: str) -> None:
    """Say below a figure what circles, squares and bars are, and what else its words say."""
    look: dict[str, Any] = {"color": style.MUTED, "linestyle": "none"}
    markers = {point.specific: _marker(point) for point in points}
    kinds = {True: "masks made from training data", False: "other masks"}
    keys = [Line2D([], [], marker=markers[kind], **look) for kind in kinds if kind in markers]
    keys += [Line2D([], [], marker="|", markersize=9, **look)]
    names = [*(kinds[kind] for kind in kinds if kind in markers), "95 % interval"]
    names += filter(None, words)
    keys += [Line2D([], [], linestyle="none")] * (len(names) - len(keys))
    room = figure.get_figwidth()
    in_a_row = sum(inches(name, 9) for name in names) < room
    figure.legend(
        keys,
        names,
        loc="outside lower center",
        ncols=len(keys) if in_a_row else columns(names, room, 9),
        frameon=False,
        fontsize=9,
        handlelength=1.0,
        columnspacing=1.2,
    )


@style.styled
def count_figure(results: Results) -> Figure:
    """Accuracy against the number of masks, of results under one noise at one budget."""
    # Filled markers are the mask counts that were chosen; designs whose count is fixed have one
    figure = Figure(figsize=(4.9, style.PANEL_HEIGHT), layout="constrained")
    ax = figure.subplots()
    axes = tuple(axis for axis in series_axes(results) if axis != "masks")
    accuracy_axes(
        ax,
        results.points,
        axes,
        attrgetter("masks"),
        chance=results.data.chance,
        filled=attrgetter("best"),
    )
    ax.set_ylabel(main_measure(results.data.measure).axis)
    ax.set_xlabel("number of masks m")
    ax.xaxis.set_major_locator(LogLocator(base=2, numticks=12))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    words = "filled: number of masks chosen on validation data" if results.had_choice else ""
    marker_key(figure, results.points, words)
    return figure


def accuracy_axes(
    ax: Axes,
    points: Iterable[Measured],
    axes: tuple[str, ...],
    across: Callable[[Measured], float],
    *,
    chance: float,
    span: tuple[float, float] | None = None,
    filled: Callable[[Measured], bool] | None = None,
    top: float = 1.0,
) -> None:
    """Draw accuracies over a quantity, one line for each series, named at the right edge."""
    series = Series(points, axes)
    groups = series.groups
    names = series.figure_names()
    values = [across(point) for members in groups.values() for point in members]
    left, right = span or (min(values), max(values))
    decades = max(1.0, abs(math.log10(max(left, right) / min(left, right))))
    apart = 10 ** (0.004 * decades)
    ends = []
    for index, (key, members) in enumerate(groups.items()):
        variant = sum(other[0] == key[0] for other in list(groups)[:index])
        rows = sorted(members, key=across, reverse=left > right)
        x = np.array([across(point) for point in rows]) * apart ** (index - (len(groups) - 1) / 2)
        full = np.array([filled(point) if filled else variant == 0 for point in rows])
        design = rows[0].design
        colour = style.DESIGN_COLOURS.get(design, style.INK)
        line = style.DESIGN_LINES.get(design, "-") if variant == 0 else (0, (1 + variant,) * 2)
        y = np.array([point.accuracy for point in rows])
        ax.errorbar(
            x,
            y,
            yerr=_bar_lengths(rows),
            linestyle=line,
            zorder=3 + index / 100,
            color=colour,
            elinewidth=1,
            capsize=2,
        )
        for kind in set(full.tolist()):
            at = full == kind
            ax.plot(
                x[at],
                y[at],
                linestyle="none",
                marker=_marker(rows[0]),
                label=names[key],
                color=colour,
                markerfacecolor=colour if kind else style.PAPER,
                zorder=4 + index / 100,
            )
        ends.append(_End(names[key], colour, float(x[-1]), rows[-1].accuracy))
    ax.set_xscale("log")
    margin = 10 ** (0.06 * decades)
    edges = min(left, right) / margin, max(left, right) * margin
    ax.set_xlim(edges[::-1] if left > right else edges)
    ax.axhline(chance, zorder=2, **_CHANCE)
    ax.set_ylim(0, top)
    ax.set_ylabel(style.ACCURACY_AXIS)
    ax.grid(axis="y")
    ax.xaxis.set_minor_locator(NullLocator())
    _name_ends(ax, [*ends, _End("chance", style.MUTED, ax.get_xlim()[1], chance)])


class _End(NamedTuple):
    """Last point of a line, and the name of the line."""

    name: str
    colour: str
    x: float
    y: float


def _name_ends(ax: Axes, ends: list[_End]) -> None:
    """Write names at the right edge, beside the last points, moved apart where they would touch."""
    ordered = sorted(ends, key=attrgetter("y"))
    heights = np.array([end.y for end in ordered])
    top = ax.get_ylim()[1]
    line = 0.06 * top  # height of a name
    for i in range(1, len(heights)):
        heights[i] = max(heights[i], heights[i - 1] + line)
    heights[-1] = min(heights[-1], top + line / 3)
    for i in range(len(heights) - 2, -1, -1):
        heights[i] = min(heights[i], heights[i + 1] - line)
    for end, height in zip(ordered, heights, strict=True):
        ax.annotate(
            "",
            xy=(end.x, end.y),
            xytext=(1.035, height),
            textcoords=ax.get_yaxis_transform(),
            arrowprops={"arrowstyle": "-", "color": end.colour, "linewidth": 0.6, "shrinkA": 0},
            annotation_clip=False,
        )
        ax.text(
            1.045,
            height,
            end.name,
            color=end.colour,
            transform=ax.get_yaxis_transform(),
            verticalalignment="center",
            fontweight="bold" if end.name != "chance" else "normal",
        )


def _bar_lengths(points: Sequence[Measured]) -> np.ndarray:
    """Lengths (2, n) of the bars below and above each point."""
    ends = [(point.accuracy - point.low, point.high - point.accuracy) for point in points]
    return np.clip(np.transpose(ends), 0, None)


def _marker(point: Measured) -> str:
    return "o" if point.specific else "s"

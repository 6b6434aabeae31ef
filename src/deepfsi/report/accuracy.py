"""Accuracy against photons and against the number of masks."""

import math
from collections.abc import Callable, Iterable, Sequence
from operator import attrgetter
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, MultipleLocator, NullLocator

from deepfsi.camera import noise_text
from deepfsi.measures import main_measure
from deepfsi.report import style
from deepfsi.sweeps.results import Results

Measured: TypeAlias = Any
"""Accuracy of a design with its interval: a `Point`, or what has its names, as other cameras do."""

LINE_HEIGHT = 0.06
"""Height of a name at the right edge, in parts of the axis."""

LONGEST = 32
"""Letters of the longest name in a figure; where one is longer, all are the designs' short ones."""

CHANCE: dict[str, Any] = {"color": style.MUTED, "linewidth": 0.9, "linestyle": (0, (1, 1))}
"""Line of the accuracy that chance gives."""

Fields = tuple[str, ...]

CHOSEN: Fields = ("design", "light", "rails", "detectors")


def series_axes(results: Results) -> Fields:
    """Fields that tell series apart, of those in which points differ beside noise and budget."""
    points = results.points
    apart = [axis for axis in ("variant", "levels") if len({getattr(p, axis) for p in points}) > 1]
    if any(p.trained_at != p.photons for p in points):
        apart.append("trained_at")
    pairs = {(p.noise, p.trained_under) for p in points}
    if len(pairs) > len({noise for noise, _ in pairs}):
        apart.append("trained_under")
    optics = {(p.light, p.rails, p.readout) for p in points}
    if len(optics) > len({pair[:2] for pair in optics}):
        apart.append("readout")
    if results.chosen_on == "nothing":
        apart.append("masks")
    return (*CHOSEN, *apart)


def axis_text(axis: str, value: Any) -> str:
    """Value of a field as a name of a series has it."""
    if axis == "levels":
        return f"{value} levels" if value else "continuous"
    if axis == "trained_at":
        return f"from {style.photons_text(value)}"
    if axis == "detectors":
        return f"{value} detectors"
    return f"from {value}" if axis == "trained_under" else str(value)


def series(points: Iterable[Measured], axes: Fields) -> dict[tuple[str, ...], list[Measured]]:
    """Points by the fields `axes`, the design first, in the order in which they appear."""
    found: dict[tuple[str, ...], list[Measured]] = {}
    for point in points:
        found.setdefault(key_of(point, axes), []).append(point)
    return found


def key_of(point: Measured, axes: Fields) -> tuple[str, ...]:
    """Values of a point's fields, which tell its series."""
    return tuple(str(getattr(point, axis)) for axis in axes)


def series_names(
    points: Iterable[Measured], axes: Fields, field: str = "title"
) -> dict[tuple[str, ...], str]:
    """Name of each series: the design's, and the other axes where these tell two apart."""
    groups, names = series(points, axes), {}
    for key, members in groups.items():
        kin = [other for other in groups if other[0] == key[0]]
        apart = [
            axis_text(axes[i], getattr(members[0], axes[i]))
            for i in range(1, len(axes))
            if len({other[i] for other in kin}) > 1
        ]
        names[key] = " ".join(filter(None, [getattr(members[0], field), *apart]))
    return names


def figure_names(points: Iterable[Measured], axes: Fields) -> dict[tuple[str, ...], str]:
    """Name of each series in a figure: written out, or short where one would be too long."""
    rows = list(points)
    names = series_names(rows, axes)
    return series_names(rows, axes, "label") if max(map(len, names.values())) > LONGEST else names


def axis_of(results: Results) -> str:
    """Name of the axis of what is measured."""
    return main_measure(results.data.measure).axis


def noises(results: Results) -> list[str]:
    """Noise models of a comparison, in the order in which they appear."""
    return list(dict.fromkeys(point.noise for point in results.points))


@style.styled
def accuracy_figure(results: Results, top: float = 1.0) -> Figure:
    """Accuracy against photons, each design at its chosen mask count; one panel a noise."""
    # The axis of accuracy ends at `top`, above the highest point. Error bars are the points'
    # intervals. Circles are feature-specific designs, squares others. Where all were tested at one
    # budget, each design has a line of its own, the most accurate on top
    panels, chosen = noises(results), [p for p in results.points if p.best]
    axes_apart, chance, axis = series_axes(results), results.data.chance, axis_of(results)
    if len({p.photons for p in chosen}) == 1:
        return _ranking_figure(chosen, panels, axes_apart, chance, top, axis)
    figure = Figure(figsize=(5.4 * len(panels), style.PANEL_HEIGHT), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for ax, noise in zip(axes, panels, strict=True):
        points = [p for p in chosen if p.noise == noise]
        accuracy_axes(ax, points, axes_apart, attrgetter("photons"), chance, top=top)
        ax.set_ylabel(axis)
        ax.set_xlabel(style.BUDGET_AXIS)
        budgets = sorted({p.photons for p in points})
        short = all(len(style.photons_text(budget)) <= 4 for budget in budgets)
        ax.xaxis.set_major_locator(
            FixedLocator(budgets) if len(budgets) <= 8 and short else LogLocator(numticks=8)
        )
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: style.photons_text(value)))
        if len(panels) > 1:
            ax.set_title(noise_text(noise))
    marker_key(figure, chosen, _hollow(chosen))
    return figure


def _hollow(points: Iterable[Measured]) -> str:
    """Words for hollow markers of series beside a design's first; empty where there are none."""
    rows = list(points)
    kinds = {key_of(p, CHOSEN) for p in rows}
    several = len(kinds) > len({p.design for p in rows})
    return "hollow: further light laws, rails or detectors" if several else ""


def marker_key(figure: Figure, points: Iterable[Measured], *words: str) -> None:
    """Say below a figure what circles, squares and bars are, and what else its words say."""
    looks: dict[str, Any] = {"color": style.MUTED, "linestyle": "none"}
    kinds = {point.specific: _marker(point) for point in points}
    told = {True: "masks made from training data", False: "other masks"}
    keys = [Line2D([], [], marker=kinds[kind], **looks) for kind in told if kind in kinds]
    keys += [Line2D([], [], marker="|", markersize=9, **looks)]
    names = [*(told[kind] for kind in told if kind in kinds), "95 % interval"]
    names += filter(None, words)
    keys += [Line2D([], [], linestyle="none")] * (len(names) - len(keys))
    room = figure.get_figwidth()
    in_a_row = sum(style.inches(name, 9) for name in names) < room
    figure.legend(
        keys,
        names,
        loc="outside lower center",
        ncols=len(keys) if in_a_row else style.columns(names, room, 9),
        frameon=False,
        fontsize=9,
        handlelength=1.0,
        columnspacing=1.2,
    )


def _ranking_figure(
    points: Sequence[Measured],
    panels: Sequence[str],
    axes: Fields,
    chance: float,
    top: float,
    axis: str,
) -> Figure:
    """Accuracies at one budget: a line for each series, a panel for each noise."""
    names = figure_names(points, axes)
    high = 0.26 * len(names) + 1.3
    wide = 2.5 + 0.075 * max(map(len, names.values()))
    figure = Figure(figsize=(wide * len(panels), high), layout="constrained")
    for ax, noise in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        groups = series([p for p in points if getattr(p, "noise", noise) == noise], axes)
        rows = sorted(groups.items(), key=lambda row: row[1][0].accuracy)
        for place, (_, [point]) in enumerate(rows):
            ax.errorbar(
                point.accuracy,
                place,
                xerr=_reach([point]),
                color=style.COLOURS.get(point.design, style.INK),
                marker=_marker(point),
                capsize=2,
                elinewidth=1,
            )
        ax.set_yticks(range(len(rows)), [names[key] for key, _ in rows])
        ax.set_ylim(-0.6, len(rows) - 0.4)
        ax.set_xlim(0, top)
        ax.xaxis.set_major_locator(MultipleLocator(top / 4))
        ax.set_xlabel(axis)
        ax.grid(axis="x")
        ax.axvline(chance, **CHANCE)
        ax.annotate(
            "chance", (chance, 1), (3, 2), xycoords=ax.get_xaxis_transform(),
            textcoords="offset points", color=style.MUTED,
        )  # fmt: skip
        if len(panels) > 1:
            ax.set_title(noise_text(noise), pad=14)
    marker_key(figure, points)
    return figure


@style.styled
def count_figure(results: Results) -> Figure:
    """Accuracy against the number of masks, of results under one noise at one budget."""
    # Filled markers are the mask counts that were chosen; designs whose count is fixed have one
    figure = Figure(figsize=(4.9, style.PANEL_HEIGHT), layout="constrained")
    ax, axes = figure.subplots(), tuple(a for a in series_axes(results) if a != "masks")
    chance, masks, best = results.data.chance, attrgetter("masks"), attrgetter("best")
    accuracy_axes(ax, results.points, axes, masks, chance, filled=best)
    ax.set_ylabel(axis_of(results))
    ax.set_xlabel("number of masks m")
    ax.xaxis.set_major_locator(LogLocator(base=2, numticks=12))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    words = "filled: number of masks chosen on validation data" if results.had_choice else ""
    marker_key(figure, results.points, words)
    return figure


def accuracy_axes(
    ax: Axes,
    points: Iterable[Measured],
    axes: Fields,
    across: Callable[[Measured], float],
    chance: float,
    *,
    span: tuple[float, float] | None = None,
    filled: Callable[[Measured], bool] | None = None,
    top: float = 1.0,
) -> None:
    """Draw accuracies over a quantity, one line for each series, named at the right edge."""
    rows_of = list(points)
    groups, names = series(rows_of, axes), figure_names(rows_of, axes)
    tried = [across(point) for members in groups.values() for point in members]
    left, right = span or (min(tried), max(tried))
    decades = max(1.0, abs(math.log10(max(left, right) / min(left, right))))
    apart = 10 ** (0.004 * decades)
    ends: list[tuple[str, str, float, float]] = []
    for place, (key, members) in enumerate(groups.items()):
        variant = sum(other[0] == key[0] for other in list(groups)[:place])
        rows = sorted(members, key=across, reverse=left > right)
        x = np.array([across(p) for p in rows]) * apart ** (place - (len(groups) - 1) / 2)
        full = np.array([filled(p) if filled else variant == 0 for p in rows])
        _draw_series(ax, rows, x, full, variant, place, names[key])
        ends.append(
            (names[key], style.COLOURS.get(key[0], style.INK), float(x[-1]), rows[-1].accuracy)
        )
    ax.set_xscale("log")
    margin = 10 ** (0.06 * decades)
    edges = min(left, right) / margin, max(left, right) * margin
    ax.set_xlim(edges[::-1] if left > right else edges)
    ax.axhline(chance, zorder=2, **CHANCE)
    ax.set_ylim(0, top)
    ax.set_ylabel(style.ACCURACY_AXIS)
    ax.grid(axis="y")
    ax.xaxis.set_minor_locator(NullLocator())
    _name_ends(ax, [*ends, ("chance", style.MUTED, ax.get_xlim()[1], chance)])


def _draw_series(
    ax: Axes,
    rows: Sequence[Measured],
    x: np.ndarray,
    full: np.ndarray,
    variant: int,
    place: int,
    name: str,
) -> None:
    """Draw one line with intervals, and its markers, filled or hollow."""
    design, y = rows[0].design, np.array([p.accuracy for p in rows])
    colour = style.COLOURS.get(design, style.INK)
    line = style.LINES.get(design, "-") if variant == 0 else (0, (1 + variant, 1 + variant))
    looks: dict[str, Any] = {"color": colour, "elinewidth": 1, "capsize": 2}
    ax.errorbar(x, y, yerr=_reach(rows), linestyle=line, zorder=3 + place / 100, **looks)
    for filled in set(full.tolist()):
        face = colour if filled else style.PAPER
        looks = {"color": colour, "markerfacecolor": face, "zorder": 4 + place / 100}
        at = full == filled
        ax.plot(x[at], y[at], linestyle="none", marker=_marker(rows[0]), label=name, **looks)


def _reach(points: Sequence[Measured]) -> np.ndarray:
    """Lengths (2, n) of the bars below and above each point."""
    ends = [(p.accuracy - p.low, p.high - p.accuracy) for p in points]
    return np.clip(np.transpose(ends), 0, None)


def _marker(point: Measured) -> str:
    return "o" if point.specific else "s"


def _name_ends(ax: Axes, ends: list[tuple[str, str, float, float]]) -> None:
    """Write names at the right edge, beside the last points, moved apart where they would touch."""
    ordered = sorted(ends, key=lambda end: end[3])
    heights = np.array([end[3] for end in ordered])
    top = ax.get_ylim()[1]
    line = LINE_HEIGHT * top
    for i in range(1, len(heights)):
        heights[i] = max(heights[i], heights[i - 1] + line)
    heights[-1] = min(heights[-1], top + line / 3)
    for i in range(len(heights) - 2, -1, -1):
        heights[i] = min(heights[i], heights[i + 1] - line)
    for (name, colour, x, y), height in zip(ordered, heights, strict=True):
        ax.annotate(
            "",
            xy=(x, y),
            xytext=(1.035, height),
            textcoords=ax.get_yaxis_transform(),
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.6, "shrinkA": 0},
            annotation_clip=False,
        )
        ax.text(
            1.045,
            height,
            name,
            color=colour,
            transform=ax.get_yaxis_transform(),
            verticalalignment="center",
            fontweight="bold" if name != "chance" else "normal",
        )

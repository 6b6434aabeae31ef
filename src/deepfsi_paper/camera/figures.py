"""Figures of the camera's accuracy: by exposure, and by what the laboratory varies."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from deepfsi.report import style
from deepfsi.report.accuracy import accuracy_axes
from deepfsi_paper.report import scales

MARKS = "ambient light as bright as\na scene, or the true budget"
"""Words for the dotted lines among what the laboratory varies."""

DOTTED: dict[str, Any] = {"color": style.MUTED, "linewidth": 0.9, "linestyle": (0, (1, 1))}
"""Looks of those lines."""

BESIDE = 0.028
"""Shift of published values to the right of ours, share of the axis."""


@dataclass(frozen=True)
class Accuracy:
    """Accuracy of a design in the laboratory, with its interval.

    `effect` is what the laboratory varies, and `value` how much there is of it, 0 or more.
    """

    design: str
    label: str
    title: str
    specific: bool
    exposure_s: float
    accuracy: float
    low: float
    high: float
    effect: str = ""
    value: float = 0.0


@style.styled
def exposure_figure(
    points: Iterable[Accuracy],
    published: Iterable[Accuracy] = (),
    *,
    flux: float,
) -> Figure:
    """Accuracy against total exposure: a line for each design, published values open beside it.

    Bars are intervals. Circles are feature-specific designs, squares others.
    """
    own, others = list(points), list(published)
    exposures = sorted({point.exposure_s for point in [*own, *others]})
    figure = Figure(figsize=(5.6, 3.9), layout="constrained")
    ax = figure.subplots()
    span = min(exposures), max(exposures)
    accuracy_axes(ax, own, ("design",), attrgetter("exposure_s"), chance=0.1, span=span)
    _published(ax, own, others, exposures)
    ax.set_xlabel("total exposure (s)")
    ax.xaxis.set_major_locator(FixedLocator(exposures))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: scales.power_text(value)))
    to_photons, to_seconds = partial(np.multiply, flux), partial(np.multiply, 1 / flux)
    top = ax.secondary_xaxis("top", functions=(to_photons, to_seconds))
    top.set_xlabel("photons Φ of a mean scene on the device")
    top.xaxis.set_major_locator(FixedLocator([exposure * flux for exposure in exposures]))
    top.xaxis.set_minor_locator(NullLocator())
    top.xaxis.set_major_formatter(FuncFormatter(lambda value, _: scales.power_text(value)))
    if others:
        looks: dict[str, Any] = {"color": style.INK, "marker": "o"}
        keys = [
            Line2D([], [], **looks),
            Line2D([], [], **looks, markerfacecolor=style.PAPER, linestyle="none"),
        ]
        words = ["here, with interval", "published, with interval"]
        figure.legend(keys, words, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return figure


@style.styled
def effects_figure(points: Iterable[Accuracy], axes: Mapping[str, str], *, flux: float) -> Figure:
    """Accuracy against what the laboratory varies: a column for each effect.

    A row for each exposure, the longest on top. Values are on a logarithmic axis; 0 stands apart
    at its left end, behind a break of the axis.
    """
    rows = list(points)
    exposures = sorted({each.exposure_s for each in rows}, reverse=True)
    effects = [effect for effect in axes if any(each.effect == effect for each in rows)]
    figure = Figure(
        figsize=(0.6 + 1.65 * len(effects), 0.9 + 1.9 * len(exposures)), layout="constrained"
    )
    grid = figure.subplots(len(exposures), len(effects), squeeze=False, sharey=True, sharex="col")
    keys: dict[str, Any] = {}
    for (row, column), ax in np.ndenumerate(grid):
        effect, exposure = effects[column], exposures[row]
        members = [each for each in rows if (each.effect, each.exposure_s) == (effect, exposure)]
        values = [each.value for each in rows if each.effect == effect]
        unit, label = _unit(values, axes[effect])
        keys |= _effect_lines(ax, members, [value * unit for value in values], unit)
        mark = {"ambient": flux, "assumed": flux * exposure}.get(effect)
        if mark:
            keys[MARKS] = ax.axvline(mark, **DOTTED, zorder=1)
        ax.set_ylim(0, 1)
        ax.grid(axis="y")
        if row == len(exposures) - 1:
            ax.set_xlabel(textwrap.fill(label, 24), fontsize=8)
        if column == 0:
            ax.set_ylabel(style.ACCURACY_AXIS)
            photons = style.photons_text(flux * exposure)
            ax.set_title(f"exposure {exposure:g} s, {photons} photons")
    keys = {word: keys[word] for word in sorted(keys, key=lambda word: word == MARKS)}
    figure.legend(
        list(keys.values()),
        list(keys),
        loc="outside lower center",
        ncols=4,
        frameon=False,
        fontsize=8,
        handlelength=2.6,
    )
    return figure


def _published(
    ax: Axes, own: Sequence[Accuracy], others: Sequence[Accuracy], exposures: Sequence[float]
) -> None:
    """Open markers a little to the right of our own of the same design."""
    order = list(dict.fromkeys(point.design for point in own))
    decades = max(1.0, float(np.log10(exposures[-1] / exposures[0])))
    for point in others:
        shift = BESIDE + 0.008 * (order.index(point.design) - (len(order) - 1) / 2)
        ax.errorbar(
            point.exposure_s * 10 ** (shift * decades),
            point.accuracy,
            yerr=[[point.accuracy - point.low], [point.high - point.accuracy]],
            color=style.DESIGN_COLOURS.get(point.design, style.INK),
            marker="o" if point.specific else "s",
            markerfacecolor=style.PAPER,
            markersize=4.5,
            elinewidth=0.7,
            zorder=2.5,
        )


def _unit(values: Iterable[float], label: str) -> tuple[float, str]:
    """Factor to the unit in which an axis is drawn, and its label."""
    if label.endswith("(s)") and max(values) < 1e-3:
        return 1e9, label.removesuffix("(s)") + "(ns)"
    return 1.0, label


def _effect_lines(
    ax: Axes, members: Sequence[Accuracy], values: Iterable[float], unit: float
) -> dict[str, ErrorbarContainer]:
    """Draw a line for each design over `value`; returns them by label."""
    ticks = sorted(set(values))
    lit = [tick for tick in ticks if tick > 0] or [1.0]
    ground = lit[0] / (lit[-1] / lit[0]) ** 0.25 if len(lit) > 1 else lit[0] / 2
    lines = {}
    for design in dict.fromkeys(point.design for point in members):
        own = sorted((p for p in members if p.design == design), key=lambda p: p.value)
        reach = [[p.accuracy - p.low for p in own], [p.high - p.accuracy for p in own]]
        lines[own[0].title] = ax.errorbar(
            [p.value * unit or ground for p in own],
            [p.accuracy for p in own],
            yerr=np.clip(reach, 0, None),
            color=style.DESIGN_COLOURS.get(design, style.INK),
            linestyle=style.DESIGN_LINES.get(design, "-"),
            marker="o" if own[0].specific else "s",
            markersize=3.5,
            elinewidth=0.8,
        )
    ax.set_xscale("log")
    ends = ticks[0] or ground, ticks[-1] or ground
    margin = 10 ** (0.06 * max(np.log10(ends[1] / ends[0]), 0.5))
    ax.set_xlim(ends[0] / margin, ends[1] * margin)
    if ticks[0] == 0:
        _break_axis(ax, float(np.sqrt(ground * lit[0])))
    at = [*([ground] if ticks[0] == 0 else []), *_apart(lit)]
    ax.xaxis.set_major_locator(FixedLocator(at))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter(
        FuncFormatter(lambda value, _: "0" if ticks[0] == 0 and value == ground else _short(value))
    )
    ax.tick_params(labelsize=style.SMALL)
    return lines


def _break_axis(ax: Axes, place: float) -> None:
    """Two strokes on the horizontal axis: what is left of them is not on its scale."""
    looks: dict[str, Any] = {"transform": ax.get_xaxis_transform(), "clip_on": False, "zorder": 5}
    ax.plot([place], [0], "s", color=style.PAPER, markersize=5, **looks)
    for shift in (0.94, 1 / 0.94):
        stroke = [(-0.4, -1), (0.4, 1)]
        ax.plot([place * shift], [0], marker=stroke, color=style.MUTED, markersize=8, **looks)


def _apart(values: Sequence[float]) -> list[float]:
    """Powers of ten among rising values if there are two or more, otherwise all values."""
    powers = [value for value in values if np.isclose(np.log10(value) % 1, [0, 1]).any()]
    return list(powers if len(powers) > 1 else values)


def _short(value: float) -> str:
    return scales.power_text(value) if value >= 1e3 else f"{value:g}"

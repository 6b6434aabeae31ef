"""Figures of the camera: its view, its masks made of mirrors, and how well it classifies."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import ConnectionPatch, Rectangle
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from deepfsi.errors import InputError
from deepfsi.hardware.patterns.sequence import Grid
from deepfsi.report.figures import (
    COLOURS,
    GRID,
    INK,
    LINES,
    MUTED,
    PAPER,
    Point,
    accuracy_axes,
    styled,
)
from deepfsi.report.maps import GREYS, PAGE_WIDTH, SMALL, plain_bar, power_text, readable_ink

MARGIN = 1.5  # inches beside the scenes, for words and scale
MOST_PICTURES = 48
FRAME_PIXELS = 512  # a whole frame is averaged to at most this many across
BESIDE = 0.028  # of the axis, published values to the right of ours


@styled
def views_figure(
    raw: np.ndarray,
    seen: np.ndarray,
    names: Sequence[str] = (),
    *,
    cell: tuple[float, float] = (1, 1),
) -> Figure:
    """Scenes as displayed above, and as the camera sees them below, on one scale.

    Parameters
    ----------
    raw : array, shape (n, h, w)
        Reflectance that is displayed, in [0, 1].
    seen : array, shape (n, down, across)
        Relative light at the cells, in [0, 1].
    names : sequence of str
        Heading of each scene.
    cell : tuple of float
        Height and width of a cell, in any unit: 24 and 32 mirrors on a DLP7000.

    Returns
    -------
    Figure

    Raises
    ------
    InputError
        If the two differ in number.
    """
    if len(raw) != len(seen) or len(raw) == 0:
        raise InputError(
            f"{len(raw)} displayed scenes and {len(seen)} views: give one view of each"
        )
    shape = seen.shape[1] * cell[0] / (seen.shape[2] * cell[1])
    tile = (PAGE_WIDTH - MARGIN) / max(len(raw), 4)
    heights = [tile * raw.shape[1] / raw.shape[2], tile * shape]
    figure = Figure(
        figsize=(tile * len(raw) + MARGIN, sum(heights) + (0.4 if names else 0.16)),
        layout=ConstrainedLayoutEngine(w_pad=0.04, h_pad=0.04, wspace=0.02, hspace=0.02),
    )
    axes = figure.subplots(2, len(raw), squeeze=False, height_ratios=heights)
    norm = Normalize(0, 1)
    for column, images in enumerate(zip(raw, seen, strict=True)):
        for ax, image, ratio in zip(axes[:, column], images, (1.0, cell[0] / cell[1]), strict=True):
            ax.imshow(image, cmap=GREYS, norm=norm, aspect=ratio, interpolation="none")
            ax.set(xticks=[], yticks=[])
            ax.spines[:].set(visible=True, color=GRID)
        if names:
            axes[0, column].set_title(names[column], loc="center")
    for ax, words in zip(axes[:, 0], ("displayed", "as the\ncamera\nsees it"), strict=True):
        ax.set_ylabel(words, rotation=0, horizontalalignment="right", verticalalignment="center")
    bar = figure.colorbar(ScalarMappable(norm, GREYS), ax=axes, aspect=16, pad=0.015)
    bar.set_label("reflectance,\nrelative light", fontsize=8)
    bar.set_ticks([0, 0.5, 1])
    plain_bar(bar)
    return figure


@styled
def mirrors_figure(
    mirrors: np.ndarray,
    grid: Grid,
    close: tuple[int, int] | None = None,
    cells: tuple[int, int] = (3, 3),
) -> Figure:
    """One frame of a grey mask, whole and close by, where its mirrors can be told apart.

    Parameters
    ----------
    mirrors : array of bool, shape (rows, columns)
        ON mirrors, as `hardware.dmd.unpack` gives them.
    grid : Grid
        Where the cells lie.
    close : tuple of int, optional
        First cell of the close-up, down and across; by default about the middle.
    cells : tuple of int
        Cells of the close-up, down and across.

    Returns
    -------
    Figure
        White is ON. Of the whole frame, a pixel is the average of a few mirrors. Below each
        column and beside each row of the close-up stands which cell of the mask it is.

    Raises
    ------
    InputError
        If the close-up leaves the mask.
    """
    all_cells = np.array([grid.down, grid.across])
    extent = np.minimum(cells, all_cells)
    first = (all_cells - extent) // 2 if close is None else np.array(close)
    if (first < 0).any() or (first + extent > all_cells).any():
        raise InputError(
            f"a close-up from cell {tuple(first.tolist())} leaves a mask of {grid.down} x "
            f"{grid.across} cells: choose a smaller one, or begin nearer to the middle"
        )
    rows, columns = mirrors.shape
    size = np.array([grid.height, grid.width])
    top, left = np.array([grid.top, grid.left]) + first * size
    height, width = extent * size
    figure = Figure(figsize=(PAGE_WIDTH, 3.0), layout="constrained")
    whole, near = figure.subplots(1, 2, width_ratios=(columns / rows, width / height))
    factor = -(-columns // FRAME_PIXELS)
    whole.imshow(
        _averaged(mirrors, factor),
        cmap=GREYS,
        vmin=0,
        vmax=1,
        extent=(0, columns, rows, 0),
        interpolation="none",
    )
    finer = -(-256 // max(height, width))  # printers smooth pixels: leave them little to smooth
    near.imshow(
        mirrors[top : top + height, left : left + width].repeat(finer, 0).repeat(finer, 1),
        cmap=GREYS,
        vmin=0,
        vmax=1,
        extent=(left, left + width, top + height, top),
        interpolation="none",
    )
    frame = COLOURS["deepfsi"]
    for down in range(extent[0] + 1):
        near.axhline(top + down * grid.height, color=frame, linewidth=1.2, clip_on=False)
    for across in range(extent[1] + 1):
        near.axvline(left + across * grid.width, color=frame, linewidth=1.2, clip_on=False)
    whole.add_patch(
        Rectangle((left, top), width, height, fill=False, edgecolor=frame, linewidth=1.4, zorder=4)
    )
    for corner in ((1, 0), (1, 1)):
        place = left + width * corner[0], top + height * corner[1]
        other = left, place[1]
        figure.add_artist(
            ConnectionPatch(
                place, other, "data", "data", axesA=whole, axesB=near, color=frame, linewidth=0.7
            )
        )
    whole.set_title(f"one frame, {columns} × {rows} mirrors")
    near.set_title("close by")
    whole.set(xlabel="mirror across", ylabel="mirror down")
    whole.set_xticks(_quarters(columns))
    whole.set_yticks(_quarters(rows))
    middles = left + (np.arange(extent[1]) + 0.5) * grid.width
    near.set_xticks(middles, [str(first[1] + i + 1) for i in range(extent[1])])
    middles = top + (np.arange(extent[0]) + 0.5) * grid.height
    near.set_yticks(middles, [str(first[0] + i + 1) for i in range(extent[0])])
    near.set(
        xlabel=f"cell across, {grid.width} mirrors each",
        ylabel=f"cell down, {grid.height} mirrors each",
    )
    near.tick_params(length=0)
    near.yaxis.tick_right()
    near.yaxis.set_label_position("right")
    for ax in (whole, near):
        ax.spines[:].set(visible=True)
    return figure


@styled
def exposure_figure(
    points: Iterable[Point],
    published: Iterable[Point] = (),
    *,
    classes: int = 10,
    flux: float | None = None,
) -> Figure:
    """Accuracy against total exposure: a line for each design, published values open beside it.

    Parameters
    ----------
    points : iterable of mapping
        `design`, `label`, `specific`, `exposure_s` (seconds), `accuracy`, `low`, `high`.
    published : iterable of mapping
        `design`, `exposure_s`, `accuracy`, `low`, `high`, of designs among the points.
    classes : int
        Chance is one over it.
    flux : float, optional
        Photons/s on the device; adds a photon axis on top.

    Returns
    -------
    Figure
        Bars are intervals. Circles are feature-specific designs, squares others.
    """
    rows: list[Point] = [{**point, "best": True} for point in points]
    others = list(published)
    exposures = sorted({row["exposure_s"] for row in [*rows, *others]})
    figure = Figure(figsize=(5.6, 3.9), layout="constrained")
    ax = figure.subplots()
    results = {"data": {"classes": range(classes)}}
    accuracy_axes(ax, results, rows, ("design",), "exposure_s", values=exposures)
    _published(ax, rows, others, exposures)
    ax.set_xlabel("total exposure (s)")
    ax.xaxis.set_major_locator(FixedLocator(exposures))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: power_text(value)))
    if flux is not None:
        to_photons, to_seconds = partial(np.multiply, flux), partial(np.multiply, 1 / flux)
        top = ax.secondary_xaxis("top", functions=(to_photons, to_seconds))
        top.set_xlabel("photons on the device Φ")
        top.xaxis.set_major_locator(FixedLocator([exposure * flux for exposure in exposures]))
        top.xaxis.set_minor_locator(NullLocator())
        top.xaxis.set_major_formatter(FuncFormatter(lambda value, _: power_text(value)))
    if others:
        looks: dict[str, Any] = {"color": INK, "marker": "o"}
        keys = [
            Line2D([], [], **looks),
            Line2D([], [], **looks, markerfacecolor=PAPER, linestyle="none"),
        ]
        words = ["here, with interval", "published, with interval"]
        figure.legend(keys, words, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return figure


@styled
def digits_figure(
    panels: Mapping[str, np.ndarray],
    designs: Sequence[str],
    classes: Sequence[str],
    *,
    word: str = "digit",
) -> Figure:
    """Success rate of each class and design: a square for each pair, a panel for each exposure.

    Parameters
    ----------
    panels : mapping of str to array, shape (designs, classes)
        Heading → success rates, 0 to 1; NaN where there is none.
    designs, classes : sequence of str
    word : str
        What a class is.

    Returns
    -------
    Figure
        Grey level and number both are the success rate, in per cent.

    Raises
    ------
    InputError
        If a panel has another shape.
    """
    for heading, rates in panels.items():
        if np.shape(rates) != (len(designs), len(classes)):
            raise InputError(
                f"{heading}: success rates of shape {np.shape(rates)}; give one for each of "
                f"{len(designs)} designs and {len(classes)} classes"
            )
    columns = min(2, len(panels))
    rows = -(-len(panels) // columns)
    width = PAGE_WIDTH if columns == 2 else 0.6 * PAGE_WIDTH
    side = (width - 1.5) / (columns * len(classes))
    figure = Figure(
        figsize=(width, rows * (side * len(designs) + 0.32) + 0.35), layout="constrained"
    )
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    norm = Normalize(0, 100)
    for ax, (heading, rates) in zip(axes.flat, panels.items(), strict=False):
        percent = 100 * np.asarray(rates, dtype=float)
        ax.pcolormesh(
            np.arange(len(classes) + 1),
            np.arange(len(designs) + 1),
            np.ma.masked_invalid(percent),
            cmap=GREYS,
            norm=norm,
            edgecolors=MUTED,
            linewidth=0.5,
        )
        for (row, column), value in np.ndenumerate(percent):
            known = bool(np.isfinite(value))
            ax.text(
                column + 0.5,
                row + 0.5,
                f"{value:.0f}" if known else "–",
                color=readable_ink(GREYS, norm(value)) if known else MUTED,
                fontsize=SMALL,
                horizontalalignment="center",
                verticalalignment="center_baseline",
            )
        ax.set_title(heading)
        ax.set_aspect("equal")
        ax.set_ylim(len(designs), 0)
        ax.set_xticks(np.arange(len(classes)) + 0.5, classes)
        ax.set_yticks(np.arange(len(designs)) + 0.5, designs)
        ax.tick_params(length=0)
        ax.spines[:].set_visible(False)
        ax.label_outer()
    for ax in list(axes.flat)[len(panels) :]:
        ax.remove()
    figure.supxlabel(word, fontsize=9)
    bar = figure.colorbar(
        ScalarMappable(norm, GREYS), ax=list(figure.axes), label="success rate (%)", aspect=30
    )
    plain_bar(bar)
    return figure


@styled
def effects_figure(
    points: Iterable[Point], axes: Mapping[str, str], *, flux: float | None = None
) -> Figure:
    """Accuracy against what the laboratory varies: a column for each effect.

    Parameters
    ----------
    points : iterable of mapping
        `effect`, `value` (0 or more), `design`, `label`, `specific`, `exposure_s` (seconds),
        `accuracy`, `low`, `high`.
    axes : mapping of str to str
        Effect → label of its axis, with unit. Where this is "(s)" and all values are below a
        millisecond, the axis is in nanoseconds.
    flux : float, optional
        Photons/s on the device. A line then marks as much ambient light as the scene's, and the
        budget that was assumed rightly.

    Returns
    -------
    Figure
        A row for each exposure, the longest on top. Values are on a logarithmic axis, and 0 stands
        at its left end.
    """
    rows = list(points)
    exposures = sorted({row["exposure_s"] for row in rows}, reverse=True)
    effects = [effect for effect in axes if any(row["effect"] == effect for row in rows)]
    figure = Figure(
        figsize=(0.6 + 1.65 * len(effects), 0.9 + 1.9 * len(exposures)), layout="constrained"
    )
    grid = figure.subplots(len(exposures), len(effects), squeeze=False, sharey=True, sharex="col")
    keys: dict[str, Any] = {}
    for (row, column), ax in np.ndenumerate(grid):
        effect, exposure = effects[column], exposures[row]
        members = [p for p in rows if (p["effect"], p["exposure_s"]) == (effect, exposure)]
        values = [p["value"] for p in rows if p["effect"] == effect]
        unit, label = _unit(values, axes[effect])
        keys |= _effect_lines(ax, members, [value * unit for value in values], unit)
        mark = {"ambient": flux, "assumed": (flux or 0) * exposure}.get(effect)
        if flux and mark:
            ax.axvline(mark, color=MUTED, linewidth=0.9, linestyle=(0, (1, 1)), zorder=1)
        ax.set_ylim(0, 1)
        ax.grid(axis="y")
        if row == len(exposures) - 1:
            ax.set_xlabel(textwrap.fill(label, 24), fontsize=8)
        if column == 0:
            ax.set_ylabel("accuracy")
            ax.set_title(f"{exposure:g} s")
    figure.legend(
        list(keys.values()),
        list(keys),
        loc="outside lower center",
        ncols=len(keys),
        frameon=False,
        fontsize=8,
        handlelength=2.6,
    )
    return figure


@styled
def pictures_figure(pictures: np.ndarray, names: Sequence[str]) -> Figure:
    """Least-squares pictures from the counts of an acquisition, on one scale.

    Parameters
    ----------
    pictures : array, shape (S, down, across) or (S, bands)
        NaN where a scene was lost.
    names : sequence of str
        Of the scenes.

    Returns
    -------
    Figure
        At most the first 48 scenes. The scale ends at the brightest cell, and begins at 0 or at
        the darkest cell below it.

    Raises
    ------
    InputError
        If the two differ in number.
    """
    if len(pictures) != len(names) or len(pictures) == 0:
        raise InputError(f"{len(pictures)} pictures and {len(names)} names: give one name of each")
    shown = np.asarray(pictures, dtype=float)[:MOST_PICTURES]
    if shown.ndim == 2:
        shown = shown[:, None, :]
    known = shown[np.isfinite(shown)]
    low, high = min(0.0, known.min(initial=0.0)), known.max(initial=0.0)
    norm = Normalize(low, high if high > low else low + 1)
    columns = min(6, len(shown))
    rows = -(-len(shown) // columns)
    tile = (PAGE_WIDTH - 0.8) / max(columns, 3)
    shape = max(shown.shape[1] / shown.shape[2], 0.2)
    figure = Figure(
        figsize=(tile * columns + 0.8, rows * (tile * shape + 0.24) + 0.2), layout="constrained"
    )
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax, picture, name in zip(axes.flat, shown, names, strict=False):
        ax.imshow(
            np.ma.masked_invalid(picture),
            cmap=GREYS,
            norm=norm,
            aspect="auto" if shown.shape[1] == 1 else "equal",
            interpolation="none",
        )
        ax.set(xticks=[], yticks=[])
        ax.spines[:].set(visible=True, color=GRID)
        ax.set_title(textwrap.shorten(name, 14, placeholder="…"), fontsize=SMALL)
    for ax in list(axes.flat)[len(shown) :]:
        ax.remove()
    bar = figure.colorbar(
        ScalarMappable(norm, GREYS), ax=list(figure.axes), aspect=24, pad=0.015, label="light"
    )
    plain_bar(bar)
    return figure


def _averaged(mirrors: np.ndarray, factor: int) -> np.ndarray:
    """Mirrors averaged over squares of `factor`, without an incomplete last square."""
    rows, columns = (size // factor * factor for size in mirrors.shape)
    tiles = mirrors[:rows, :columns].reshape(rows // factor, factor, columns // factor, factor)
    return np.asarray(tiles.mean(axis=(1, 3)))


def _quarters(size: int) -> list[int]:
    return [round(size * part / 4) for part in range(5)]


def _published(
    ax: Axes, rows: Sequence[Point], others: Sequence[Point], exposures: Sequence[float]
) -> None:
    """Open markers a little to the right of our own of the same design."""
    order = list(dict.fromkeys(row["design"] for row in rows))
    specific = {row["design"]: row["specific"] for row in rows}
    decades = max(1.0, float(np.log10(exposures[-1] / exposures[0])))
    for point in others:
        design = point["design"]
        colour = COLOURS.get(design, INK)
        shift = BESIDE + 0.008 * (order.index(design) - (len(order) - 1) / 2)
        ax.errorbar(
            point["exposure_s"] * 10 ** (shift * decades),
            point["accuracy"],
            yerr=[[point["accuracy"] - point["low"]], [point["high"] - point["accuracy"]]],
            color=colour,
            marker="o" if specific[design] else "s",
            markerfacecolor=PAPER,
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
    ax: Axes, members: Sequence[Point], values: Iterable[float], unit: float
) -> dict[str, ErrorbarContainer]:
    """Draw a line for each design over `value`; returns them by label."""
    ticks = sorted(set(values))
    lit = [tick for tick in ticks if tick > 0] or [1.0]
    ground = lit[0] / (lit[-1] / lit[0]) ** 0.25 if len(lit) > 1 else lit[0] / 2
    lines = {}
    for design in dict.fromkeys(p["design"] for p in members):
        own = sorted((p for p in members if p["design"] == design), key=lambda p: p["value"])
        y = np.array([p["accuracy"] for p in own])
        reach = [[p["accuracy"] - p["low"] for p in own], [p["high"] - p["accuracy"] for p in own]]
        lines[own[0]["label"]] = ax.errorbar(
            [p["value"] * unit or ground for p in own],
            y,
            yerr=np.clip(reach, 0, None),
            color=COLOURS.get(design, INK),
            linestyle=LINES.get(design, "-"),
            marker="o" if own[0]["specific"] else "s",
            markersize=3.5,
            elinewidth=0.8,
        )
    ax.set_xscale("log")
    ends = ticks[0] or ground, ticks[-1] or ground
    margin = 10 ** (0.06 * max(np.log10(ends[1] / ends[0]), 0.5))
    ax.set_xlim(ends[0] / margin, ends[1] * margin)
    at = [*([ground] if ticks[0] == 0 else []), *_apart(lit)]
    ax.xaxis.set_major_locator(FixedLocator(at))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter(
        FuncFormatter(lambda value, _: "0" if ticks[0] == 0 and value == ground else _short(value))
    )
    ax.tick_params(labelsize=SMALL)
    return lines


def _apart(values: Sequence[float]) -> list[float]:
    """Powers of ten among rising values if there are two or more, otherwise all values."""
    powers = [value for value in values if np.isclose(np.log10(value) % 1, [0, 1]).any()]
    return list(powers if len(powers) > 1 else values)


def _short(value: float) -> str:
    return power_text(value) if value >= 1e3 else f"{value:g}"

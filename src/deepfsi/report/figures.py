"""Figures of a comparison and of one design's masks. No torch, no pyplot, no global state.

Every function returns a `matplotlib.figure.Figure`; `svg` turns one into a fragment for an HTML
page whose colours are CSS variables, so that the page decides what light and dark look like.
"""

import io
import math
import re
from collections.abc import Callable, Iterable
from functools import wraps
from html import escape
from typing import Any, ParamSpec

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

Point = Any
Results = Any
P = ParamSpec("P")

INK, MUTED, GRID, PAPER = "#1b1f24", "#5d6670", "#dfe3e8", "#ffffff"
DIVERGING = "RdBu_r"
PANEL_HEIGHT = 3.5  # inches
LINE_HEIGHT = 0.06  # of a name at the right edge, in parts of the axis
BAR_LABEL = "share of a pixel's photons, Mᵢⱼ"

# Okabe and Ito's palette, yellow left out; every design also has a line of its own.
COLOURS = {
    "impulse": "#1b1f25",
    "raster": "#7a838d",
    "hadamard": "#e69f00",
    "truncated-hadamard": "#009e73",
    "pca": "#0072b2",
    "deepfsi": "#d55e00",
    "control": "#cc79a7",
    "random": "#8a7a00",
    "lda": "#56b4e9",
    "class-pairs": "#b3446c",
    "s-matrix": "#9a6a3a",
    "custom": "#6a51a3",
}
DARK_COLOURS = {
    "impulse": "#f2f4f6",
    "raster": "#97a1ac",
    "hadamard": "#f2b430",
    "truncated-hadamard": "#2cc295",
    "pca": "#4fa8e8",
    "deepfsi": "#ff7d3b",
    "control": "#e8a3c8",
    "random": "#c9b83a",
    "lda": "#8fd3ff",
    "class-pairs": "#e07a9f",
    "s-matrix": "#cf9a62",
    "custom": "#b39bff",
}
NOISES = {"poisson": "photon noise", "gaussian": "Gaussian read noise"}
LINES: dict[str, Any] = {
    "impulse": (0, (7, 2, 1.2, 2)),
    "raster": (0, (1.2, 1.6)),
    "hadamard": (0, (3, 1.6)),
    "truncated-hadamard": (0, (6, 2)),
    "control": (0, (4, 1.4, 1.2, 1.4, 1.2, 1.4)),
    "random": (0, (2, 3)),
    "lda": (0, (8, 2, 2, 2)),
    "class-pairs": (0, (8, 2, 1.2, 2, 1.2, 2)),
    "s-matrix": (0, (1, 3)),
}

CSS_NAMES = {
    INK: "ink",
    MUTED: "muted",
    GRID: "grid",
    PAPER: "paper",
    **{colour: design for design, colour in COLOURS.items()},
}
STYLE: Any = {
    "font.size": 9,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.5,
    "lines.markersize": 5.5,
    "savefig.dpi": 200,
    "text.parse_math": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "deepfsi",
}


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Draw with `STYLE`, and leave matplotlib's settings as they were."""

    @wraps(draw)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with matplotlib.rc_context(STYLE):
            return draw(*args, **kwargs)

    return wrapper


def photons_text(photons: float) -> str:
    """Budget as people write it: 30, 1000, 10⁴, 3 × 10⁵."""
    if photons < 1e4:
        return f"{photons:g}"
    exponent = math.floor(math.log10(photons) + 1e-9)
    factor = f"{photons / 10**exponent:.3g}"
    power = "10" + str(exponent).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return power if factor == "1" else f"{factor} × {power}"


def noise_text(noise: str) -> str:
    """Name of a noise model for headings and sentences."""
    return NOISES.get(noise, f"{noise} noise")


Fields = tuple[str, ...]
CHOSEN: Fields = ("design", "light", "rails")


def series_axes(results: Results) -> Fields:
    """Fields that tell series apart, of those in which points differ beside noise and budget."""
    points = results["points"]
    apart = [axis for axis in ("variant", "levels") if len({p.get(axis) for p in points}) > 1]
    if any(p.get("trained_at", p["photons"]) != p["photons"] for p in points):
        apart.append("trained_at")
    pairs = {(p["noise"], p.get("trained_under")) for p in points}
    if len(pairs) > len({noise for noise, _ in pairs}):
        apart.append("trained_under")
    if results["chosen_on"] == "nothing":
        apart.append("masks")
    return (*CHOSEN, *apart)


def axis_text(axis: str, value: Any) -> str:
    """Value of a field as a name of a series has it."""
    if axis == "levels":
        return f"{value} levels" if value else "continuous"
    if axis == "trained_at":
        return f"from {photons_text(value)}"
    return f"from {value}" if axis == "trained_under" else str(value)


def series(points: Iterable[Point], axes: Fields) -> dict[tuple[str, ...], list[Point]]:
    """Points by the fields `axes`, the design first, in the order in which they appear."""
    found: dict[tuple[str, ...], list[Point]] = {}
    for point in points:
        found.setdefault(tuple(str(point[axis]) for axis in axes), []).append(point)
    return found


def series_names(
    points: Iterable[Point], axes: Fields, field: str = "label"
) -> dict[tuple[str, ...], str]:
    """Name of each series: the design's, and the other axes where these tell two apart."""
    rows = list(series(points, axes).items())
    names = {}
    for key, members in rows:
        kin = [other for other, _ in rows if other[0] == key[0]]
        apart = [
            axis_text(axes[i], members[0][axes[i]])
            for i in range(1, len(axes))
            if len({other[i] for other in kin}) > 1
        ]
        names[key] = " ".join([members[0][field], *apart])
    return names


def noises(results: Results) -> list[str]:
    """Noise models of a comparison, in the order in which they appear."""
    return list(dict.fromkeys(point["noise"] for point in results["points"]))


@styled
def accuracy_figure(results: Results, top: float = 1.0) -> Figure:
    """Accuracy against photons, each design at its chosen mask count; one panel a noise.

    Parameters
    ----------
    results : mapping
        Content of a `results.json`.
    top : float
        End of the axis of accuracy, above the highest point.

    Returns
    -------
    Figure
        Error bars are the points' intervals. Circles are feature-specific designs, squares others.
    """
    panels = noises(results)
    figure = Figure(figsize=(4.8 * len(panels), PANEL_HEIGHT), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for ax, noise in zip(axes, panels, strict=True):
        points = [p for p in results["points"] if p["noise"] == noise and p["best"]]
        accuracy_axes(ax, results, points, series_axes(results), "photons", top=top)
        ax.set_xlabel("photon budget Φ")
        budgets = sorted({p["photons"] for p in points})
        short = all(len(photons_text(budget)) <= 4 for budget in budgets)
        ax.xaxis.set_major_locator(
            FixedLocator(budgets) if len(budgets) <= 8 and short else LogLocator(numticks=8)
        )
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: photons_text(value)))
        if len(panels) > 1:
            ax.set_title(noise_text(noise))
    return figure


@styled
def count_figure(results: Results) -> Figure:
    """Accuracy against the number of masks, one panel for each noise and budget.

    Filled markers are the mask counts that were chosen; designs whose count is fixed have one.
    """
    panels = [
        (noise, photons)
        for noise in noises(results)
        for photons in sorted({p["photons"] for p in results["points"] if p["noise"] == noise})
    ]
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(4.2 * columns, PANEL_HEIGHT * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).flat
    several = len(noises(results)) > 1
    for ax, (noise, photons) in zip(axes, panels, strict=False):
        points = [p for p in results["points"] if (p["noise"], p["photons"]) == (noise, photons)]
        axes_but_masks = tuple(axis for axis in series_axes(results) if axis != "masks")
        accuracy_axes(ax, results, points, axes_but_masks, "masks")
        ax.set_xlabel("number of masks m")
        ax.xaxis.set_major_locator(LogLocator(base=2, numticks=12))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        if len(panels) > 1:
            heading = f"{photons_text(photons)} photons"
            ax.set_title(f"{heading}, {noise_text(noise)}" if several else heading)
    for ax in list(figure.axes)[len(panels) :]:
        ax.remove()
    return figure


def accuracy_axes(
    ax: Axes,
    results: Results,
    points: list[Point],
    axes: Fields,
    across: str,
    *,
    values: Iterable[float] = (),
    falling: bool = False,
    top: float = 1.0,
) -> None:
    """Draw one line per series over the field `across`, named at the right edge.

    Panels that share an axis are given all of its `values`; a `falling` axis has the largest left.
    """
    groups, names = series(points, axes), series_names(points, axes)
    values = sorted({*values, *(p[across] for p in points)})
    decades = max(1.0, math.log10(values[-1] / values[0]))
    apart = 10 ** (0.004 * decades)
    ends: list[tuple[str, str, float, float]] = []
    seen: dict[str, int] = {}
    for place, (key, members) in enumerate(groups.items()):
        design, variant = key[0], seen.setdefault(key[0], 0)
        seen[design] += 1
        colour = COLOURS.get(design, INK)
        rows = sorted(members, key=lambda p: p[across], reverse=falling)
        x = np.array([p[across] for p in rows]) * apart ** (place - (len(groups) - 1) / 2)
        y = np.array([p["accuracy"] for p in rows])
        reach = [
            [p["accuracy"] - p["low"] for p in rows],
            [p["high"] - p["accuracy"] for p in rows],
        ]
        ax.errorbar(
            x,
            y,
            yerr=np.clip(reach, 0, None),
            color=colour,
            linestyle=LINES.get(design, "-") if variant == 0 else (0, (1 + variant, 1 + variant)),
            elinewidth=1,
            capsize=2,
            zorder=3 + place / 100,
        )
        filled = np.array([p["best"] if across == "masks" else variant == 0 for p in rows])
        for full in set(filled.tolist()):
            ax.plot(
                x[filled == full],
                y[filled == full],
                linestyle="none",
                marker="o" if rows[0]["specific"] else "s",
                color=colour,
                markerfacecolor=colour if full else PAPER,
                zorder=4 + place / 100,
                label=names[key],
            )
        ends.append((names[key], colour, float(x[-1]), float(y[-1])))
    chance = 1 / len(results["data"]["classes"])
    ax.set_xscale("log")
    edges = values[0] / 10 ** (0.06 * decades), values[-1] * 10 ** (0.06 * decades)
    ax.set_xlim(edges[::-1] if falling else edges)
    ax.axhline(chance, color=MUTED, linewidth=0.9, linestyle=(0, (1, 1)), zorder=2)
    ax.set_ylim(0, top)
    ax.set_ylabel("accuracy")
    ax.grid(axis="y")
    ax.xaxis.set_minor_locator(NullLocator())
    _name_ends(ax, [*ends, ("chance", MUTED, ax.get_xlim()[1], chance)])


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


def signed(rails_or_matrix: np.ndarray) -> np.ndarray:
    """Sensing matrix M (m, N) of rails (2 or 1, m, N), or the matrix itself."""
    array = np.asarray(rails_or_matrix)
    if array.ndim == 2:
        return array
    return np.asarray(array[0] - array[1] if len(array) == 2 else array[0])


def peak(rails_or_matrix: np.ndarray) -> float:
    """Largest |M_ij|, the end of every scale of masks; 1 where all is dark."""
    return float(np.abs(rails_or_matrix).max()) or 1.0


def brightest(rails_or_matrix: np.ndarray, count: int) -> np.ndarray:
    """Index of the masks that count most photons from a uniform scene, brightest first."""
    array = np.asarray(rails_or_matrix)
    light = np.abs(array).sum(axis=-1)
    total = light.sum(axis=0) if array.ndim == 3 else light
    return np.argsort(-total, kind="stable")[:count]


@styled
def masks_figure(
    rails_or_matrix: np.ndarray,
    image_shape: tuple[int, ...],
    title: str | None = None,
    count: int = 12,
    bar: bool = True,
) -> Figure:
    """Masks of one design, those that count most photons first: images, or curves for spectra.

    Parameters
    ----------
    rails_or_matrix : array, shape (2 or 1, m, N) or (m, N)
        Shares of each pixel's photons.
    image_shape : tuple of int
        Two sides, or one for spectra.
    title : str, optional
    count : int
        Masks to show at most.
    bar : bool
        Draw the colour bar (images only).

    Returns
    -------
    Figure
        The scale is symmetric, from −peak to peak with 0 neutral; the peak is the largest |M_ij|.
    """
    matrix = signed(rails_or_matrix)
    chosen = brightest(rails_or_matrix, count)
    end = peak(matrix)
    images = len(image_shape) == 2
    columns = 6 if images else min(3, len(chosen))
    rows = -(-len(chosen) // columns)
    width = 5.0
    tile, foot = (width / 6 * image_shape[0] / image_shape[1], 0.55 * bar) if images else (1.1, 0.3)
    height = rows * tile + foot + (0.3 if title else 0)
    layout = ConstrainedLayoutEngine(w_pad=0.02, h_pad=0.02, wspace=0.02, hspace=0.02)
    figure = Figure(figsize=(width, height), layout=layout)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for place, ax in enumerate(grid.flat):
        if place >= len(chosen):
            ax.set_visible(False)
            continue
        mask = matrix[chosen[place]]
        if images:
            mask_axes(ax, mask.reshape(image_shape), end)
        else:
            ax.axhline(0, color=MUTED, linewidth=0.6)
            ax.plot(np.arange(1, len(mask) + 1), mask, color=COLOURS["pca"], linewidth=1.1)
            ax.set_ylim(-1.05 * end, 1.05 * end)
            ax.tick_params(labelbottom=place + columns >= len(chosen))
    if not images:
        figure.supxlabel("band", fontsize=9)
        figure.supylabel("Mᵢⱼ", fontsize=9)
    if title:
        figure.suptitle(title, fontsize=10)
    if bar and images:
        _colour_bar(figure, end, ax=grid, aspect=32, shrink=0.7, pad=0.03)
    return figure


def mask_axes(ax: Axes, mask: np.ndarray, end: float, colours: str = DIVERGING) -> None:
    """Draw a mask (height, width) as an image on a scale from −`end` to `end`."""
    finer = -(-128 // max(mask.shape))  # printers smooth pixels: leave them little to smooth
    ax.imshow(
        mask.repeat(finer, axis=0).repeat(finer, axis=1),
        cmap=colours,
        vmin=-end,
        vmax=end,
        interpolation="none",
    )
    ax.set(xticks=[], yticks=[])
    ax.spines[:].set(visible=True, color=GRID)


@styled
def scale_figure() -> Figure:
    """Draw the colour bar of masks alone, in parts of the peak."""
    figure = Figure(figsize=(3.4, 0.62), layout="constrained")
    bar = _colour_bar(figure, 1.0, cax=figure.subplots())
    bar.set_ticks([-1, 0, 1], labels=["−peak", "0", "peak"])
    return figure


def _colour_bar(figure: Figure, end: float, **where: Any) -> Colorbar:
    scale = ScalarMappable(Normalize(-end, end), DIVERGING)
    bar = figure.colorbar(scale, orientation="horizontal", **where)
    bar.set_label(BAR_LABEL)
    bar.set_ticks([-end, -end / 2, 0, end / 2, end])
    bar.ax.xaxis.set_major_formatter(
        FuncFormatter(lambda value, _: f"{value:.2g}".replace("-", "−"))
    )
    bar.outline.set_edgecolor(MUTED)
    return bar


@styled
def values_figure(rails_or_matrix: np.ndarray) -> Figure:
    """Distribution of a design's mask values: share of all entries, on a log scale, per bin.

    Parameters
    ----------
    rails_or_matrix : array, shape (2 or 1, m, N) or (m, N)
    """
    values = signed(rails_or_matrix).ravel()
    end = peak(values)
    counts, edges = np.histogram(values, bins=51, range=(-end, end))
    figure = Figure(figsize=(5.0, 1.5), layout="constrained")
    ax = figure.subplots()
    floor = 0.5 / values.size
    ax.stairs(counts / values.size, edges, baseline=floor, fill=True, color=MUTED)
    ax.set_yscale("log")
    ax.set_ylim(floor, 1.5)
    ax.set_xlim(-end, end)
    ax.axvline(0, color=INK, linewidth=0.6)
    ax.yaxis.set_major_locator(LogLocator(numticks=4))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.set_xlabel("Mᵢⱼ")
    ax.set_ylabel("share of entries")
    return figure


def svg(figure: Figure, name: str, words: str) -> str:
    """Turn a figure into an SVG fragment for an HTML page; the same figure gives the same text.

    Parameters
    ----------
    figure : Figure
    name : str
        Prefix of its ids, unique on the page.
    words : str
        What a reader who cannot see it is told.
    """
    text = io.StringIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(text, format="svg", transparent=True, metadata={"Date": None})
    body = text.getvalue()
    body = body[body.index("<svg") :]
    for part in (r"<metadata>.*?</metadata>", r"<style.*?</style>", r'\sxmlns(:xlink)?="[^"]*"'):
        body = re.sub(part, "", body, flags=re.DOTALL)
    body = body.replace("xlink:href=", "href=")
    body = re.sub(r'\bid="', f'id="{name}-', body)
    body = re.sub(r'(url\(#|href="#)', rf"\g<1>{name}-", body)
    body = re.sub(
        r"#[0-9a-f]{6}\b",
        lambda found: f"var(--{CSS_NAMES[found[0]]})" if found[0] in CSS_NAMES else found[0],
        body,
    )
    view = re.search(r'viewBox="[^"]*"', body)
    assert view is not None, "matplotlib gives every figure a viewBox"
    style = f"max-width: {96 * figure.get_figwidth():.0f}px"
    head = f'<svg class="plot" role="img" aria-label="{escape(words)}" style="{style}" {view[0]}>'
    return re.sub(r"<svg[^>]*>", head, body, count=1)

"""The look of figures and pages: colours, lines, sizes and words, and how a figure is drawn.

Figures are drawn in one style, as SVG for a page, and as files beside it.
"""

import io
import math
import re
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from functools import wraps
from html import escape
from pathlib import Path
from typing import Any, ParamSpec

import matplotlib.style
from markupsafe import Markup
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure

from deepfsi.base.files import write_atomically

INK = "#1b1f24"
MUTED = "#5d6670"
GRID = "#dfe3e8"
PAPER = "#ffffff"

DIVERGING = "RdBu_r"
"""Colours of signed values."""

GREYS = "gray"
"""Colours of light."""

PANEL_HEIGHT = 3.5
"""Height of a panel, inches."""

PAGE_WIDTH = 7.2
"""Width of a printed page's text, inches."""

SMALL = 7.5
"""Font size, points."""

BUDGET_AXIS = "photon budget Φ (photons)"
ACCURACY_AXIS = "accuracy (share correct)"

_LOOKS: dict[str, tuple[str, str, Any]] = {
    "impulse": ("#1b1f25", "#f2f4f6", (0, (7, 2, 1.2, 2))),
    "raster": ("#7a838d", "#97a1ac", (0, (1.2, 1.6))),
    "hadamard": ("#e69f00", "#f2b430", (0, (3, 1.6))),
    "truncated-hadamard": ("#009e73", "#2cc295", (0, (6, 2))),
    "pca": ("#0072b2", "#4fa8e8", "-"),
    "deepfsi": ("#d55e00", "#ff7d3b", "-"),
    "control": ("#cc79a7", "#e8a3c8", (0, (4, 1.4, 1.2, 1.4, 1.2, 1.4))),
    "random": ("#8a7a00", "#c9b83a", (0, (2, 3))),
    "lda": ("#56b4e9", "#8fd3ff", (0, (8, 2, 2, 2))),
    "class-pairs": ("#b3446c", "#e07a9f", (0, (8, 2, 1.2, 2, 1.2, 2))),
    "s-matrix": ("#9a6a3a", "#cf9a62", (0, (1, 3))),
    "adaptive": ("#00838f", "#4dd0e1", "-"),
    "custom": ("#6a51a3", "#b39bff", "-"),
}
"""Colour of each design on a light and a dark page (Okabe and Ito's, but yellow), and its line."""

DESIGN_COLOURS = {design: look[0] for design, look in _LOOKS.items()}
DARK_COLOURS = {design: look[1] for design, look in _LOOKS.items()}
DESIGN_LINES = {design: look[2] for design, look in _LOOKS.items()}

CSS_NAMES = {
    INK: "ink",
    MUTED: "muted",
    GRID: "grid",
    PAPER: "paper",
    **{colour: design for design, colour in DESIGN_COLOURS.items()},
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


def photons_text(photons: float) -> str:
    """Budget as people write it: 30, 1000, 10⁴, 3 × 10⁵."""
    if photons < 1e4:
        return f"{photons:g}"
    exponent = math.floor(math.log10(photons) + 1e-9)
    factor = f"{photons / 10**exponent:.3g}"
    power = "10" + str(exponent).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return power if factor == "1" else f"{factor} × {power}"


_Args = ParamSpec("_Args")

LEAST_TEXT = 12
"""Size of the smallest words on a page, pixels."""

NARROWEST_SHARE = 0.7
"""Size of a figure on a narrow page, as a share of its size where there is room."""

_FILE_KINDS: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {}}
"""Formats of the files, and what they leave out so that the same figure gives the same file."""


def _drawing(**changes: Any) -> AbstractContextManager[None]:
    """Context of matplotlib's defaults and `STYLE`, whatever the caller's program or files set."""
    return matplotlib.style.context(["default", STYLE | changes])


def styled(draw: Callable[_Args, Figure]) -> Callable[_Args, Figure]:
    """Draw in the context of `_drawing`, and leave matplotlib's settings as they were."""

    @wraps(draw)
    def wrapper(*args: _Args.args, **kwargs: _Args.kwargs) -> Figure:
        with _drawing():
            return draw(*args, **kwargs)

    return wrapper


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure as the kind that its name ends in, whole or not at all."""
    picture = io.BytesIO()
    with _drawing():
        figure.savefig(picture, dpi=160, format=path.suffix.lower()[1:])
    write_atomically(path, picture.getvalue())


def svg(figure: Figure, name: str, words: str) -> str:
    """Turn a figure into an SVG in a box for an HTML page; the same figure gives the same text.

    It is at least as large as on paper, and so large that its smallest words have `LEAST_TEXT`
    pixels. Where the page has less room it shrinks to `NARROWEST_SHARE` of that, and then scrolls.
    """
    text = io.StringIO()
    with _drawing():
        figure.savefig(text, format="svg", transparent=True, metadata={"Date": None})
    body = text.getvalue()
    body = body[body.index("<svg") :]
    for part in (r"<metadata>.*?</metadata>", r"<style.*?</style>", r'\sxmlns(:xlink)?="[^"]*"'):
        body = re.sub(part, "", body, flags=re.DOTALL)
    body = re.sub(r"<[^>]*>", lambda tag: _of_page(tag[0], name), body)  # not what it says
    view = re.search(r'viewBox="[^"]*"', body)
    assert view is not None, "matplotlib gives every figure a viewBox"
    sizes = [float(size) for size in re.findall(r"font:[^;\"]*?([\d.]+)px", body)]
    scale = max(96 / 72, LEAST_TEXT / min(sizes, default=LEAST_TEXT))  # an SVG's unit is a point
    width = math.ceil(72 * figure.get_figwidth() * scale)
    size = f"--width: {width}px; --least: {math.ceil(NARROWEST_SHARE * width)}px"
    head = f'<svg class="plot" role="img" aria-label="{escape(words)}" style="{size}" {view[0]}>'
    drawn = re.sub(r"<svg[^>]*>", lambda _: head, body, count=1)
    return f'<div class="drawing">{drawn}</div>'


def _of_page(tag: str, name: str) -> str:
    """A tag of an SVG with ids that differ on the page, and the page's colours."""
    tag = tag.replace("xlink:href=", "href=")
    tag = re.sub(r'\bid="', f'id="{name}-', tag)
    tag = re.sub(r'(url\(#|href="#)', rf"\g<1>{name}-", tag)
    return re.sub(
        r"#[0-9a-f]{6}\b",
        lambda found: f"var(--{CSS_NAMES[found[0]]})" if found[0] in CSS_NAMES else found[0],
        tag,
    )


def inches(words: str, size: float) -> float:
    """Width of an entry of a key in inches, about, with its mark."""
    return 0.5 + 0.008 * size * max(map(len, words.splitlines()))


def columns(words: Iterable[str], width: float, size: float) -> int:
    """Number of columns of a key that fit a figure, all as wide as the widest entry."""
    return max(1, int(width / max(inches(entry, size) for entry in words)))


def plain_bar(bar: Colorbar) -> None:
    """Give a colour bar a faint outline and small numbers."""
    bar.outline.set_edgecolor(MUTED)
    bar.ax.tick_params(labelsize=SMALL)


class Figures:
    """Figures of a page by the names of their files."""

    def __init__(self) -> None:
        self.drawn: dict[str, Figure] = {}

    def add(self, name: str, figure: Figure, words: str) -> Markup:
        """Part of the page with a figure and a sentence on what it shows."""
        drawing = svg(figure, name, words)
        figure.set_layout_engine("none")  # laid out once, for the files too
        self.drawn[name] = figure
        return Markup(drawing)

    def write(self, home: Path) -> None:
        """Write the figures' files into the folder `figures` of a page's folder."""
        (home / "figures").mkdir(parents=True, exist_ok=True)
        with _drawing(**{"svg.fonttype": "path"}):
            for name, figure in self.drawn.items():
                for kind, left_out in _FILE_KINDS.items():
                    file = io.BytesIO()
                    figure.savefig(file, format=kind, dpi=160, metadata=left_out)
                    write_atomically(home / "figures" / f"{name}.{kind}", file.getvalue())

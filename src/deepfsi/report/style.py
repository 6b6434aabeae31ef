"""The look of figures and pages: colours, lines, sizes and words, and how a figure is drawn.

Figures are drawn in one style, for a page and as files beside it.
"""

import base64
import io
import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import wraps
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

_LOOKS: dict[str, tuple[str, Any]] = {
    "impulse": ("#1b1f25", (0, (7, 2, 1.2, 2))),
    "raster": ("#7a838d", (0, (1.2, 1.6))),
    "hadamard": ("#e69f00", (0, (3, 1.6))),
    "truncated-hadamard": ("#009e73", (0, (6, 2))),
    "pca": ("#0072b2", "-"),
    "deepfsi": ("#d55e00", "-"),
    "control": ("#cc79a7", (0, (4, 1.4, 1.2, 1.4, 1.2, 1.4))),
    "random": ("#8a7a00", (0, (2, 3))),
    "lda": ("#56b4e9", (0, (8, 2, 2, 2))),
    "class-pairs": ("#b3446c", (0, (8, 2, 1.2, 2, 1.2, 2))),
    "s-matrix": ("#9a6a3a", (0, (1, 3))),
    "adaptive": ("#00838f", "-"),
    "custom": ("#6a51a3", "-"),
}
"""Colour of each design (Okabe and Ito's, but yellow), and its line."""

DESIGN_COLOURS = {design: colour for design, (colour, _) in _LOOKS.items()}
DESIGN_LINES = {design: line for design, (_, line) in _LOOKS.items()}

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
    # A name may hold a dollar sign
    "text.parse_math": False,
    # Letters are drawn as paths: a page needs no fonts
    "svg.fonttype": "path",
    # Names of elements are the same in each run
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

_PIXELS_PER_INCH = 115
"""Scale of a figure on a page: letters of `SMALL` points have 12 pixels there."""

_FILE_KINDS: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {}}
"""Formats of files, and metadata to leave out: the same figure gives the same file."""


def _drawing() -> AbstractContextManager[None]:
    """Context of matplotlib's defaults and `STYLE`, whatever the user's settings are."""
    return matplotlib.style.context(["default", STYLE])


def styled(draw: Callable[_Args, Figure]) -> Callable[_Args, Figure]:
    """Draw in the context of `_drawing`, and leave matplotlib's settings as they were."""

    @wraps(draw)
    def wrapper(*args: _Args.args, **kwargs: _Args.kwargs) -> Figure:
        with _drawing():
            return draw(*args, **kwargs)

    return wrapper


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure in the format of its ending, completely or not at all."""
    write_atomically(path, _saved(figure, path.suffix.lower()[1:]))


def _saved(figure: Figure, kind: str) -> bytes:
    """Content of a figure's file."""
    content = io.BytesIO()
    with _drawing():
        figure.savefig(content, format=kind, dpi=160, metadata=_FILE_KINDS.get(kind))
    return content.getvalue()


def plain_bar(bar: Colorbar) -> None:
    """Give a colour bar a faint outline and small numbers."""
    bar.outline.set_edgecolor(MUTED)
    bar.ax.tick_params(labelsize=SMALL)


class Figures:
    """Figures of a page, and their files."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}

    def add(self, name: str, figure: Figure, words: str) -> Markup:
        """Part of the page with a figure and a sentence on what it shows."""
        for kind in _FILE_KINDS:
            self.files[f"{name}.{kind}"] = _saved(figure, kind)
            # Laid out once: all files have one layout
            figure.set_layout_engine("none")
        encoded = base64.b64encode(self.files[f"{name}.svg"]).decode()
        width = math.ceil(_PIXELS_PER_INCH * figure.get_figwidth())
        return Markup(
            '<div class="drawing"><img class="plot" alt="{}" width="{}" '
            'src="data:image/svg+xml;base64,{}"></div>'
        ).format(words, width, encoded)

    def write(self, home: Path) -> None:
        """Write the figures' files into the folder `figures` of a page's folder."""
        (home / "figures").mkdir(parents=True, exist_ok=True)
        for name, content in self.files.items():
            write_atomically(home / "figures" / name, content)

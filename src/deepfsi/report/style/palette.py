"""Colours, lines, sizes and words of all figures and pages."""

import math
from typing import Any

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

"""Figures of a hyperspectral study: the scene, maps of its classes, masks as curves over bands."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from scipy.ndimage import distance_transform_edt

from deepfsi.report.figures import (
    COLOURS,
    GRID,
    INK,
    MUTED,
    PAPER,
    Point,
    noise_text,
    photons_text,
    styled,
)
from deepfsi.report.studies import AXIS_NOISES, GREYS, PAGE_WIDTH, SMALL, readable_ink

NO_CLASS = "#e9ecef"
CLASS_COLOURS = (
    "#ff0000", "#0000ff", "#bfea15", "#15bfaa", "#552a00", "#80aaff", "#95aa55", "#005555",
    "#556aff", "#004080", "#558055", "#80eaaa", "#40eaff", "#1515aa", "#6a80aa", "#bfea6a",
)  # fmt: skip
"""Sixteen colours at least 23 apart in CIE L*a*b*, to eyes without red or green cones as well.

Maps number their classes all the same.
"""

USES = ((NO_CLASS, "no label"), ("#9ec9e6", "training"), ("#d55e00", "test"), ("#1b1f25", "left out"))
CURVES: tuple[dict[str, Any], ...] = (
    {"color": COLOURS["pca"], "linestyle": "-"},
    {"color": COLOURS["deepfsi"], "linestyle": (0, (5, 1.6))},
    {"color": INK, "linestyle": (0, (1.2, 1.2))},
    {"color": COLOURS["truncated-hadamard"], "linestyle": (0, (6, 1.6, 1.2, 1.6))},
)
PAIR: tuple[dict[str, Any], ...] = (CURVES[0], CURVES[1])

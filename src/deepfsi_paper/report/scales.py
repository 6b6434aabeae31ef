"""Scales of maps and axes: their colours, inks, ticks and numbers.

Colours on top of a colour map are not the page's own, which change with light and dark.
"""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from matplotlib import colormaps

from deepfsi.report.style import photons_text

SEQUENTIAL = "cividis"

ON_LIGHT, ON_DARK = "#101010", "#fefefe"  # ink on colour maps

AXIS_NOISES: tuple[Literal["gaussian", "poisson"], ...] = ("gaussian", "poisson")


def thinned(values: Sequence[float], most: int = 7) -> list[float]:
    """Every value, or every second, third, …, so that there are at most `most`."""
    return list(values[:: -(-len(values) // most)])


def power_text(value: float) -> str:
    """A number as a power of ten if it is one, which is shorter on an axis than 1000 or 0.001."""
    exponent = round(math.log10(value))
    if not math.isclose(value, 10.0**exponent, rel_tol=1e-6):
        return photons_text(value)
    return "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def readable_ink(colours: str, place: float) -> str:
    """Ink for text on a colour map, by the luminance beneath it."""
    luminance = np.dot(colormaps[colours](place)[:3], (0.2126, 0.7152, 0.0722))
    return ON_LIGHT if luminance > 0.45 else ON_DARK

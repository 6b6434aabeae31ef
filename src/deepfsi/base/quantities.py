"""Times, numbers and tables as people write them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

TIME_UNITS = {"ps": 1e-12, "ns": 1e-9, "us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "": 1.0}
"""Seconds of a unit of time. Longer names come first, as all end in s."""


def seconds(time: Any) -> float:
    """Seconds of a number, or of a text such as 0.01, 10ms or 44us; `ValueError` for others."""
    text = str(time).strip().lower()
    unit = next(name for name in TIME_UNITS if text.endswith(name))
    try:
        value = float(text.removesuffix(unit)) * TIME_UNITS[unit]
    except ValueError:
        value = math.nan
    if isinstance(time, bool) or not 0 <= value <= 1e9:
        raise ValueError(f"{time!r} is not a time: give seconds up to 1e9, or such as 10ms, 44us")
    return value


def time_text(time_s: float) -> str:
    """A time in the unit that suits it: 12000 s, 1.5 s, 12.07 ms, 44 µs."""
    units = ("s", "ms", "µs", "ns", "ps")
    # From 0.99995 on four digits round to 1
    unit = next((name for name in units if time_s >= 0.99995 * TIME_UNITS[name]), "s")
    number = f"{time_s / TIME_UNITS[unit]:.4g}"
    return f"{float(number):.0f} {unit}" if "e+" in number else f"{number} {unit}"


def budget_text(photons: float) -> str:
    """Photons as the command line prints and takes them: 1e4, 3.16e4."""
    mantissa, exponent = f"{photons:.2e}".split("e")
    return f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}"


def count_text(counts: float) -> str:
    """A number of counts or photons: 0.25, 99.9, 1634, 163400, 1.63e7."""
    if counts < 999.5:
        return f"{counts:.3g}" if counts >= 1e-3 else f"{counts:.1g}"
    if counts < 1e6:
        return f"{float(f'{counts:.4g}'):.0f}"
    return budget_text(counts)


def rate_text(mean: float, low: float, high: float) -> str:
    """A rate with half the width of its interval: 0.565 ± 0.027."""
    return f"{mean:.3f} ± {(high - low) / 2:.3f}"


def plural(number: int, what: str) -> str:
    """A number of things: 1 exposure, 2 exposures."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def short_name(name: str) -> str:
    """Beginning of a long name, for a table."""
    return name if len(name) <= 13 else f"{name[:12]}…"


@dataclass(frozen=True)
class Table:
    """Rows of text under heads."""

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]

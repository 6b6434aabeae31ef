"""Times as a laboratory writes them, in seconds or with a unit."""

import math
from typing import Annotated, Any

from pydantic import BeforeValidator

UNITS = {"ps": 1e-12, "ns": 1e-9, "us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "": 1.0}
"""Seconds of a unit of time; longer names first."""


def seconds(time: Any) -> float:
    """Seconds of a number, or of a text such as 0.01, 10ms or 44us; `ValueError` for others."""
    text = str(time).strip().lower()
    unit = next(each for each in UNITS if text.endswith(each))
    try:
        value = float(text.removesuffix(unit)) * UNITS[unit]
    except ValueError:
        value = math.nan
    if isinstance(time, bool) or not (math.isfinite(value) and value >= 0):
        raise ValueError(f"{time!r} is not a time: give seconds, or such as 10ms, 44us")
    return value


Seconds = Annotated[float, BeforeValidator(seconds)]
"""Seconds, 0 or more."""

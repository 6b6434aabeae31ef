"""One number of many floats: rough, and nearly the same on every processor."""

from typing import Any

import numpy as np


def sizes(value: Any) -> dict[str, float]:
    """For each first key of a case's facts, the mean size of all floats below it.

    The size of an array or a number is ln(1 + rms), to four digits; hashes tell the rest.
    """
    return {key: _mean(one) for key, one in value.items()} if isinstance(value, dict) else {}


def _mean(value: Any) -> float:
    terms = list(_terms(value))
    return float(f"{np.mean(terms):.4g}") if terms else 0.0


def _terms(value: Any):
    if isinstance(value, dict):
        for one in value.values():
            yield from _terms(one)
    elif isinstance(value, (list, tuple)):
        for one in value:
            yield from _terms(one)
    elif isinstance(value, (float, np.floating, np.ndarray)):
        numbers = np.asarray(value)
        if numbers.dtype.kind == "f" and numbers.size:
            finite = np.nan_to_num(numbers.astype(float), posinf=0.0, neginf=0.0)
            yield float(np.log1p(np.sqrt(np.mean(np.square(np.clip(finite, -1e100, 1e100))))))

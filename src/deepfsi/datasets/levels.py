"""Levels of pictures and arrays: their range, and reflectance in [0, 1].

*White* is the value of reflectance 1: 255 of bytes, true of truth values, 1 of floats. Other
integers often have fewer bits than their type, as a camera of 12 bits writes uint16. Their white is
2ᵇ − 1 by default, with b the fewest of `BITS` that hold the largest value of training and test
scenes. A data set and a design remember it, and divide further scenes by it.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from deepfsi.base.errors import InputError

BITS = (1, 8, 10, 12, 14, 16, 24, 32)
"""Depths of integers in files of cameras."""

AnyArray = npt.NDArray[Any]


class ValueRange(NamedTuple):
    """Range of the values of a source."""

    kind: str  # type of the values: "uint16", "8-bit"
    low: float
    high: float
    white: float  # value that is reflectance 1
    chosen: bool  # whether `white` was measured or given, so that other scenes need it

    @property
    def words(self) -> str:
        """Type, range and division, for a sentence."""
        bits = (int(self.white) + 1).bit_length() - 1
        depth = f" ({bits} bits)" if self.chosen and self.white == 2**bits - 1 else ""
        done = "as given" if self.white == 1 else f"divided by {self.white:.10g}{depth}"
        return f"{self.kind} values from {self.low:.4g} to {self.high:.4g}, {done}"


def measure_levels(arrays: Mapping[str, AnyArray], white: float | None = None) -> ValueRange:
    """Range of the values of scenes, by their names in messages, and their white."""
    families = {_family_of(array.dtype): what for what, array in arrays.items()}
    if len(families) > 1 or not families.keys() <= {"byte", *"bif"}:
        types = " and ".join(f"{what} {arrays[what].dtype}" for what in families.values())
        raise InputError(f"{types}: give one type, of floats in [0, 1], integers or truth values")
    [family] = families
    if family == "byte":
        white = 255.0
    elif family != "i":
        white = 1.0
    limit = white or 2.0 ** BITS[-1] - 1
    ends = {what: (float(array.min()), float(array.max())) for what, array in arrays.items()}
    for what, (low, high) in ends.items():
        # Rounding is allowed; comparisons of NaN are false
        if not -1e-6 <= low <= high <= limit + 1e-6:
            raise InputError(
                f"{what} reaches from {low:.10g} to {high:.10g}; values are allowed from 0 to "
                f"{limit:.10g}: rescale them, subtract their offset, or give a higher white"
            )
    low = min(low for low, _ in ends.values())
    high = max(high for _, high in ends.values())
    if white is None:
        white = float(next(2**bits - 1 for bits in BITS if high < 2**bits))
    kind = str(next(iter(arrays.values())).dtype)
    return ValueRange(kind, low, high, white=white, chosen=family == "i")


def _family_of(dtype: np.dtype[Any]) -> str:
    """Family of a type: "byte", or a kind of numpy; each has its own rule for white."""
    return "byte" if dtype == np.uint8 else dtype.kind.replace("u", "i")


def reflectance(values: AnyArray, levels: ValueRange) -> npt.NDArray[np.float32]:
    """Reflectance of values, as a copy; in [0, 1] but for the rounding of floats."""
    if levels.white == 1:
        return np.array(values, np.float32)
    return np.divide(values, levels.white, dtype=np.float32)

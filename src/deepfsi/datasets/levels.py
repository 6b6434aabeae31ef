"""Levels of pictures and arrays: their range, colours turned to grey, reflectance in [0, 1].

Reflectance 1, *white*, is 255 for bytes and true for truth values; floats are reflectance as given.
Integers of any other type hold fewer bits than their type, as a camera of 12 bits writes uint16:
white is then 2ᵇ − 1, with b the fewest of `BITS` that hold the largest value of training and test
scenes together, unless it is given. A data set and a design remember it, so that other scenes are
divided by the same.
"""

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any, Literal, NamedTuple, TypeGuard

import numpy as np
import numpy.typing as npt

from deepfsi.base.errors import InputError

LUMA = (0.299, 0.587, 0.114)
"""Weights of red, green and blue in a grey level (ITU-R BT.601, those of Pillow)."""

BITS = (1, 8, 10, 12, 14, 16, 24, 32)
"""Depths of integers in files of cameras."""

LARGEST_ROUNDING = 1e-6
"""Distance of a float from [0, 1] at most, after scaling done elsewhere."""

GREY_AT_ONCE = 4096
"""Scenes whose colours are turned to grey at once."""

LARGE = 2**28
"""Bytes as float32 above which scenes keep their type, and are read part by part."""

VALUES_AT_ONCE = 2**22
"""Values that are read at once."""

AnyArray = npt.NDArray[Any]

Family = Literal["truth", "byte", "integer", "float"]
"""Types that share a rule for white."""


class ValueRange(NamedTuple):
    """Range of the values of a source."""

    kind: str  # type of the values: "uint16", "8-bit"
    low: float
    high: float
    white: float  # value that is reflectance 1
    chosen: bool  # True if `white` is no property of the type: other scenes need to be told it

    @property
    def chosen_white(self) -> float | None:
        """White, where other scenes need to be told it."""
        return self.white if self.chosen else None

    @property
    def words(self) -> str:
        """Type, range and division, as a part of a sentence."""
        bits = (int(self.white) + 1).bit_length() - 1
        depth = f" ({bits} bits)" if self.chosen and self.white == 2**bits - 1 else ""
        done = "as given" if self.white == 1 else f"divided by {self.white:.10g}{depth}"
        return f"{self.kind} values from {self.low:.4g} to {self.high:.4g}, {done}"


def measure_levels(parts: Mapping[str, AnyArray], white: float | None = None) -> ValueRange:
    """Range of the values of scenes of one type, and their white."""
    families = {family_of(part.dtype, what) for what, part in parts.items()}
    if len(families) > 1:
        types = " and ".join(f"{what} {part.dtype}" for what, part in parts.items())
        raise InputError(f"{types} have no white in common; give one type")
    kind = str(next(iter(parts.values())).dtype)
    reach = {what: (float(part.min()), float(part.max())) for what, part in parts.items()}
    return levels_of(reach, families.pop(), kind, white)


def levels_of(
    reach: Mapping[str, tuple[float, float]], family: Family, kind: str, white: float | None
) -> ValueRange:
    """Levels of values that reach so far."""
    for what, (low, high) in reach.items():
        if not (np.isfinite(low) and np.isfinite(high)):
            raise InputError(f"{what} holds NaN or infinite values; remove those scenes")
        if family == "float" and (low < -LARGEST_ROUNDING or high > 1 + LARGEST_ROUNDING):
            raise InputError(
                f"{what} reaches from {low:.4g} to {high:.4g}; reflectance lies in [0, 1]: rescale "
                "it"
            )
        if family == "integer" and not 0 <= low <= high < 2 ** BITS[-1]:
            raise InputError(
                f"{what} reaches from {low:.10g} to {high:.10g}; integers are allowed from 0 to "
                f"2**{BITS[-1]} - 1: subtract the offset, or rescale to [0, 1]"
            )
        if family == "integer" and white is not None and high > white:
            raise InputError(
                f"{what} reaches up to {high:.10g}, above white, {white:.10g}; give a white that "
                "no value is above"
            )
    low = min(low for low, _ in reach.values())
    high = max(high for _, high in reach.values())
    if family != "integer":
        white = 255.0 if family == "byte" else 1.0
    elif white is None:
        white = float(next(2**bits - 1 for bits in BITS if high < 2**bits))
    return ValueRange(kind, low, high, white=white, chosen=family == "integer")


def family_of(dtype: np.dtype[Any], what: str) -> Family:
    """Rule for white of values of a type; `what` is their name in messages."""
    if dtype == np.uint8:
        return "byte"
    kinds: dict[str, Family] = {"b": "truth", "i": "integer", "u": "integer", "f": "float"}
    if dtype.kind not in kinds:
        raise InputError(f"{what} is {dtype}; give floats in [0, 1], integers or truth values")
    return kinds[dtype.kind]


def reflectance(values: AnyArray, levels: ValueRange) -> npt.NDArray[np.float32]:
    """Reflectance of values, a copy of them, in [0, 1] but for the rounding of floats."""
    if levels.white == 1:
        return values.astype(np.float32)
    return np.divide(values, levels.white, dtype=np.float32)


class StoredScenes:
    """Scenes (n, ...) in the type that they came in, which are reflectance where they are read.

    They stand for the float32 array of their reflectance, which may be too large for the memory:
    `len`, `shape` and `dtype` are those of that array, a slice is a view, and rows by index or by
    truth values, and ``numpy.asarray``, are float32 arrays. Sums and means are taken in float64.
    """

    dtype = np.dtype(np.float32)

    def __init__(
        self,
        values: AnyArray,
        levels: ValueRange,
        rows: npt.NDArray[np.integer[Any]] | None = None,
        ends: tuple[float, float] = (0.0, 1.0),
    ) -> None:
        self._values = values
        self._levels = levels
        self._rows = np.arange(len(values)) if rows is None else rows
        self._ends = ends

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def shape(self) -> tuple[int, ...]:
        """Scenes, and the shape of one."""
        return len(self), *self._values.shape[1:]

    @property
    def size(self) -> int:
        """Values of all scenes."""
        return int(np.prod(self.shape))

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, slice):
            return self.taken(np.arange(len(self))[key])
        if isinstance(key, tuple):
            rows, columns = key
            return np.concatenate([part[:, columns] for part in self[rows].parts()])
        x = reflectance(self._values[self._rows[key]], self._levels)
        low, high = self._ends
        # bytes are in [0, 1], as they would be after it
        bytes_as_they_are = family_of(self._values.dtype, "x") == "byte" and high - low == 1
        return x if bytes_as_they_are else mapped(x, low, high)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        scenes = np.empty(self.shape, np.float32)
        first = 0
        for part in self.parts():
            scenes[first : first + len(part)] = part
            first += len(part)
        return scenes if dtype is None else scenes.astype(dtype, copy=False)

    @property
    def step(self) -> int:
        """Scenes of a part."""
        return max(1, VALUES_AT_ONCE * len(self) // max(1, self.size))

    def parts(self) -> Iterator[npt.NDArray[np.float32]]:
        """All scenes, some after others."""
        for first in range(0, len(self), self.step):
            yield self[np.arange(first, min(first + self.step, len(self)))]

    def taken(self, rows: npt.NDArray[Any]) -> "StoredScenes":
        """Some scenes, by index or truth values."""
        return StoredScenes(self._values, self._levels, self._rows[rows], self._ends)

    def mapped(self, low: float, high: float) -> "StoredScenes":
        """The scenes as rows (n, N), with [0, 1] mapped to low and high."""
        rows = self._values.reshape(len(self._values), -1)
        return StoredScenes(rows, self._levels, self._rows, (low, high))

    def any(self) -> bool:
        """True if any scene has light."""
        return any(bool(part.any()) for part in self.parts())

    @cached_property
    def _reach(self) -> npt.NDArray[np.float32]:
        """Smallest and largest value (2, N) of each pixel."""
        reach = [(part.min(axis=0), part.max(axis=0)) for part in self.parts()]
        low, high = zip(*reach, strict=True)
        return np.stack([np.min(low, axis=0), np.max(high, axis=0)])

    def min(self, axis: int | None = None) -> Any:
        """Smallest value of each pixel (N,) for axis 0, or of all."""
        return self._reach[0] if axis == 0 else self._reach[0].min()

    def max(self, axis: int | None = None) -> Any:
        """Largest value of each pixel (N,) for axis 0, or of all."""
        return self._reach[1] if axis == 0 else self._reach[1].max()

    def sum(self, axis: int | None = None, dtype: Any = np.float64) -> Any:
        """Sums over scenes (N,) for axis 0, over pixels (n,) for axis 1, or of all."""
        sums = [part.sum(axis=axis, dtype=np.float64) for part in self.parts()]
        return np.concatenate(sums) if axis == 1 else np.sum(sums, axis=0)

    def mean(self, axis: int | None = None, dtype: Any = np.float32) -> Any:
        """Means, as of `sum`, in a type."""
        count = self.size if axis is None else self.shape[axis]
        return np.divide(self.sum(axis), count).astype(dtype)


def is_stored(x: object) -> TypeGuard[StoredScenes]:
    """True for scenes that are read part by part."""
    return isinstance(x, StoredScenes)


def mapped(x: npt.NDArray[np.float32], low: float, high: float) -> npt.NDArray[np.float32]:
    """Reflectance but for rounding, mapped in place from [0, 1] to low and high."""
    x *= high - low
    x += low
    return np.clip(x, low, high, out=x)


def grey(values: AnyArray, what: str) -> AnyArray:
    """Grey levels (n, H, W) of colours (n, H, W, 3), or (n, H, W, 4) whose last is left out.

    Integers keep their type, rounded; `what` is the name of the values in messages.
    """
    family = family_of(values.dtype, what)
    if values.shape[3] == 1:
        return values[..., 0]
    out = np.empty(values.shape[:3], np.float32 if family == "truth" else values.dtype)
    for first in range(0, len(values), GREY_AT_ONCE):
        part = slice(first, first + GREY_AT_ONCE)
        mixed = values[part, ..., :3] @ np.array(LUMA)
        out[part] = np.rint(mixed) if family in ("byte", "integer") else mixed
    return out

"""Levels of pictures and arrays: their range, colours turned to grey, reflectance in [0, 1].

Reflectance 1, *white*, is 255 for bytes and true for truth values; floats are reflectance as given.
Integers of any other type hold fewer bits than their type, as a camera of 12 bits writes uint16:
white is then 2ᵇ − 1, with b the fewest of `BITS` that hold the largest value of training and test
scenes together, unless it is given. A data set and a design remember it, so that other scenes are
divided by the same.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from deepfsi.base.errors import InputError
from deepfsi.base.quantities import plural

if TYPE_CHECKING:
    from PIL.Image import Image as PillowImage

BITS = (1, 8, 10, 12, 14, 16, 24, 32)
"""Depths of integers in files of cameras."""

PictureSize = tuple[int, int]

WRITTEN = "deepfsi"
"""Word in the head of a PNG file that holds reflectance as a data set had it."""

AnyArray = npt.NDArray[Any]

Family = Literal["truth", "byte", "integer", "float"]
"""Types that share a rule for white."""


class ValueRange(NamedTuple):
    """Range of the values of a source."""

    kind: str  # type of the values: "uint16", "8-bit"
    low: float
    high: float
    white: float  # value that is reflectance 1
    chosen: bool  # whether `white` was measured or given, so that other scenes need it

    @property
    def chosen_white(self) -> float | None:
        """White, if other scenes need it."""
        return self.white if self.chosen else None

    @property
    def words(self) -> str:
        """Type, range and division, for a sentence."""
        bits = (int(self.white) + 1).bit_length() - 1
        depth = f" ({bits} bits)" if self.chosen and self.white == 2**bits - 1 else ""
        done = "as given" if self.white == 1 else f"divided by {self.white:.10g}{depth}"
        return f"{self.kind} values from {self.low:.4g} to {self.high:.4g}, {done}"


def measure_levels(parts: Mapping[str, AnyArray], white: float | None = None) -> ValueRange:
    """Range of the scenes' values, and their white."""
    families = {_family_of(part.dtype, what) for what, part in parts.items()}
    if len(families) > 1:
        types = " and ".join(f"{what} {part.dtype}" for what, part in parts.items())
        raise InputError(f"{types} have no white in common; give one type")
    kind = str(next(iter(parts.values())).dtype)
    reach = {what: (float(part.min()), float(part.max())) for what, part in parts.items()}
    return _levels_of(reach, families.pop(), kind, white)


def _levels_of(
    reach: Mapping[str, tuple[float, float]], family: Family, kind: str, white: float | None
) -> ValueRange:
    """Levels of values that reach so far."""
    for what, (low, high) in reach.items():
        if not (np.isfinite(low) and np.isfinite(high)):
            raise InputError(f"{what} holds NaN or infinite values; remove those scenes")
        if family == "float" and (low < -1e-6 or high > 1 + 1e-6):  # but for rounding
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


def _family_of(dtype: np.dtype[Any], what: str) -> Family:
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
        return np.array(values, np.float32)
    return np.divide(values, levels.white, dtype=np.float32)


def grey(values: AnyArray, what: str) -> AnyArray:
    """Grey levels (n, H, W) of colours (n, H, W, 3), or (n, H, W, 4) whose last is left out.

    Integers keep their type, rounded; `what` is the name of the values in messages.
    """
    family = _family_of(values.dtype, what)
    if values.shape[3] == 1:
        return values[..., 0]
    out = np.empty(values.shape[:3], np.float32 if family == "truth" else values.dtype)
    for first in range(0, len(values), 4096):
        part = slice(first, first + 4096)
        mixed = values[part, ..., :3] @ np.array([0.299, 0.587, 0.114])  # ITU-R BT.601, as Pillow
        out[part] = np.rint(mixed) if family in ("byte", "integer") else mixed
    return out


@dataclass
class Tally:
    """Count of pictures that were read, and their range."""

    count: int = 0  # pictures that were read
    coloured: int = 0
    written: int = 0  # those that `write_pictures` wrote, as reflectance
    packed: int = 0  # bytes of their files
    sizes: set[PictureSize] = field(default_factory=set)  # heights and widths
    family: Family | None = None  # type of the values
    first: str = ""  # name of the first, for messages
    low: float = math.inf
    high: float = -math.inf

    def grey(self, image: "PillowImage", where: str) -> "PillowImage":
        """Count an image and give it in grey: mode L of 8 bits, else F in its own values."""
        from PIL import Image, ImageOps

        _check_depth(image, where)
        ImageOps.exif_transpose(image, in_place=True)
        values = _values(image)
        family = _family_of(values.dtype, where)
        if self.family not in (None, family):
            depth = {"byte": "8 bits", "integer": "more than 8 bits", "float": "floats"}
            raise InputError(
                f"images differ in depth: {self.first} has {depth[self.family]}, {where} has "
                f"{depth[family]}; save all with one depth"
            )
        self.family = family
        self.first = self.first or where
        self.count += 1
        self.coloured += image.mode not in ("1", "L", "LA", "I", "F") and image.mode[:4] != "I;16"
        self.written += WRITTEN in image.info
        self.low = min(self.low, float(values.min()))
        self.high = max(self.high, float(values.max()))
        self.sizes.add((image.height, image.width))
        return Image.fromarray(values if family == "byte" else values.astype(np.float32))

    def levels(self, white: float | None) -> ValueRange:
        """Range of all pictures and their white, measured if none is given."""
        assert self.family is not None
        name = f"{self.first} and {self.count - 1} others" if self.count > 1 else self.first
        kind = {"byte": "8-bit", "float": "float"}.get(self.family, "16-bit")
        if self.family == "integer" and self.high >= 2**16:
            kind = "32-bit"
        return _levels_of({name: (self.low, self.high)}, self.family, kind, white)

    @property
    def words(self) -> str:
        """Pictures, sizes and colours, as the beginning of a sentence."""
        sizes = [f"{height}x{width} pixels" for height, width in self.sizes]
        size = sizes[0] if len(sizes) == 1 else "several sizes"
        parts = [f"{plural(self.count, 'image')} of {size}"]
        if self.coloured:
            parts.append(f"{self.coloured} in colour, turned to grey")
        return ", ".join(parts)


def _values(image: "PillowImage") -> npt.NDArray[Any]:
    """Grey levels of an image: uint8, int64 or float32."""
    if image.mode == "F":
        return np.asarray(image)
    if image.mode == "I" or image.mode.startswith("I;16"):
        return np.asarray(image).astype(np.int64)
    return np.asarray(image.convert("L"))


def _check_depth(image: Any, where: str) -> None:
    """Raise `InputError` for an image whose values Pillow would give wrongly.

    It drops the lower bytes of deep colours, and turns a TIFF whose 0 is white only in 8 bits.
    """
    tags = getattr(image, "tag_v2", {})
    if image.mode in ("I", "F") or image.mode.startswith("I;16"):
        if tags.get(262) == 0:  # TIFF's tag PhotometricInterpretation: 0 is white
            raise InputError(f"{where} has 0 for white: save it with 0 for black")
        return
    bits = max(tags.get(258, ()), default=8)  # TIFF's tag BitsPerSample
    tiles = getattr(image, "tile", ())
    if bits > 8 or any(
        ";16" in str(tile[3]) or (tile[0] == "ppm" and tile[3][1] > 255) for tile in tiles
    ):
        raise InputError(f"{where} has colours of more than 8 bits: save it in grey levels")

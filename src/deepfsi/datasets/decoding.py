"""Images that Pillow opens as grey levels of their own depth, and a tally of what they were."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from deepfsi.base.errors import InputError
from deepfsi.base.quantities import plural
from deepfsi.datasets.levels import Family, ValueRange, family_of, levels_of

if TYPE_CHECKING:
    from PIL.Image import Image as PillowImage

PictureSize = tuple[int, int]

PICTURE_FORMATS = ("PNG", "JPEG", "BMP", "GIF", "PPM", "TIFF", "WEBP")
"""Formats that are decoded, by Pillow's names: those of others may start programs, as EPS does."""

GREY_MODES = ("1", "L", "LA", "I", "F")
"""Pillow's modes of grey images, besides those that begin with I;16."""

BITS_TAG = 258
"""Tag of a TIFF file for the bits of its samples."""

WRITTEN = "deepfsi"
"""Word in the head of a PNG file that holds reflectance as a data set had it."""

DEPTHS: dict[Family, str] = {"byte": "8 bits", "integer": "more than 8 bits", "float": "floats"}
"""For messages."""


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
    bad: tuple[str, ...] = ()  # names of those that could not be read, and were left out
    kept: list[int] = field(default_factory=list)  # which of all pictures were read
    low: float = math.inf
    high: float = -math.inf

    def grey(self, image: "PillowImage", where: str) -> "PillowImage":
        """Count an image and give it in grey: mode L of 8 bits, else F in its own values."""
        from PIL import Image, ImageOps

        check_depth(image, where)
        ImageOps.exif_transpose(image, in_place=True)
        values = _values(image)
        family = family_of(values.dtype, where)
        if self.family not in (None, family):
            raise InputError(
                f"images differ in depth: {self.first} has {DEPTHS[self.family]}, {where} has "
                f"{DEPTHS[family]}; save all with one depth"
            )
        self.family = family
        self.first = self.first or where
        self.count += 1
        self.coloured += image.mode not in GREY_MODES and not image.mode.startswith("I;16")
        self.written += WRITTEN in image.info
        self.low = min(self.low, float(values.min()))
        self.high = max(self.high, float(values.max()))
        self.sizes.add((image.height, image.width))
        return Image.fromarray(values if family == "byte" else values.astype(np.float32))

    def levels(self, white: float | None) -> ValueRange:
        """Range of all pictures and their white, which is measured unless given."""
        assert self.family is not None
        name = f"{self.first} and {self.count - 1} others" if self.count > 1 else self.first
        kind = {"byte": "8-bit", "float": "float"}.get(self.family, "16-bit")
        if self.family == "integer" and self.high >= 2**16:
            kind = "32-bit"
        return levels_of({name: (self.low, self.high)}, self.family, kind, white)

    @property
    def words(self) -> str:
        """Pictures, sizes and colours, as the beginning of a sentence."""
        sizes = [f"{height}x{width} pixels" for height, width in self.sizes]
        size = sizes[0] if len(sizes) == 1 else "several sizes"
        parts = [f"{plural(self.count, 'image')} of {size}"]
        if self.coloured:
            parts.append(f"{self.coloured} in colour, turned to grey")
        if self.bad:
            named = ", ".join(f"{Path(name).parent.name}/{Path(name).name}" for name in self.bad)
            parts.append(f"{len(self.bad)} that cannot be read left out ({named})")
        return ", ".join(parts)


def _values(image: "PillowImage") -> npt.NDArray[Any]:
    """Grey levels of an image: uint8, int64 or float32."""
    if image.mode == "F":
        return np.asarray(image)
    if image.mode == "I" or image.mode.startswith("I;16"):
        return np.asarray(image).astype(np.int64)
    return np.asarray(image.convert("L"))


def check_depth(image: Any, where: str) -> None:
    """Raise `InputError` for an image that Pillow gives the upper bytes of each value alone."""
    if image.mode in ("I", "F") or image.mode.startswith("I;16"):
        return
    bits = max(getattr(image, "tag_v2", {}).get(BITS_TAG, ()), default=8)
    tiles = getattr(image, "tile", ())
    if bits > 8 or any(
        ";16" in str(tile[3]) or (tile[0] == "ppm" and tile[3][1] > 255) for tile in tiles
    ):
        raise InputError(f"{where} has colours of more than 8 bits: save it in grey levels")

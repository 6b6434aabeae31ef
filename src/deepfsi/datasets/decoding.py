"""Images that Pillow opens as grey levels of their own depth, and a tally of what they were."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from deepfsi.datasets.deep_colours import deep_values, is_deep
from deepfsi.datasets.values import Family, Levels, levels_of
from deepfsi.errors import InputError

if TYPE_CHECKING:
    from PIL.Image import Image as PillowImage

Shape = tuple[int, int]

GREY_MODES = ("1", "L", "LA", "I", "F")
"""Pillow's modes of grey images, besides those that begin with I;16."""

PHOTOMETRIC_TAG = 262
"""Tag of a TIFF file that is 0 where 0 is white."""

WRITTEN = "deepfsi"
"""Word in the head of a PNG file that holds reflectance as a data set had it."""

DEPTHS: dict[Family, str] = {"byte": "8 bits", "integer": "more than 8 bits", "float": "floats"}
"""For messages."""


@dataclass
class Tally:
    """Count of pictures that were read, and their range."""

    # Pictures; of them those in colour, with transparency, and the first of several in one file
    count: int = 0
    coloured: int = 0
    transparent: int = 0
    several: int = 0
    packed: int = 0  # bytes of their files
    written: int = 0  # by `display.write_pictures`, as reflectance
    sizes: set[Shape] = field(default_factory=set)  # heights and widths
    family: Family | None = None  # "byte", "integer" or "float"; None before the first
    first: str = ""  # name of the first, for messages
    bad: tuple[str, ...] = ()  # names of those that could not be read, and were left out
    low: float = math.inf  # smallest and largest value, before any averaging
    high: float = -math.inf

    def grey(
        self, image: "PillowImage", where: str, again: Callable[[], "PillowImage"]
    ) -> "PillowImage":
        """Count an image and give it in grey: mode L of 8 bits, else F in its own values."""
        # `again` opens it a second time
        from PIL import Image

        coloured = image.mode not in GREY_MODES and not image.mode.startswith("I;16")
        deep = coloured and is_deep(image)
        values = deep_values(image, where, again) if deep else _values(image, where)
        family: Family = {"u": "byte", "i": "integer", "f": "float"}[values.dtype.kind]  # type: ignore[assignment]
        if self.family not in (None, family):
            raise InputError(
                f"images differ in depth: {self.first} has {DEPTHS[self.family]}, {where} has "
                f"{DEPTHS[family]}; save all with one depth"
            )
        self.family, self.first = family, self.first or where
        self.count += 1
        self.coloured += coloured
        self.transparent += image.mode in ("LA", "PA", "RGBA") or "transparency" in image.info
        self.several += getattr(image, "n_frames", 1) > 1
        self.written += WRITTEN in image.info
        self.sizes.add((image.height, image.width))
        self.low = min(self.low, float(values.min()))
        self.high = max(self.high, float(values.max()))
        return Image.fromarray(values if family == "byte" else values.astype(np.float32))

    def levels(self, white: float | None) -> Levels:
        """Range of all pictures and their white; parameters as of `levels_of`."""
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
        counted = {
            "in colour, turned to grey": self.coloured,
            "with transparency, left out": self.transparent,
            "the first of several in a file": self.several,
        }
        parts = [f"{self.count} images of {size}"]
        parts += [f"{count} {what}" for what, count in counted.items() if count]
        if self.bad:
            named = ", ".join(f"{Path(name).parent.name}/{Path(name).name}" for name in self.bad)
            parts.append(f"{len(self.bad)} that cannot be read left out ({named})")
        return ", ".join(parts)


def _values(image: "PillowImage", where: str) -> npt.NDArray[Any]:
    """Grey levels of an image: uint8, int64 or float32."""
    if image.mode == "F":
        return np.asarray(image)
    if image.mode != "I" and not image.mode.startswith("I;16"):
        return np.asarray(image.convert("L"))
    if getattr(image, "tag_v2", {}).get(PHOTOMETRIC_TAG) == 0:  # Pillow inverts bytes alone
        raise InputError(f"{where} has 0 for white; save it with 0 for black")
    return np.asarray(image).astype(np.int64)

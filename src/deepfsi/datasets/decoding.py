"""Images that Pillow opens as grey levels of their own depth, and a tally of what they were."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from deepfsi.base.errors import InputError
from deepfsi.base.files import kind_of_content
from deepfsi.base.quantities import plural
from deepfsi.datasets.levels import Family, ValueRange, family_of, levels_of

if TYPE_CHECKING:
    from PIL.Image import Image as PillowImage

PictureSize = tuple[int, int]

PICTURE_FORMATS = ("PNG", "JPEG", "BMP", "GIF", "PPM", "TIFF", "WEBP")
"""Formats that are decoded, by Pillow's names: those of others may start programs, as EPS does."""

GREY_MODES = ("1", "L", "LA", "I", "F")
"""Pillow's modes of grey images, besides those that begin with I;16."""

PHOTOMETRIC_TAG = 262
"""Tag of a TIFF file that is 0 where 0 is white."""

BITS_TAG = 258
"""Tag of a TIFF file for the bits of its samples."""

KIND_TAG = 339
"""Tag of a TIFF file for the kind of its samples."""

SIGNED = 2
"""Kind of signed integers."""

FLOATS = 3
"""Kind of floats."""

ORIENTATION_TAG = 274
"""Tag of EXIF and of a TIFF file that says how a picture is to be turned."""

TURNS = {
    2: "FLIP_LEFT_RIGHT",
    3: "ROTATE_180",
    4: "FLIP_TOP_BOTTOM",
    5: "TRANSPOSE",
    6: "ROTATE_270",
    7: "TRANSVERSE",
    8: "ROTATE_90",
}
"""Turns that set a picture upright, by EXIF orientation, in Pillow's names."""

USUAL_GAMMA = 1 / 2.2
"""Gamma of a PNG file (`gAMA`) that is shown as any other."""

WRITTEN = "deepfsi"
"""Word in the head of a PNG file that holds reflectance as a data set had it."""

DEPTHS: dict[Family, str] = {"byte": "8 bits", "integer": "more than 8 bits", "float": "floats"}
"""For messages."""


@dataclass
class Tally:
    """Count of pictures that were read, and their range."""

    count: int = 0  # pictures that were read
    coloured: int = 0
    transparent: int = 0
    several: int = 0
    turned: int = 0
    gammas: int = 0
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
        from PIL import Image
        from PIL.Image import Transpose

        coloured = image.mode not in GREY_MODES and not image.mode.startswith("I;16")
        values = _values(image, where)
        family = family_of(values.dtype, where)
        if self.family not in (None, family):
            raise InputError(
                f"images differ in depth: {self.first} has {DEPTHS[self.family]}, {where} has "
                f"{DEPTHS[family]}; save all with one depth"
            )
        self.family = family
        self.first = self.first or where
        self.count += 1
        self.coloured += coloured
        self.transparent += image.mode in ("LA", "PA", "RGBA") or "transparency" in image.info
        self.several += getattr(image, "n_frames", 1) > 1
        self.written += WRITTEN in image.info
        self.gammas += abs(float(image.info.get("gamma", USUAL_GAMMA)) / USUAL_GAMMA - 1) > 0.01
        self.low = min(self.low, float(values.min()))
        self.high = max(self.high, float(values.max()))
        upright = Image.fromarray(values if family == "byte" else values.astype(np.float32))
        turn = image.getexif().get(ORIENTATION_TAG, 1)  # Pillow turns TIFF files itself
        if turn in TURNS:
            self.turned += 1
            upright = upright.transpose(Transpose[TURNS[turn]])
        self.sizes.add((upright.height, upright.width))
        return upright

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
        counted = {
            "in colour, turned to grey": self.coloured,
            "with transparency, left out": self.transparent,
            "turned as their EXIF data say": self.turned,
            "with a gamma of their own, which was left out": self.gammas,
            "the first of several in a file": self.several,
        }
        parts = [f"{plural(self.count, 'image')} of {size}"]
        parts += [f"{count} {what}" for what, count in counted.items() if count]
        if self.bad:
            named = ", ".join(f"{Path(name).parent.name}/{Path(name).name}" for name in self.bad)
            parts.append(f"{len(self.bad)} that cannot be read left out ({named})")
        return ", ".join(parts)


def _values(image: "PillowImage", where: str) -> npt.NDArray[Any]:
    """Grey levels of an image: uint8, int64 or float32."""
    check_grey_levels(image, where)
    if image.mode == "F":
        return np.asarray(image)
    if image.mode != "I" and not image.mode.startswith("I;16"):
        return np.asarray(image.convert("L"))
    levels = np.asarray(image).astype(np.int64)
    tags = getattr(image, "tag_v2", {})
    if tags.get(BITS_TAG) == (32,) and tags.get(KIND_TAG, (1,)) == (1,):
        return levels & 0xFFFFFFFF  # unsigned, of which Pillow makes signed ones
    return levels


def check_grey_levels(image: "PillowImage", where: str) -> None:
    """Raise `InputError` for levels that Pillow gives otherwise than the file means them."""
    tags = getattr(image, "tag_v2", {})
    wide = image.mode in ("I", "F") or image.mode.startswith("I;16")
    if wide and tags.get(PHOTOMETRIC_TAG) == 0:  # Pillow inverts bytes alone
        raise InputError(f"{where} has 0 for white; save it with 0 for black")
    if not wide and _is_deep(image):
        raise InputError(f"{where} has colours of more than 8 bits: save it in grey levels")
    if not wide and SIGNED in tags.get(KIND_TAG, ()):
        raise InputError(
            f"{where} has signed integers of 8 bits; save it with unsigned ones, or floats"
        )


def _is_deep(image: Any) -> bool:
    """True for an image of which Pillow gives the upper bytes of each value alone."""
    if max(getattr(image, "tag_v2", {}).get(BITS_TAG, ()), default=8) > 8:
        return True
    return any(
        ";16" in str(tile[3]) or (tile[0] == "ppm" and tile[3][1] > 255)
        for tile in getattr(image, "tile", ())
    )


def unread_kind(content: IO[bytes]) -> str:
    """Kind of a file that Pillow does not open as an image, as a part of a message."""
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    content.seek(0)
    head = content.read(512)
    kind = kind_of_content(head)
    if head[:4] not in (b"II*\0", b"MM\0*"):
        return f"no image, but {kind}"
    try:
        tags = ImageFileDirectory_v2(head[:8])
        content.seek(tags.next)
        tags.load(content)
        bits = tags.get(BITS_TAG, (0,))[0]
        form = tags.get(KIND_TAG, (1,))[0]
    except Exception:  # of a damaged file, almost anything
        return "a damaged TIFF picture"
    kinds = {1: "unsigned integers", SIGNED: "signed integers", FLOATS: "floats"}
    return (
        f"a TIFF picture of {bits}-bit {kinds.get(form, 'values of an unknown kind')}, which is "
        "not read: save it with floats of 32 bits or unsigned integers of 8 or 16"
    )

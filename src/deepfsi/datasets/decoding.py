"""Images that Pillow opens as grey levels of their own depth, and a tally of what they were."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from deepfsi.base import InputError, kind_of_content
from deepfsi.datasets.deep_colours import deep_values, is_deep
from deepfsi.datasets.values import Family, Levels, levels_of

if TYPE_CHECKING:
    from PIL.Image import Image as PillowImage

Shape = tuple[int, int]

GREY_MODES = ("1", "L", "LA", "I", "F")
"""Pillow's modes of grey images, besides those that begin with I;16."""

PHOTOMETRIC_TAG = 262
"""Tag of a TIFF file that is 0 where 0 is white."""

KIND_TAG, BITS_TAG, SIGNED, FLOATS = 339, 258, 2, 3
"""Tags of a TIFF file for the kind and the bits of its samples, and two of the kinds."""

ORIENTATION_TAG = 274
"""Tag of EXIF and of a TIFF file that says how a picture is to be turned."""

USUAL_GAMMA = 1 / 2.2
"""Gamma of a PNG file (`gAMA`) that is shown as any other."""

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
    turned: int = 0  # as EXIF says
    gammas: int = 0  # with a gamma of their own
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
        self.gammas += abs(float(image.info.get("gamma", USUAL_GAMMA)) / USUAL_GAMMA - 1) > 0.01
        self.low = min(self.low, float(values.min()))
        self.high = max(self.high, float(values.max()))
        grey = Image.fromarray(values if family == "byte" else values.astype(np.float32))
        turn = _turns().get(image.getexif().get(ORIENTATION_TAG, 1))  # done in TIFF files already
        self.turned += turn is not None
        grey = grey if turn is None else grey.transpose(turn)
        self.sizes.add((grey.height, grey.width))
        return grey

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
            "turned as their EXIF data say": self.turned,
            "with a gamma of their own, which was left out": self.gammas,
            "the first of several in a file": self.several,
        }
        parts = [f"{self.count} image{'' if self.count == 1 else 's'} of {size}"]
        parts += [f"{count} {what}" for what, count in counted.items() if count]
        if self.bad:
            named = ", ".join(f"{Path(name).parent.name}/{Path(name).name}" for name in self.bad)
            parts.append(f"{len(self.bad)} that cannot be read left out ({named})")
        return ", ".join(parts)


def _turns() -> dict[int, Any]:
    """Turns that set a picture upright, by EXIF orientation; none for 1."""
    from PIL.Image import Transpose

    return {
        2: Transpose.FLIP_LEFT_RIGHT,
        3: Transpose.ROTATE_180,
        4: Transpose.FLIP_TOP_BOTTOM,
        5: Transpose.TRANSPOSE,
        6: Transpose.ROTATE_270,
        7: Transpose.TRANSVERSE,
        8: Transpose.ROTATE_90,
    }


def _values(image: "PillowImage", where: str) -> npt.NDArray[Any]:
    """Grey levels of an image: uint8, int64 or float32."""
    check_levels(image, where)
    if image.mode == "F":
        return np.asarray(image)
    if image.mode != "I" and not image.mode.startswith("I;16"):
        return np.asarray(image.convert("L"))
    levels = np.asarray(image).astype(np.int64)
    tags = getattr(image, "tag_v2", {})
    if tags.get(BITS_TAG) == (32,) and tags.get(KIND_TAG, (1,)) == (1,):
        return levels & 0xFFFFFFFF  # unsigned, of which Pillow makes signed ones
    return levels


def check_levels(image: "PillowImage", where: str) -> None:
    """Raise `InputError` for levels that Pillow gives otherwise than the file means them."""
    tags = getattr(image, "tag_v2", {})
    wide = image.mode in ("I", "F") or image.mode.startswith("I;16")
    if wide and tags.get(PHOTOMETRIC_TAG) == 0:  # Pillow inverts bytes alone
        raise InputError(f"{where} has 0 for white; save it with 0 for black")
    if not wide and SIGNED in tags.get(KIND_TAG, ()):
        raise InputError(
            f"{where} has signed integers of 8 bits; save it with unsigned ones, or floats"
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
        bits, form = tags.get(BITS_TAG, (0,))[0], tags.get(KIND_TAG, (1,))[0]
    except Exception:  # of a damaged file, almost anything
        return "a damaged TIFF picture"
    kinds = {1: "unsigned integers", SIGNED: "signed integers", FLOATS: "floats"}
    return (
        f"a TIFF picture of {bits}-bit {kinds.get(form, 'values of an unknown kind')}, which is "
        "not read: save it with floats of 32 bits or unsigned integers of 8 or 16"
    )

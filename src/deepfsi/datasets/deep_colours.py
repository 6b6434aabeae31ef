"""Images in colours of 16 bits, read whole.

Pillow gives such colours by their upper bytes alone. The lower ones are what it gives of the same
file when it is told that the bytes of each value stand the other way around.
"""

import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from deepfsi.base import InputError
from deepfsi.datasets.values import grey

BITS_TAG = 258
"""Tag of a TIFF file for the bits of each sample."""

OTHER = {"L": "B", "B": "L", "N": "B" if sys.byteorder == "little" else "L"}
"""Orders of the bytes of a value, little-endian, big-endian and native, each with its other one."""

SWAPPED = {
    f"{mode};16{order}": f"{mode};16{other}"
    for mode in ("RGB", "RGBA", "RGBX")
    for order, other in OTHER.items()
}
"""Pillow's names of 16-bit colours in a file, and of those with the bytes of a value swapped."""

WITH_TRANSPARENCY = "LA;16B"
"""Pillow's name of grey levels of 16 bits with transparency, which PNG files have."""


def is_deep(image: Any) -> bool:
    """True for an image of Pillow's, not yet decoded, of which it gives the upper bytes alone."""
    if max(getattr(image, "tag_v2", {}).get(BITS_TAG, ()), default=8) > 8:
        return True
    return any(
        ";16" in _kind(tile) or (tile[0] == "ppm" and tile[3][1] > 255)
        for tile in getattr(image, "tile", ())
    )


def deep_values(image: Any, where: str, again: Callable[[], Any]) -> npt.NDArray[np.int64]:
    """Grey levels (H, W) of such an image, which `again` opens a second time."""
    kinds = {_kind(tile) for tile in image.tile}
    if kinds == {WITH_TRANSPARENCY}:
        grey_bytes = _decoded(image, {WITH_TRANSPARENCY: "RGBA"})
        return 256 * grey_bytes[..., 0] + grey_bytes[..., 1]
    if not kinds <= SWAPPED.keys():
        raise InputError(
            f"{where} has colours of more than 8 bits in an order that is not read "
            f"({', '.join(sorted(kinds))}): save it in RGB of 16 bits, with the three values of a "
            "pixel side by side"
        )
    upper, lower = _decoded(image, {kind: kind for kind in kinds}), _decoded(again(), SWAPPED)
    return grey(256 * upper[None] + lower, where)[0]


def _kind(tile: Any) -> str:
    """Pillow's name of the values in a part of a file."""
    return tile[3] if isinstance(tile[3], str) else str(tile[3][0])


def _decoded(image: Any, names: Mapping[str, str]) -> npt.NDArray[np.int64]:
    """Values of an image as if its file had others of Pillow's names."""

    def renamed(tile: Any) -> Any:
        name, rest = names[_kind(tile)], tile[3][1:]
        told = (*tile[:3], name if isinstance(tile[3], str) else (name, *rest))
        return getattr(type(tile), "_make", tuple)(told)  # a named tuple in newer Pillows

    image.tile = [renamed(tile) for tile in image.tile]
    image.load()  # raises what is wrong; numpy would not
    return np.asarray(image).astype(np.int64)

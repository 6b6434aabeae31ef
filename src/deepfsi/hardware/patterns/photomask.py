"""Files of a static pattern for a photomask: polygons of what is open, or a picture, with a scale.

svg    polygons in micrometres: open pixels as rectangles, merged along rows and then along columns
png    one dot a pixel, open white, with the dots of a metre; grey levels are kept
"""

import io
from typing import NamedTuple

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from deepfsi.base import InputError


class Rectangle(NamedTuple):
    """Open pixels, from the first row and column to before the last."""

    top: int
    left: int
    bottom: int
    right: int


def rectangles(pattern: np.ndarray) -> list[Rectangle]:
    """Rectangles of the open pixels of a pattern (H, P) of 0 and 1, each pixel in one of them."""
    # runs of a row that the row above has, too, lengthen its rectangle
    done: list[Rectangle] = []
    going: dict[tuple[int, int], int] = {}
    for row, line in enumerate(pattern):
        ends = np.flatnonzero(np.diff(line, prepend=0, append=0)).reshape(-1, 2).tolist()
        runs = {(left, right) for left, right in ends}
        closed = [run for run in going if run not in runs]
        done += [Rectangle(going.pop(run), run[0], row, run[1]) for run in closed]
        going |= {run: row for run in sorted(runs) if run not in going}
    done += [Rectangle(top, left, len(pattern), right) for (left, right), top in going.items()]
    return sorted(done)


def as_svg(pattern: np.ndarray, pixel_um: float, about: str) -> bytes:
    """SVG of a pattern (H, P) of 0 and 1, a unit a micrometre, whose polygons are open."""
    if not np.isin(pattern, (0, 1)).all():
        raise InputError(
            "polygons are open or dark, and this pattern has grey levels: learn it with "
            "`levels=2`, or write a .png"
        )
    height, width = (side * pixel_um for side in pattern.shape)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width / 1e3:.10g}mm" '
        f'height="{height / 1e3:.10g}mm" viewBox="0 0 {width:.10g} {height:.10g}">',
        f"<desc>{about}</desc>",
    ]
    for each in rectangles(pattern):
        top, left, bottom, right = (f"{side * pixel_um:.10g}" for side in each)
        corners = f"{left},{top} {right},{top} {right},{bottom} {left},{bottom}"
        lines.append(f'<polygon points="{corners}"/>')
    return "\n".join([*lines, "</svg>", ""]).encode()


def as_png(pattern: np.ndarray, pixel_um: float, about: str) -> bytes:
    """PNG of a pattern (H, P) in 0 .. 1, a dot a pixel."""
    binary = np.isin(pattern, (0, 1)).all()
    picture = Image.fromarray(np.rint(pattern * 255).astype(np.uint8))
    told = PngInfo()
    told.add_text("Description", about)
    written = io.BytesIO()
    dots = 25_400 / pixel_um  # of an inch
    (picture.convert("1", dither=Image.Dither.NONE) if binary else picture).save(
        written, "png", dpi=(dots, dots), pnginfo=told
    )
    return written.getvalue()

"""Readers of what is exported, written from the controllers' documents and without the package.

bmp          Windows bitmap: header of 54 bytes, rows from the bottom, blue, green, red, each row
             filled to 4 bytes; of one bit a pixel two colours follow the header, and the leftmost
             pixel is the highest bit
video        DLPC347x: bit-planes of one picture after another
"""

import csv
import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np


class Shown(NamedTuple):
    """A frame as a controller shows it."""

    mirrors: np.ndarray  # 0 or 1, (rows, columns)
    exposure_us: int
    dark_us: int


def read_bmp(path: Path, depth: int) -> np.ndarray:
    """Values (rows, columns) of 24 bits, blue in the lowest 8, then green, then red; or of one."""
    content = path.read_bytes()
    assert content[:2] == b"BM"
    start, size, width, height, planes, bits, compression = struct.unpack_from(
        "<IIiiHHI", content, 10
    )
    assert (size, planes, bits, compression) == (40, 1, depth, 0)
    stride = 4 * -(-width * bits // 32)
    assert len(content) == start + height * stride
    lines = np.frombuffer(content[start:], np.uint8).reshape(height, stride)[::-1]
    if bits == 1:
        assert content[54:57] + content[58:61] == b"\0\0\0\xff\xff\xff"  # black, and white ON
        return np.unpackbits(lines, axis=1)[:, :width]
    return lines[:, : 3 * width].reshape(height, width, 3) @ np.array([1, 2**8, 2**16])


def play_bitmaps(folder: Path) -> list[Shown]:
    """Frames that a program shows which loads the bitmaps of a table, a bit a pixel."""
    with (folder / "patterns.csv").open() as file:
        return [
            Shown(read_bmp(folder / row["image"], 1), int(row["exposure_us"]), int(row["dark_us"]))
            for row in csv.DictReader(file)
        ]


def play_dlpc350(folder: Path) -> list[Shown]:
    """Frames of a DLPC350: pattern numbers 0-7 are green's bits, 8-15 red's, 16-23 blue's."""
    out, before = [], None
    with (folder / "patterns.csv").open() as file:
        for row in csv.DictReader(file):
            assert row["new_image"] == str(int(row["image"] != before))  # swap the buffer
            before, number = row["image"], int(row["bit"])
            lowest = (8, 16, 0)[number // 8]  # of green, red, blue in a bitmap's pixel
            picture = read_bmp(folder / row["image"], 24)
            mirrors = picture >> lowest + number % 8 & 1
            out.append(Shown(mirrors, int(row["exposure_us"]), int(row["dark_us"])))
    return out


def play_dlpc347x(folder: Path, patterns: int, exposure_us: int, dark_us: int) -> list[Shown]:
    """Frames of a video of pictures with so many patterns each, all for one time."""
    out = []
    for path in sorted((folder / "images").iterdir()):
        picture = read_bmp(path, 24)
        assert picture.max() < 2**patterns  # nothing beyond the patterns that are set
        out += [Shown(picture >> bit & 1, exposure_us, dark_us) for bit in range(patterns)]
    return out

"""Readers of what is exported, written from the controllers' documents and without the package.

bmp          Windows bitmap: header of 54 bytes, rows from the bottom, blue, green, red, each row
             filled to 4 bytes; of one bit a pixel two colours follow the header, and the leftmost
             pixel is the highest bit
settings     of TI's DLPC900REF-SW: "Normal Mode", then file,bits,exposure,dark,colour,in,out
batch file   of TI's DLPC900REF-SW: a command a line, "NAME : 0x00 0x01 ..."
LUT entry    12 bytes, DLPC900 programmer's guide DLPU018J, 0x1A34
video        DLPC347x: bit-planes of one picture after another
"""

import csv
import re
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


def load_settings(folder: Path) -> list[Shown]:
    """Frames that TI's program for a DLPC900 shows once it has loaded its pattern settings."""
    first, *lines = (folder / "settings.txt").read_text().splitlines()
    assert first == "Normal Mode"
    out = []
    for line in lines:
        name, bits, exposure, dark, colour, trigger_in, trigger_out = line.split(",")
        assert (bits, trigger_in, trigger_out) == ("1", "0", "1")
        assert colour in "1234567"
        out.append(Shown(read_bmp(folder / name, 1), int(exposure), int(dark)))
    return out


def play_dlpc900(folder: Path) -> list[Shown]:
    """Frames that a DLPC900 shows once it is given the pictures and the commands."""
    lines = (folder / "sequence.txt").read_text().splitlines()
    commands = [(line.split()[0], [int(each, 0) for each in line.split()[2:]]) for line in lines]
    assert all(re.fullmatch(r"[A-Z_]+ :( 0x[0-9A-F]{2})+", line) for line in lines)
    assert commands[0] == ("DISP_MODE", [3])  # pattern on the fly
    assert {name for name, _ in commands[1:-1]} == {"MBOX_DATA"}
    name, config = commands[-1]
    assert name == "PAT_CONFIG"
    total = list((len(lines) - 2).to_bytes(2, "little"))
    assert config == [*total, *total, 0, 0]  # patterns of the table, and patterns to show
    out = []
    for place, (_, entry) in enumerate(commands[1:-1]):
        assert len(entry) == 12
        assert entry[0] + 256 * entry[1] == place
        assert entry[5] == 0  # not cleared, 1 bit, no lamp, runs on without a trigger
        assert entry[9] == 0  # trigger out 2 is on
        found = entry[10] + 256 * entry[11]
        image, bit = found & 0x7FF, found >> 11
        assert bit < 24
        picture = read_bmp(folder / f"images/{image:04d}.bmp", 24)
        exposure, dark = (entry[at] + 2**8 * entry[at + 1] + 2**16 * entry[at + 2] for at in (2, 6))
        out.append(Shown(picture >> bit & 1, exposure, dark))
    return out


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

"""Pictures of 24 frames as a DLPC900 takes them over USB: a header and run-length encoding.

Programmer's guide DLPU018J, Image Header (2.4.2) and Pattern Image Compression (2.4.3), enhanced
run-length encoding. A count of 128 or more has two bytes, the lower seven bits first. Markers at
the ends of lines are left out, as TI's program does; TI calls them optional (E2E thread 1117715).
The guide does not say which byte of a pixel holds which bit positions: TI's program and
Pycrafter6500 send 16 to 23, then 8 to 15, then 0 to 7, which are red, green and blue of an exported
picture.
"""

import struct

import numpy as np

SIGNATURE = bytes([0x53, 0x70, 0x6C, 0x64])

ENHANCED = 2
"""Compression, as the header names it."""

COPY, END = b"\0\1", b"\0\1\0"
"""Bytes before the number of pixels that are as those above, and at the end of a picture."""


def encode_picture(picture: np.ndarray) -> bytes:
    """Header and pixels of a picture (rows, columns, 3), bytes in the order in which they go."""
    rows, columns, _ = picture.shape
    pixels = picture.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    above = np.zeros((rows, columns), bool)
    above[1:] = pixels[1:] == pixels[:-1]
    lines = zip(picture, pixels, above, strict=True)
    body = b"".join(_encode_line(*line) for line in lines) + END
    # Bytes that the guide calls reserved are as it gives them
    header = struct.pack(
        "<4sHHI8sIBBB21x",
        *(SIGNATURE, columns, rows, len(body), b"\xff" * 8),
        *(0, 0, ENHANCED, 1),
    )
    return header + body


def _encode_line(line: np.ndarray, pixels: np.ndarray, above: np.ndarray) -> bytes:
    """Runs of a line (columns, 3): pixels as those above, one that repeats, or any."""
    changes = (above[1:] != above[:-1]) | ~above[1:] & (pixels[1:] != pixels[:-1])
    starts = np.flatnonzero(np.append(True, changes))
    single = (np.diff(np.append(starts, len(pixels))) == 1) & ~above[starts]
    first = np.append(True, ~(single[1:] & single[:-1]))  # single pixels in a row are one run
    starts, single = starts[first], single[first]
    ends = np.append(starts[1:], len(pixels))
    out = []
    for start, end, any_pixels in zip(starts.tolist(), ends.tolist(), single.tolist(), strict=True):
        count = _count(end - start)
        if above[start]:
            out.append(COPY + count)
        elif any_pixels and end - start > 1:
            out.append(b"\0" + count + line[start:end].tobytes())
        else:
            out.append(count + line[start].tobytes())
    return b"".join(out)


def _count(number: int) -> bytes:
    return bytes([number]) if number < 128 else bytes([number & 127 | 128, number >> 7])

"""Values of test images as text, for records: 32-bit floats, compressed."""

import base64
import zlib

import numpy as np

LARGEST = 2**27
"""Bytes of the values of one test at most."""


def pack(values: np.ndarray) -> str:
    """Values (n,) of images as text."""
    content = np.asarray(values, dtype="<f4").tobytes()
    return base64.b64encode(zlib.compress(content, 9)).decode()


def unpack(text: str) -> np.ndarray:
    """Values (n,) that `pack` wrote; `ValueError` of other text."""
    try:
        reader = zlib.decompressobj()
        content = reader.decompress(base64.b64decode(text, validate=True), LARGEST)
    except zlib.error as error:
        raise ValueError("values of images are damaged") from error
    if not reader.eof or len(content) % 4 or not content:
        raise ValueError("values of images are damaged")
    values = np.frombuffer(content, dtype="<f4").astype(float)
    if not np.isfinite(values).all():
        raise ValueError("values of images are damaged")
    return values

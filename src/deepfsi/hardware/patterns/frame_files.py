"""Files of packed frames, written and read one frame at a time.

npy    frames.npy, uint8 (frames, rows, bytes of a row)
png    frames/0000.png ..., one bit a pixel, ON white
bmp    frames/0000.bmp ..., the same as Windows bitmaps, which programs of controllers read
raw    frames.bin, the same bytes as frames.npy without its header, top row first
planes 24 frames a picture (`planes`)
"""

import hashlib
import io
import math
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np
from PIL import Image, ImageFile
from PIL.BmpImagePlugin import BmpImageFile
from PIL.PngImagePlugin import PngImageFile

from deepfsi.base import SILENT, InputError, Progress, open_regular
from deepfsi.hardware.patterns.planes import (
    load_planes,
    read_picture,
    reading,
    save_picture,
    write_planes,
)
from deepfsi.hardware.patterns.sequence import FrameSettings, Manifest

STREAMS = {"npy": "frames.npy", "raw": "frames.bin"}
"""Files of the formats that hold all frames in one."""

READERS: dict[str, type[ImageFile.ImageFile]] = {"png": PngImageFile, "bmp": BmpImageFile}
"""Readers of the formats that hold a frame in each file."""

BMP_HEADER = 62
"""Bytes of a bitmap of one bit a pixel before its rows."""


def write_frames(
    folder: Path,
    frames: Iterable[np.ndarray],
    total: int,
    settings: FrameSettings,
    report: Progress = SILENT,
) -> list[str]:
    """Write frames as they come, and give the SHA-256 of the packed bits of each."""
    # frames (rows, bytes of a row)
    hashes: list[str] = []
    device, format = settings.device, settings.format

    def hashed() -> Iterator[np.ndarray]:
        for place, frame in enumerate(frames):
            hashes.append(hashlib.sha256(frame.data).hexdigest())
            yield frame
            report((place + 1) / total)

    if format == "planes":
        write_planes(folder, hashed(), total, device)
    elif format in READERS:
        options = {"compress_level": 1} if format == "png" else {}  # no larger
        (folder / "frames").mkdir()
        for place, frame in enumerate(hashed()):
            picture = Image.frombytes("1", (device.columns, device.rows), frame.tobytes())
            save_picture(picture, folder / frame_file(place, total, format), **options)
    else:
        with (folder / STREAMS[format]).open("wb") as stream:
            if format == "npy":
                stream.write(npy_header("|u1", (total, *device.frame_shape)))
            for frame in hashed():
                stream.write(frame.data)
    return hashes


def size(total: int, settings: FrameSettings) -> int:
    """Bytes of so many frames, of a format that does not compress them; else 0."""
    device = settings.device
    if settings.format == "planes":
        return math.ceil(total / device.packed_frames(total)) * 3 * device.rows * device.columns
    if settings.format == "bmp":
        return total * (BMP_HEADER + device.rows * 4 * math.ceil(device.columns / 32))
    return 0 if settings.format == "png" else total * device.frame_bytes


def load_frames(folder: Path, manifest: Manifest) -> Iterator[np.ndarray]:
    """Packed frames of a folder in their order, one at a time."""
    device, total = manifest.device, len(manifest.frames)
    shape = device.frame_shape
    if manifest.format == "planes":
        yield from load_planes(folder, manifest)
        return
    if manifest.format in READERS:
        reader = READERS[manifest.format]
        for place in range(total):
            path = folder / frame_file(place, total, manifest.format)
            with read_picture(path, device, reader, "1") as picture:
                yield np.frombuffer(picture.tobytes(), dtype=np.uint8).reshape(shape)
        return
    header = "|u1" if manifest.format == "npy" else None
    with open_array(folder / STREAMS[manifest.format], header, (total, *shape)) as file:
        for _ in range(total):
            yield np.frombuffer(file.read(device.frame_bytes), dtype=np.uint8).reshape(shape)


def frame_file(place: int, total: int, format: str) -> str:
    """File of a frame, with as many digits as the last one needs."""
    return f"frames/{place:0{max(4, len(str(total - 1)))}d}.{format}"


def npy_header(kind: str, shape: tuple[int, ...]) -> bytes:
    """Header of an array's .npy file, as `numpy.save` writes it."""
    header = io.BytesIO()
    content = {"descr": kind, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(header, content)
    return header.getvalue()


@contextmanager
def open_array(
    path: Path, kind: str | None, shape: tuple[int, ...], first: int = 0
) -> Iterator[IO[bytes]]:
    """Open a file at the start of an array's data, certain that all of it is there."""
    again = "export the patterns again"
    with reading(str(path)), open_regular(path, advice=again) as file:
        dtype = np.dtype(kind or "u1")
        if kind is not None:
            header = npy_header(kind, shape)
            if file.read(len(header)) != header:
                raise InputError(
                    f"{path} is not a numpy file of {dtype} numbers of shape {shape}, as "
                    f"manifest.json says: {again}"
                )
        wanted = dtype.itemsize * math.prod(shape)
        here = os.fstat(file.fileno()).st_size - file.tell()
        if here > wanted:
            raise InputError(f"{path} has {here - wanted} bytes too many: {again}")
        if here < wanted:
            place = first + here // (dtype.itemsize * math.prod(shape[1:]))
            raise InputError(
                f"{path} has {here} bytes of data, and manifest.json says {wanted}: it breaks "
                f"off in frame {place}; {again}"
            )
        yield file

"""Files of packed frames, written and read one frame at a time.

npy    frames.npy, uint8 (frames, rows, bytes of a row)
png    frames/0000.png ..., one bit a pixel, ON white
raw    frames.bin, the same bytes as frames.npy without its header, top row first
planes 24 frames a picture, with tables (`planes`)
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
from PIL import Image
from PIL.PngImagePlugin import PngImageFile

from deepfsi.errors import InputError
from deepfsi.files import open_regular
from deepfsi.hardware.patterns.planes import (
    load_planes,
    read_picture,
    reading,
    save_picture,
    write_planes,
)
from deepfsi.hardware.patterns.sequence import FrameSettings, Manifest
from deepfsi.progress import SILENT, Report

STREAMS = {"npy": "frames.npy", "raw": "frames.bin"}
"""Files of the formats that hold all frames in one."""


def write_frames(
    folder: Path,
    frames: Iterable[np.ndarray],
    total: int,
    settings: FrameSettings,
    report: Report = SILENT,
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
    elif format == "png":
        (folder / "frames").mkdir()
        for place, frame in enumerate(hashed()):
            picture = Image.frombytes("1", (device.columns, device.rows), frame.tobytes())
            save_picture(picture, folder / _png(place, total), compress_level=1)  # no larger
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
    return 0 if settings.format == "png" else total * device.frame_bytes


def load_frames(folder: Path, manifest: Manifest) -> Iterator[np.ndarray]:
    """Packed frames of a folder in their order, one at a time."""
    device, total = manifest.device, len(manifest.frames)
    shape = device.frame_shape
    if manifest.format == "planes":
        yield from load_planes(folder, manifest)
        return
    if manifest.format == "png":
        for place in range(total):
            with read_picture(folder / _png(place, total), device, PngImageFile, "1") as picture:
                yield np.frombuffer(picture.tobytes(), dtype=np.uint8).reshape(shape)
        return
    header = "|u1" if manifest.format == "npy" else None
    with open_array(folder / STREAMS[manifest.format], header, (total, *shape)) as file:
        for _ in range(total):
            yield np.frombuffer(file.read(device.frame_bytes), dtype=np.uint8).reshape(shape)


def _png(place: int, total: int) -> str:
    """File of a frame, with as many digits as the last one needs."""
    return f"frames/{place:0{max(4, len(str(total - 1)))}d}.png"


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

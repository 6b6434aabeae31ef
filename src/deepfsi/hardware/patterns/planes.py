"""Frames as the bit-planes of 24-bit pictures, for controllers that take them so.

images/0000.bmp ...   24 bits a pixel: each bit of a pixel is a mirror of another frame

Frames fill the pictures in the order in which they are shown. `Device.planes` says which colours
hold bit positions 0 to 7, 8 to 15 and 16 to 23, each colour's lowest bit first.
"""

import io
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image, ImageFile
from PIL.BmpImagePlugin import BmpImageFile

from deepfsi.base import InputError, open_regular
from deepfsi.camera import Device
from deepfsi.hardware.patterns.sequence import Manifest

LARGEST_PICTURE = 2**31
"""Bytes of a picture of frames at most."""

Place = tuple[int, int]
"""Picture that holds a frame, and the bit position in it."""


def place_frames(manifest: Manifest) -> list[Place]:
    """Place of each frame of a manifest."""
    total = len(manifest.frames)
    return [divmod(frame, manifest.device.packed_frames(total)) for frame in range(total)]


def write_planes(folder: Path, frames: Iterable[np.ndarray], total: int, device: Device) -> None:
    """Write frames, each (rows, bytes of a row), as they come."""
    (folder / "images").mkdir()
    for image, picture in enumerate(pack_planes(frames, total, device)):
        save_picture(Image.fromarray(picture), folder / picture_file(image))


def pack_planes(frames: Iterable[np.ndarray], total: int, device: Device) -> Iterator[np.ndarray]:
    """Pictures of frames, each (rows, columns, red green blue), as the frames come."""
    together = device.packed_frames(total)
    picture = np.zeros((device.rows, device.columns, 3), np.uint8)
    for place, frame in enumerate(frames):
        bit = place % together
        lit = np.unpackbits(frame, axis=1, count=device.columns)
        picture[..., _channel(device, bit)] |= lit << bit % 8
        if bit == together - 1 or place == total - 1:
            yield picture
            picture = np.zeros_like(picture)


def load_planes(folder: Path, manifest: Manifest) -> Iterator[np.ndarray]:
    """Packed frames of a folder in their order, one at a time."""
    device = manifest.device
    for image, bit in place_frames(manifest):
        if bit == 0:
            with read_picture(folder / picture_file(image), device, BmpImageFile, "RGB") as opened:
                picture = np.asarray(opened)
        yield np.packbits(picture[..., _channel(device, bit)] >> bit % 8 & 1, axis=1)


@contextmanager
def reading(name: str) -> Iterator[None]:
    """Turn errors of reading a file into one `InputError`."""
    try:
        yield
    except FileNotFoundError:
        raise InputError(f"{name} is missing: export the patterns again") from None
    except InputError:
        raise
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"{name} cannot be read ({error}): export the patterns again") from None


def save_picture(picture: Image.Image, path: Path, **options: int) -> None:
    """Write a picture in the format that its name ends in."""
    file = io.BytesIO()  # Pillow itself loses what a full disk does not take
    picture.save(file, Image.registered_extensions()[path.suffix], **options)
    path.write_bytes(file.getvalue())


def picture_file(image: int) -> str:
    """File of a picture of frames."""
    return f"images/{image:04d}.bmp"


def _channel(device: Device, bit: int) -> int:
    """Place of a bit position's colour in a pixel of red, green and blue."""
    return "RGB".index(device.planes[bit // 8])


@contextmanager
def read_picture(
    path: Path, device: Device, opener: type[ImageFile.ImageFile], mode: str
) -> Iterator[Image.Image]:
    """Open the picture of a frame, or of several, that has a device's size and this mode."""
    advice = "export the patterns again"
    opened = open_regular(path, LARGEST_PICTURE, advice)
    with reading(str(path)), opened as file, opener(file) as picture:
        if picture.mode != mode or picture.size != (device.columns, device.rows):
            depth = "one bit" if mode == "1" else "24 bits"
            raise InputError(
                f"{path} is a {picture.size[0]} x {picture.size[1]} {picture.format} of mode "
                f"{picture.mode}, not {device.columns} x {device.rows} at {depth} a pixel: export "
                "the patterns again"
            )
        yield picture

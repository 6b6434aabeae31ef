"""Frames as the bit-planes of 24-bit pictures, for controllers that take them so.

images/0000.bmp ...   24 bits a pixel: each bit of a pixel is a mirror of another frame
patterns.csv          the frames in the order in which they are shown, and where each is
sequence.txt          of a DLPC900, the same as commands in a batch file of TI's program

Frames fill the pictures in the order in which they are shown. `Device.planes` says which colours
hold bit positions 0 to 7, 8 to 15 and 16 to 23, each colour's lowest bit first.
"""

import csv
import io
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image, ImageFile
from PIL.BmpImagePlugin import BmpImageFile

from deepfsi.devices import Device
from deepfsi.errors import InputError
from deepfsi.files import open_regular, read_regular
from deepfsi.hardware.patterns.sequence import Manifest

DISPLAY_MODE, DEFINE_PATTERN, CONFIGURE_TABLE = 0x1A1B, 0x1A34, 0x1A31
"""USB commands of a DLPC900: programmer's guide DLPU018."""

BATCH_NAMES = {
    DISPLAY_MODE: "DISP_MODE",
    DEFINE_PATTERN: "MBOX_DATA",
    CONFIGURE_TABLE: "PAT_CONFIG",
}
"""The same in batch files of TI's program."""

ON_THE_FLY = 3
"""Display mode of a DLPC900 in which its pictures come over USB."""

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
        save_picture(Image.fromarray(picture), folder / _file(image))


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
            with read_picture(folder / _file(image), device, BmpImageFile, "RGB") as opened:
                picture = np.asarray(opened)
        yield np.packbits(picture[..., _channel(device, bit)] >> bit % 8 & 1, axis=1)


def tables(manifest: Manifest) -> dict[str, str]:
    """Files that say how the pictures of a manifest are shown: name and content."""
    out = {"patterns.csv": _table(manifest)}
    if manifest.device.controller == "dlpc900":
        out["sequence.txt"] = _commands(manifest)
    return out


def check_tables(folder: Path, manifest: Manifest) -> None:
    """Raise `InputError` unless the tables of a folder say what its manifest says."""
    for name, content in tables(manifest).items():
        again, wanted = "export the patterns again", content.encode()
        if read_regular(folder / name, 2 * len(wanted), again) != wanted:
            raise InputError(
                f"{folder / name} does not say what manifest.json says: export the patterns again"
            )


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


def _file(image: int) -> str:
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


def _times(manifest: Manifest) -> list[tuple[int, int]]:
    """Exposure and dark time of each frame, µs."""
    # A controller of the DLPC347x family turns all mirrors OFF between frames, for what its devices
    # have as time to settle; the others change from frame to frame
    device = manifest.device
    dark = round(device.settle_us) if device.controller == "dlpc347x" else 0
    return [(frame.picture_us - dark, dark) for frame in manifest.frames]


def _table(manifest: Manifest) -> str:
    """Rows of patterns.csv, the frames in their order."""
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(
        ["pattern", "image", "bit", "exposure_us", "dark_us", "trigger_out", "new_image", "shows"]
    )
    every = zip(place_frames(manifest), _times(manifest), manifest.frames, strict=True)
    for pattern, ((image, bit), (exposure, dark), frame) in enumerate(every):
        rows.writerow([pattern, _file(image), bit, exposure, dark, 1, int(bit == 0), str(frame)])
    return out.getvalue()


def dlpc900_commands(manifest: Manifest) -> list[tuple[int, bytes]]:
    """USB commands that give a DLPC900 its mode, its pattern table, and how much of it to show."""
    # Guide DLPU018J: Display Mode Selection 0x1A1B, Pattern Display LUT Definition 0x1A34 and
    # Configuration 0x1A31. Lamps of the board stay off, no frame waits for a trigger, and a start
    # shows as many patterns as the table has, that is, each once
    commands = [(DISPLAY_MODE, bytes([ON_THE_FLY]))]
    every = enumerate(zip(place_frames(manifest), _times(manifest), strict=True))
    for pattern, ((image, bit), (exposure, dark)) in every:
        entry = pattern.to_bytes(2, "little") + exposure.to_bytes(3, "little")
        entry += b"\0"  # do not clear, 1 bit, no lamp, no trigger in
        entry += dark.to_bytes(3, "little") + b"\0"  # trigger out 2 marks its start
        commands.append((DEFINE_PATTERN, entry + (image | bit << 11).to_bytes(2, "little")))
    total = len(manifest.frames)
    commands.append((CONFIGURE_TABLE, total.to_bytes(2, "little") + total.to_bytes(4, "little")))
    return commands


def _commands(manifest: Manifest) -> str:
    """Batch file for a DLPC900, a command a line as those of DLPC900REF-SW: "NAME : bytes"."""
    return "".join(
        f"{BATCH_NAMES[command]} : {' '.join(f'0x{byte:02X}' for byte in content)}\n"
        for command, content in dlpc900_commands(manifest)
    )

"""Tables of the frames for whoever loads them into a controller: which file, for how long.

patterns.csv   the frames in the order in which they are shown, beside files of any format
settings.txt   of a DLPC900 and one-bit bitmaps: the same, as TI's program loads them
sequence.txt   of a DLPC900 and bit-planes: the same, as commands in a batch file of TI's program

`settings.txt` has the lines that TI's program DLPC900REF-SW writes and reads as pattern settings:
file, bits, exposure and dark time in µs, colour of the board's lamps, trigger in, trigger out 2.

`CONTROLLER_TABLES` says which controller has which table beside frames of which format.
"""

import csv
import io
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import ClassVar

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.files import read_regular
from deepfsi.hardware.patterns.frames import AGAIN, FRAME_FORMATS, PLANES_FORMAT
from deepfsi.hardware.patterns.manifest import Manifest

PATTERNS_TABLE = "patterns.csv"
"""Table of every folder."""

TABLE_OPTIONAL = ("npy", "raw", "png")
"""Formats beside which folders of earlier versions have no table."""


def _frame_times(manifest: Manifest) -> list[tuple[int, int]]:
    """Exposure and dark time of each frame, µs."""
    # A controller of the DLPC347x family turns all mirrors OFF between frames, for what its devices
    # have as time to settle; the others change from frame to frame
    device = manifest.device
    dark = round(device.settle_us) if device.controller == "dlpc347x" else 0
    return [(frame.picture_us - dark, dark) for frame in manifest.frames]


def _locations(manifest: Manifest) -> list[tuple[str, int | None]]:
    """File of each frame, and the bit in it; no bit in a file of all frames."""
    total = len(manifest.frames)
    form = FRAME_FORMATS[manifest.format]
    return [form.location(index, total, manifest.device) for index in range(total)]


def _patterns_table(manifest: Manifest) -> str:
    """Rows of patterns.csv, the frames in their order."""
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(
        [
            *("pattern", "image", "bit", "exposure_us", "dark_us", "trigger_out", "new_image"),
            *("shows", "settle_us"),
        ]
    )
    settle = f"{manifest.device.settle_us:g}"  # of the exposure, or of a DLPC347x the dark time
    frames = zip(_locations(manifest), _frame_times(manifest), manifest.frames, strict=True)
    for pattern, ((image, bit), (exposure, dark), frame) in enumerate(frames):
        new_image = int(not bit)
        where = [pattern, image, "" if bit is None else bit]
        rows.writerow([*where, exposure, dark, 1, new_image, str(frame), settle])
    return out.getvalue()


class Dlpc900:
    """Pattern sequences of a DLPC900, as its programmer's guide DLPU018J has them."""

    DISPLAY_MODE: ClassVar[int] = 0x1A1B
    """USB command: display mode selection."""

    DEFINE_PATTERN: ClassVar[int] = 0x1A34
    """USB command: pattern display LUT definition."""

    CONFIGURE_TABLE: ClassVar[int] = 0x1A31
    """USB command: pattern display LUT configuration."""

    ON_THE_FLY: ClassVar[int] = 3
    """Display mode in which its pictures come over USB."""

    BATCH_NAMES: ClassVar[dict[int, str]] = {
        DISPLAY_MODE: "DISP_MODE",
        DEFINE_PATTERN: "MBOX_DATA",
        CONFIGURE_TABLE: "PAT_CONFIG",
    }
    """Commands in batch files of TI's program."""

    RED: ClassVar[int] = 1
    """Colour of the lamps in TI's program, which has no other for none. Light is from outside."""

    @classmethod
    def commands(cls, manifest: Manifest) -> list[tuple[int, bytes]]:
        """USB commands for its mode, its pattern table, and how much of it to show."""
        # Lamps of the board stay off, no frame waits for a trigger, and a start shows as many
        # patterns as the table has, that is, each once
        commands = [(cls.DISPLAY_MODE, bytes([cls.ON_THE_FLY]))]
        total = len(manifest.frames)
        for pattern, (exposure, dark) in enumerate(_frame_times(manifest)):
            image, bit = PLANES_FORMAT.position(pattern, total, manifest.device)
            entry = pattern.to_bytes(2, "little") + exposure.to_bytes(3, "little")
            entry += b"\0"  # do not clear, 1 bit, no lamp, no trigger in
            entry += dark.to_bytes(3, "little") + b"\0"  # trigger out 2 marks its start
            entry += (image | bit << 11).to_bytes(2, "little")
            commands.append((cls.DEFINE_PATTERN, entry))
        size = total.to_bytes(2, "little") + total.to_bytes(4, "little")
        commands.append((cls.CONFIGURE_TABLE, size))
        return commands

    @staticmethod
    def pictures(frames: Iterable[np.ndarray], manifest: Manifest) -> Iterator[np.ndarray]:
        """Pictures that hold packed frames, uint8 (rows, columns, red green blue)."""
        return PLANES_FORMAT.pictures(frames, len(manifest.frames), manifest.device)

    @classmethod
    def batch_file(cls, manifest: Manifest) -> str:
        """Commands a line, as those of DLPC900REF-SW: "NAME : bytes"."""
        return "".join(
            f"{cls.BATCH_NAMES[command]} : {' '.join(f'0x{byte:02X}' for byte in content)}\n"
            for command, content in cls.commands(manifest)
        )

    @classmethod
    def settings_file(cls, manifest: Manifest) -> str:
        """Pattern settings of TI's program."""
        frames = zip(_locations(manifest), _frame_times(manifest), strict=True)
        lines = [
            f"{file},1,{exposure},{dark},{cls.RED},0,1" for (file, _), (exposure, dark) in frames
        ]
        return "\n".join(["Normal Mode", *lines, ""])


CONTROLLER_TABLES: dict[tuple[str, str], tuple[str, Callable[[Manifest], str]]] = {
    ("dlpc900", "planes"): ("sequence.txt", Dlpc900.batch_file),
    ("dlpc900", "bmp"): ("settings.txt", Dlpc900.settings_file),
}
"""Tables besides patterns.csv: controller and format, name and content."""


def controller_tables(manifest: Manifest) -> dict[str, str]:
    """Files that say how the frames of a manifest are shown: name and content."""
    tables = {PATTERNS_TABLE: _patterns_table(manifest)}
    special = CONTROLLER_TABLES.get((manifest.device.controller, manifest.format))
    if special is not None:
        name, content = special
        tables[name] = content(manifest)
    return tables


def check_tables(folder: Path, manifest: Manifest) -> None:
    """Raise `InputError` unless the tables of a folder say what its manifest says."""
    for name, content in controller_tables(manifest).items():
        # Patterns of earlier versions have no table beside packed frames, and fewer columns
        if manifest.format in TABLE_OPTIONAL and not (folder / name).exists():
            continue
        allowed = [content]
        if name == PATTERNS_TABLE:
            allowed.append("".join(f"{row.rpartition(',')[0]}\n" for row in content.splitlines()))
        stored = read_regular(folder / name, 2 * len(content.encode()), AGAIN)
        if stored not in [table.encode() for table in allowed]:
            raise InputError(f"{folder / name} does not say what manifest.json says: {AGAIN}")

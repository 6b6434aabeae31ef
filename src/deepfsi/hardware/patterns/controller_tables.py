"""Tables of the frames for whoever loads them into a controller: which file, for how long.

patterns.csv   the frames in the order in which they are shown, beside files of any format
settings.txt   of a DLPC900 and one-bit bitmaps: the same, as TI's program loads them
sequence.txt   of a DLPC900 and bit-planes: the same, as commands in a batch file of TI's program

`settings.txt` has the lines that TI's program DLPC900REF-SW writes and reads as pattern settings:
file, bits, exposure and dark time in µs, colour of the board's lamps, trigger in, trigger out 2.
"""

import csv
import io
from pathlib import Path

from deepfsi.base import InputError, read_regular
from deepfsi.hardware.patterns.frame_files import STREAMS, frame_file
from deepfsi.hardware.patterns.planes import picture_file, place_frames
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

TABLE = "patterns.csv"

RED = 1
"""Colour of a board's lamps in TI's program, which has no other for none. Light is from outside."""


def tables(manifest: Manifest) -> dict[str, str]:
    """Files that say how the frames of a manifest are shown: name and content."""
    out = {TABLE: _table(manifest)}
    if manifest.device.controller == "dlpc900":
        if manifest.format == "planes":
            out["sequence.txt"] = _commands(manifest)
        if manifest.format == "bmp":
            out["settings.txt"] = _settings(manifest)
    return out


def check_tables(folder: Path, manifest: Manifest) -> None:
    """Raise `InputError` unless the tables of a folder say what its manifest says."""
    again = "export the patterns again"
    for name, content in tables(manifest).items():
        # Patterns of earlier versions have no table beside packed frames, and fewer columns
        if manifest.format in (*STREAMS, "png") and not (folder / name).exists():
            continue
        allowed = [content] + [_without_last(content)] * (name == TABLE)
        there = read_regular(folder / name, 2 * len(content.encode()), again)
        if there not in [each.encode() for each in allowed]:
            raise InputError(f"{folder / name} does not say what manifest.json says: {again}")


def _without_last(table: str) -> str:
    """A table as earlier versions wrote it, without the last column."""
    return "".join(f"{line.rpartition(',')[0]}\n" for line in table.splitlines())


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
        [
            *("pattern", "image", "bit", "exposure_us", "dark_us", "trigger_out", "new_image"),
            *("shows", "settle_us"),
        ]
    )
    settle = f"{manifest.device.settle_us:g}"  # of the exposure, or of a DLPC347x the dark time
    every = zip(_files(manifest), _times(manifest), manifest.frames, strict=True)
    for pattern, ((image, bit, new), (exposure, dark), frame) in enumerate(every):
        rows.writerow([pattern, image, bit, exposure, dark, 1, new, str(frame), settle])
    return out.getvalue()


def _files(manifest: Manifest) -> list[tuple[str, str, int]]:
    """File of each frame, its bit position in a picture of several, and 1 for a new picture."""
    total = len(manifest.frames)
    if manifest.format == "planes":
        return [(picture_file(i), str(bit), int(bit == 0)) for i, bit in place_frames(manifest)]
    if manifest.format in STREAMS:
        return [(STREAMS[manifest.format], "", 1)] * total
    return [(frame_file(place, total, manifest.format), "0", 1) for place in range(total)]


def _settings(manifest: Manifest) -> str:
    """Pattern settings of TI's program for a DLPC900."""
    every = zip(_files(manifest), _times(manifest), strict=True)
    lines = [f"{file},1,{exposure},{dark},{RED},0,1" for (file, *_), (exposure, dark) in every]
    return "\n".join(["Normal Mode", *lines, ""])


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

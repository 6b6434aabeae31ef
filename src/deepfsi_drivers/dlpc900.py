"""Boards with TI's DLPC900 (DLP6500, DLP9000, DLP670S, DLP500YX) over USB, pattern on the fly.

**Untested on hardware.** It was written from TI's programmer's guide DLPU018J, and is tested
against a fake that reads its bytes by that guide. Watch its first runs with an oscilloscope on
TRIG_OUT_2, whose polarity and delay are left as they are set on the board.

The sections of the guide that say what is sent: USB Interface (1.2; reports, flags, replies),
Hardware Status (2.1.1, 0x1A0A), Main Status (2.1.3, 0x1A0C), Reading Hardware Configuration (2.1.5,
0x0206), Read Error Code (2.1.6, 0x0100), Display Mode Selection (0x1A1B), Pattern Display
Start/Stop (0x1A24), Pattern Display LUT Definition (0x1A34) and Configuration (0x1A31), Initialize
Pattern BMP Load (0x1A2A, of the second controller 0x1A2C), Pattern BMP Load (0x1A2B and 0x1A2D),
and the Pattern On-The-Fly example for their order. Not from the guide: the USB numbers, that
reports have 64 bytes, that a load is not to be answered (TI's program), and which bit of the main
status says that the sequencer runs, as its readers in public programs have it. That this bit
falls at the end of a pass is assumed.

Pictures are loaded once, 24 frames each; the table says for how long each frame is shown, and a
start shows all of it once. A picture goes over USB as a header and run-length encoded pixels: Image
Header (2.4.2) and Pattern Image Compression (2.4.3), enhanced run-length encoding. A count of 128
or more has two bytes, the lower seven bits first. Markers at the ends of lines are left out, as
TI's program does; TI calls them optional (E2E thread 1117715). The guide does not say which byte of
a pixel holds which bit positions: TI's program and Pycrafter6500 send 16 to 23, then 8 to 15, then
0 to 7, which are red, green and blue of an exported picture.
"""

import struct
import time
from collections.abc import Iterator
from functools import partial
from typing import Any, Self

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Progress
from deepfsi.camera.device import BIT_PLANES, DEVICES, Device
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.frames import PLANES_FORMAT
from deepfsi.patterns.manifest import Manifest
from deepfsi_drivers.device_errors import import_library, let_go, refusals

DMDS = {1: "dlp6500", 2: "dlp9000", 3: "dlp670s", 4: "dlp500yx"}
"""Devices by the hardware type that a board reports."""


class _Usb:
    """Numbers of the board, of its reports, and bits of the byte of flags."""

    VENDOR = 0x0451
    PRODUCT = 0xC900
    REPORT_BYTES = 64
    PACKET_BYTES = 504  # of a picture that one command holds
    READ = 1 << 7
    REPLY = 1 << 6
    FAILED = 1 << 5


class _CommandCode:
    """Commands, and the data that some of them carry."""

    ERROR_CODE = 0x0100
    HARDWARE = 0x0206
    HARDWARE_STATUS = 0x1A0A
    MAIN_STATUS = 0x1A0C
    DISPLAY_MODE = 0x1A1B
    ON_THE_FLY = b"\3"
    START_STOP = 0x1A24
    STOP = b"\0"
    START = b"\2"
    CONFIGURE_TABLE = 0x1A31
    DEFINE_PATTERN = 0x1A34
    # Beginning and data of a picture, for the first controller and the second
    LOADS = (0x1A2A, 0x1A2B), (0x1A2C, 0x1A2D)


class _Status:
    """Bits of the hardware status, and of the main status."""

    READY = 1 << 0
    SECOND = 1 << 4
    FAULTS = 1 << 1 | 1 << 2 | 1 << 3 | 1 << 6 | 1 << 7
    RUNS = 1 << 1  # of the main status


REPLY_S = 2.0
"""Time for an answer, seconds."""

LATEST_S = 5.0
"""Time by which a mode or a pass may end late, seconds."""

DLPC900_POLL_S = 0.002
"""Time between two questions, seconds."""


class _Link:
    """Commands to a DLPC900 as reports of a HID device, and its replies."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self._sequence = 0

    def write(self, command: int, data: bytes, reply: bool = True) -> None:
        """Send a command; with `reply`, wait for the answer and raise a refusal."""
        self._send(_Usb.REPLY if reply else 0, command, data)
        if reply:
            self._answer(command)

    def read(self, command: int) -> int:
        """First byte of the answer to a read command."""
        self._send(_Usb.READ | _Usb.REPLY, command)
        answer = self._answer(command)
        if not answer:
            raise InputError(f"the DLPC900's answer to command 0x{command:04X} is empty")
        return answer[0]

    def check(self, command: int) -> None:
        """Raise `InputError` if the board refused the last command."""
        if code := self.read(_CommandCode.ERROR_CODE):
            raise InputError(
                f"the DLPC900 refused command 0x{command:04X} with error {code}: see Read Error "
                "Code in TI's guide DLPU018J"
            )

    def _send(self, flags: int, command: int, data: bytes = b"") -> None:
        self._sequence = (self._sequence + 1) % 256
        message = bytes([flags, self._sequence]) + (2 + len(data)).to_bytes(2, "little")
        message += command.to_bytes(2, "little") + data
        offsets = iter(range(0, len(message), _Usb.REPORT_BYTES))
        try:
            self._reports(message, offsets)
        except KeyboardInterrupt:
            self._reports(message, offsets)  # it takes what comes next as the rest of this command
            raise

    def _reports(self, message: bytes, offsets: Iterator[int]) -> None:
        for offset in offsets:
            report = message[offset : offset + _Usb.REPORT_BYTES].ljust(_Usb.REPORT_BYTES, b"\0")
            if self._device.write(b"\0" + report) < 0:  # the report's number comes first
                raise OSError("a report was not sent")

    def _answer(self, command: int) -> bytes:
        """Data of the reply to the last command; replies to earlier ones are passed over."""
        until = time.monotonic() + REPLY_S
        while (left := until - time.monotonic()) > 0:
            reply = bytes(self._device.read(_Usb.REPORT_BYTES, max(1, round(left * 1e3))))
            if reply[1:2] == bytes([self._sequence]):
                break
        else:
            raise InputError(
                f"the DLPC900 does not answer command 0x{command:04X}: switch the board off and on"
            )
        if reply[0] & _Usb.FAILED:
            if command != _CommandCode.ERROR_CODE:
                self.check(command)
            raise InputError(f"the DLPC900 refused command 0x{command:04X} and gives no reason")
        return reply[4 : 4 + int.from_bytes(reply[2:4], "little")]


class Dlpc900Projector:
    """Projector of pattern folders on a DLPC900 board. Untested on hardware: see the module."""

    def __init__(self) -> None:
        self._hid: Any = None
        self._pass_s = self._due = 0.0  # of the frames that are loaded; when a pass is to end

    def __enter__(self) -> Self:
        """Open the first board that is found, and ask what it is."""
        library = import_library("the DLPC900", "hidapi", "hid")
        with _refusals("be opened"):
            self._hid = library.device()
            self._hid.open(_Usb.VENDOR, _Usb.PRODUCT)
            try:
                self._link = _Link(self._hid)
                kind = self._link.read(_CommandCode.HARDWARE)
                if kind not in DMDS:
                    raise InputError(
                        f"the DLPC900 has a device of hardware type {kind}, which is none of "
                        f"{', '.join(DMDS.values())}"
                    )
                self._device = DEVICES[DMDS[kind]]
                self._controllers = 2 if _healthy(self._link) & _Status.SECOND else 1
            except BaseException:
                self._hid.close()
                raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        """Stop and close the board."""
        let_go(kind, self.halt, self._hid.close)

    def load(self, patterns: Patterns, report: Progress = SILENT) -> None:
        """Send frames of any format to the board, in place of earlier ones."""
        link = self._link
        manifest = _for_board(patterns, self._device)
        self.halt()
        self._pass_s = 0.0
        # Encoding takes about a tenth of the time, USB the rest
        pictures = _encoded(patterns, manifest, self._controllers, report.between(0.0, 0.1))
        with _refusals("load frames"):
            link.write(_CommandCode.DISPLAY_MODE, _CommandCode.ON_THE_FLY)
            _wait_for_mode(link)
            for entry in _table(manifest):
                link.write(_CommandCode.DEFINE_PATTERN, entry)
            # A start shows each pattern of the table once
            total = len(manifest.frames)
            size = total.to_bytes(2, "little") + total.to_bytes(4, "little")
            link.write(_CommandCode.CONFIGURE_TABLE, size)
            _load(link, pictures, report.between(0.1, 1.0))
        self._pass_s = manifest.pass_s

    def run(self) -> None:
        """Start one pass."""
        link = self._link
        if not self._pass_s:
            raise InputError("no patterns on the DLPC900: load a pattern folder first")
        with _refusals("show patterns"):
            if link.read(_CommandCode.MAIN_STATUS) & _Status.RUNS:
                raise InputError("the DLPC900 still shows a pass: wait for it or halt it")
            # Stopped first, so that a start begins with the first pattern
            link.write(_CommandCode.START_STOP, _CommandCode.STOP)
            link.write(_CommandCode.START_STOP, _CommandCode.START)
        self._due = time.monotonic() + self._pass_s

    def wait(self) -> None:
        """Return when the pass has ended; Ctrl-C is heard meanwhile."""
        link = self._link
        with _refusals("show patterns"):
            # A status read before the first pattern may already say that nothing runs
            while (
                time.monotonic() < self._due or link.read(_CommandCode.MAIN_STATUS) & _Status.RUNS
            ):
                if time.monotonic() > self._due + LATEST_S:
                    raise InputError(
                        f"the frames should have ended {LATEST_S:g} s ago and have not: check that "
                        "no other program drives the DLPC900"
                    )
                time.sleep(DLPC900_POLL_S)
            _healthy(link)

    def halt(self) -> None:
        """Stop at once."""
        with _refusals("be halted"):
            self._link.write(_CommandCode.START_STOP, _CommandCode.STOP)


def _healthy(link: _Link) -> int:
    """Hardware status, if it has no fault."""
    status = link.read(_CommandCode.HARDWARE_STATUS)
    if status & _Status.FAULTS or not status & _Status.READY:
        raise InputError(
            f"the DLPC900 reports a fault, hardware status 0x{status:02X}: check the board and its "
            "firmware, then switch it off and on"
        )
    return status


def _for_board(patterns: Patterns, device: Device) -> Manifest:
    """Manifest of a folder for the device of a board; `InputError` if it cannot be shown."""
    manifest = patterns.manifest
    exported = manifest.device
    if (exported.columns, exported.rows) != (device.columns, device.rows):
        raise InputError(
            f"'{patterns.folder}' is made for {exported.columns} x {exported.rows} mirrors and the "
            f"board's {device.name} has {device.columns} x {device.rows}: export for that device"
        )
    manifest = manifest.model_copy(update={"device": device})
    manifest.check_limits()
    return manifest


def _table(manifest: Manifest) -> Iterator[bytes]:
    """Entries of the board's table of patterns, one for each frame."""
    for pattern, frame in enumerate(manifest.frames):
        image, bit = divmod(pattern, BIT_PLANES)
        yield (
            pattern.to_bytes(2, "little")
            + frame.picture_us.to_bytes(3, "little")
            + b"\0"  # do not clear, 1 bit, no lamp of the board, no trigger in
            + bytes(3)  # no dark time
            + b"\0"  # trigger out 2 marks its start
            + (image | bit << 11).to_bytes(2, "little")
        )


def _encoded(
    patterns: Patterns, manifest: Manifest, controllers: int, report: Progress
) -> list[tuple[bytes, ...]]:
    """Encoded pictures of a folder; two controllers have halves, the left one first."""
    total = len(manifest.frames)
    width = manifest.device.columns // controllers
    out = []
    frames = patterns.frames()
    for picture in PLANES_FORMAT.pictures(frames, total, manifest.device):
        halves = (picture[:, k * width : (k + 1) * width] for k in range(controllers))
        out.append(tuple(encode_picture(half) for half in halves))
        report(min(len(out) * BIT_PLANES / total, 1.0))
    return out


def _load(link: _Link, pictures: list[tuple[bytes, ...]], report: Progress) -> None:
    """Send pictures, the last one first, as the guide wants them."""
    total = sum(len(half) for halves in pictures for half in halves)
    sent = 0
    for index, halves in reversed(list(enumerate(pictures))):
        for content, (begin, fill) in zip(halves, _CommandCode.LOADS, strict=False):
            link.write(begin, index.to_bytes(2, "little") + len(content).to_bytes(4, "little"))
            for offset in range(0, len(content), _Usb.PACKET_BYTES):
                packet = content[offset : offset + _Usb.PACKET_BYTES]
                # TI's program asks for no answer to these
                link.write(fill, len(packet).to_bytes(2, "little") + packet, reply=False)
                sent += len(packet)
                report(sent / total)
            link.check(fill)


def _wait_for_mode(link: _Link) -> None:
    """Return when the board loads patterns on the fly."""
    until = time.monotonic() + LATEST_S
    while link.read(_CommandCode.DISPLAY_MODE) & 3 != _CommandCode.ON_THE_FLY[0]:
        if time.monotonic() > until:
            raise InputError("the DLPC900 does not load patterns on the fly: update its firmware")
        time.sleep(DLPC900_POLL_S)


def _reason(error: Exception) -> str | None:
    # hidapi raises `OSError`, and `ValueError` for a device that was closed; another package of its
    # name lacks attributes
    return str(error) if isinstance(error, OSError | ValueError | AttributeError) else None


_refusals = partial(refusals, "the DLPC900", reason=_reason)


def encode_picture(picture: np.ndarray) -> bytes:
    """Header and pixels of a picture (rows, columns, 3), bytes in the order in which they go."""
    rows, columns, _ = picture.shape
    pixels = picture.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    above = np.zeros((rows, columns), bool)
    above[1:] = pixels[1:] == pixels[:-1]
    lines = zip(picture, pixels, above, strict=True)
    body = b"".join(_encode_line(*line) for line in lines) + b"\0\1\0"
    # Bytes that the guide calls reserved are as it gives them
    header = struct.pack(
        "<4sHHI8sIBBB21x",
        *(b"Spld", columns, rows, len(body), b"\xff" * 8),
        *(0, 0, 2, 1),  # enhanced run-length encoding
    )
    return header + body


def _encode_line(line: np.ndarray, pixels: np.ndarray, above: np.ndarray) -> bytes:
    """Encode a line (columns, 3) in runs: pixels as above, one that repeats, or any pixels."""
    changes = (above[1:] != above[:-1]) | ~above[1:] & (pixels[1:] != pixels[:-1])
    starts = np.flatnonzero(np.append(True, changes))
    single = (np.diff(np.append(starts, len(pixels))) == 1) & ~above[starts]
    first = np.append(True, ~(single[1:] & single[:-1]))  # single pixels in a row are one run
    starts = starts[first]
    single = single[first]
    ends = np.append(starts[1:], len(pixels))
    out = []
    for start, end, any_pixels in zip(starts.tolist(), ends.tolist(), single.tolist(), strict=True):
        count = _count(end - start)
        if above[start]:
            out.append(b"\0\1" + count)
        elif any_pixels and end - start > 1:
            out.append(b"\0" + count + line[start:end].tobytes())
        else:
            out.append(count + line[start].tobytes())
    return b"".join(out)


def _count(number: int) -> bytes:
    return bytes([number]) if number < 128 else bytes([number & 127 | 128, number >> 7])

"""A fake of the package hidapi with a DLPC900 at its other end, which keeps the guide's rules.

It reads the bytes of reports, command by command, decodes the pictures by the table of enhanced
run-length encoding, and shows the patterns of its table. DLPU018J is the programmer's guide.
"""

import sys
import types

import numpy as np

from deepfsi.camera import DEVICES
from deepfsi.hardware.drivers import dlpc900

BUSY = 3  # how often the fake says that its sequencer runs, for each start
STOPPED, STARTED, ON_THE_FLY = 0, 2, 3
NOT_ALLOWED, BAD_PARAMETER, BAD_EXPOSURE, BAD_NUMBER = 5, 6, 14, 15


class Refused(Exception):
    """A command that the controller answers with its error flag."""


class Controller:
    """DLPC900 with its table, its pictures, and what it showed."""

    def __init__(self):
        self.commands: list[tuple[int, bytes]] = []  # those that were executed, reads among them
        self.shown: list[list[tuple[np.ndarray, int, int]]] = []  # of each pass: frame, µs, dark µs
        self.markers = 0  # of trigger out 2
        self.hardware, self.status, self.mode = 1, 1, 1
        self.size = 64, 24
        self.table, self.entries, self.count = {}, 0, 0
        self.pictures: dict[tuple[int, int], np.ndarray] = {}  # by controller and index
        self.coming: list = [None, None]  # index, bytes to come and those that came
        self.busy, self.stuck, self.error, self.opened = 0, False, 0, False
        self.unplugged = False
        self.begins = False  # whether a start shows the first pattern first
        self.refuse: dict[int, int] = {}  # error codes of commands that are to fail
        self.silent: set[int] = set()  # commands that are not answered
        self.interrupt_at: int | None = None  # report after which Ctrl-C comes
        self.on_start = lambda patterns: None
        self._message, self.replies = b"", []

    @property
    def dual(self):
        return bool(self.status & 16)

    def take(self, report):
        """One report of 64 bytes, with the report's number before it."""
        assert len(report) == 65
        assert report[0] == 0
        self._message += bytes(report[1:])
        length = int.from_bytes(self._message[2:4], "little")
        assert 2 <= length <= 508, "the buffer has 512 bytes"
        if len(self._message) >= 4 + length:
            message, self._message = self._message, b""
            assert not any(message[4 + length :]), "a command is padded with zeros"
            assert len(message) - 4 - length < 64
            self._execute(message[:4], message[4 : 4 + length])
        if self.interrupt_at is not None:
            self.interrupt_at -= 1
            if self.interrupt_at < 0:
                self.interrupt_at = None
                raise KeyboardInterrupt

    def _execute(self, head, content):
        flag, sequence = head[0], head[1]
        assert flag & 0b00111111 == 0
        assert not (flag & 0x80 and not flag & 0x40), "a read wants a reply"
        command, data = int.from_bytes(content[:2], "little"), content[2:]
        self.commands.append((command, data))
        answer = b""
        try:
            if command in self.refuse:
                raise Refused(self.refuse[command])
            answer = self._read(command) if flag & 0x80 else self._write(command, data)
        except Refused as refused:
            self.error = refused.args[0]
            flag |= 0x20
        else:
            self.error = self.error if command == 0x0100 else 0
        if flag & 0x40 and command not in self.silent:
            reply = bytes([flag, sequence]) + len(answer).to_bytes(2, "little") + answer
            self.replies.append(list(reply.ljust(64, b"\0")))

    def _read(self, command):
        if command == 0x1A0C:  # main status
            running = self.busy > 0
            self.busy -= running and not self.stuck
            return bytes([2 * running])
        return {
            0x0100: lambda: bytes([self.error]),
            0x0206: lambda: bytes([self.hardware]) + b"firmware".ljust(31, b"\0"),
            0x1A0A: lambda: bytes([self.status]),
            0x1A1B: lambda: bytes([self.mode]),
        }[command]()

    def _write(self, command, data):
        if command in (0x1A1B, 0x1A34, 0x1A31, 0x1A2A, 0x1A2C) and self.busy:
            raise Refused(NOT_ALLOWED)
        {
            0x1A1B: self._set_mode,
            0x1A34: self._define,
            0x1A31: self._configure,
            0x1A2A: lambda data: self._begin(0, data),
            0x1A2B: lambda data: self._fill(0, data),
            0x1A2C: lambda data: self._begin(1, data),
            0x1A2D: lambda data: self._fill(1, data),
            0x1A24: self._start,
        }[command](data)
        return b""

    def _set_mode(self, data):
        (self.mode,) = data
        self.table.clear()

    def _define(self, data):
        assert len(data) == 12
        if self.mode != ON_THE_FLY:
            raise Refused(NOT_ALLOWED)
        number, exposure = (int.from_bytes(data[a:b], "little") for a, b in ((0, 2), (2, 5)))
        if number >= 400:
            raise Refused(BAD_NUMBER)
        if exposure < 105:
            raise Refused(BAD_EXPOSURE)
        assert data[5] == 0, "one bit, no lamp, not cleared, no trigger in"
        place = int.from_bytes(data[10:12], "little")
        dark = int.from_bytes(data[6:9], "little")
        self.table[number] = exposure, dark, not data[9] & 1, place & 0x7FF, place >> 11

    def _configure(self, data):
        assert len(data) == 6
        self.entries, self.count = (int.from_bytes(each, "little") for each in (data[:2], data[2:]))
        if self.entries > 400 or sorted(self.table) != list(range(self.entries)):
            raise Refused(BAD_NUMBER)
        self.pictures.clear()  # they are to be loaded again

    def _begin(self, side, data):
        assert side == 0 or self.dual
        index, size = (int.from_bytes(each, "little") for each in (data[:2], data[2:6]))
        assert index <= 17
        before = [at for controller, at in self.pictures if controller == side]
        assert not before or index == min(before) - 1, "the last picture comes first"
        self.coming[side] = index, size, b""

    def _fill(self, side, data):
        count, packet = int.from_bytes(data[:2], "little"), data[2:]
        assert 0 < count == len(packet) <= 504
        index, size, came = self.coming[side]
        came += packet
        assert len(came) <= size
        self.coming[side] = index, size, came
        if len(came) == size:
            columns = self.size[0] // 2 if self.dual else self.size[0]
            self.pictures[side, index] = decode(came, columns, self.size[1])

    def _start(self, data):
        if data[0] != STARTED:
            self.busy, self.begins = STOPPED, True
            return
        if self.busy:
            raise Refused(NOT_ALLOWED)
        assert self.mode == ON_THE_FLY
        assert self.begins, "a stop makes the next start begin with the first pattern"
        self.begins = False
        assert self.count, "0 repeats the sequence for ever"
        patterns = [self._pattern(place % self.entries) for place in range(self.count)]
        self.shown.append(patterns)
        self.busy = BUSY
        self.on_start(patterns)

    def _pattern(self, number):
        exposure, dark, marked, index, bit = self.table[number]
        self.markers += marked
        sides = [self.pictures[side, index] for side in range(1 + self.dual)]
        picture = np.concatenate(sides, axis=1)
        lit = picture[..., 2 - bit // 8] >> bit % 8 & 1
        return np.packbits(lit, axis=1), exposure, dark


def decode(content, columns, rows):
    """Picture (rows, columns, 3) of a header of 48 bytes and enhanced run-length encoding."""
    header, at = content[:48], 48
    assert header[:4] == bytes([0x53, 0x70, 0x6C, 0x64])
    assert [int.from_bytes(header[k : k + 2], "little") for k in (4, 6)] == [columns, rows]
    assert int.from_bytes(header[8:12], "little") == len(content) - 48
    assert header[12:20] == b"\xff" * 8
    assert header[20:25] == bytes(5)
    assert header[25] == 2, "enhanced run-length encoding"
    assert header[26] == 1
    assert header[27:] == bytes(21)
    out = np.zeros((rows * columns, 3), np.uint8)
    done = 0

    def number(at):
        if content[at] < 128:
            return content[at], at + 1
        return content[at] & 127 | content[at + 1] << 7, at + 2

    while True:
        count, at = number(at)
        if count:  # repeats of one pixel
            pixels, at = content[at : at + 3] * count, at + 3
        else:
            count, at = number(at)
            assert count, "no ends of lines"
            if count == 1:
                count, at = number(at)
                if not count:
                    break
                assert done >= columns, "there is a line above"
                pixels = out[done - columns : done - columns + count].tobytes()
            else:
                pixels, at = content[at : at + 3 * count], at + 3 * count
        assert done % columns + count <= columns, "a run ends with its line"
        out[done : done + count] = np.frombuffer(pixels, np.uint8).reshape(count, 3)
        done += count
    assert (done, at) == (rows * columns, len(content))
    return out.reshape(rows, columns, 3)


def install(monkeypatch) -> Controller:
    """Put the fake where the driver looks for hidapi, with a DLP6500 of few mirrors."""
    fake = Controller()

    class device:
        def open(self, vendor_id=0, product_id=0, serial_number=None):
            assert (vendor_id, product_id) == (0x0451, 0xC900)
            if fake.opened:
                raise OSError("open failed")
            fake.opened = True

        def write(self, buff):
            if fake.unplugged:
                return -1
            fake.take(buff)
            return len(buff)

        def read(self, max_length, timeout_ms=0):
            assert max_length == 64
            assert timeout_ms > 0, "0 waits for ever"
            return fake.replies.pop(0) if fake.replies else []

        def close(self):
            fake.opened = False

    module = types.ModuleType("hid")
    module.device = device
    monkeypatch.setitem(sys.modules, "hid", module)
    known = DEVICES["dlp6500"].model_copy(update={"columns": 64, "rows": 24})
    monkeypatch.setitem(DEVICES, "dlp6500", known)
    monkeypatch.setattr(dlpc900, "DLPC900_POLL_S", 1e-3)
    return fake

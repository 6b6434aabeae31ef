"""A fake of the package hidapi with a DLPC900 at its other end, which keeps the guide's rules.

It reads the bytes of reports, command by command, decodes the pictures by the table of enhanced
run-length encoding, and shows the patterns of its table. DLPU018J is the programmer's guide.
"""

import sys
import types

import numpy as np

from deepfsi.camera.device import DEVICES
from deepfsi_drivers import dlpc900

BUSY = 3  # how often the fake says that its sequencer runs, for each start
STOPPED, STARTED, ON_THE_FLY = 0, 2, 3
NOT_ALLOWED, BAD_EXPOSURE, BAD_NUMBER = 5, 14, 15


class Refused(Exception):
    """A command that the controller answers with its error flag."""


class Controller:
    def __init__(self):
        self.commands: list[tuple[int, bytes]] = []  # those that were executed, reads among them
        self.shown: list[list[tuple[np.ndarray, int, int]]] = []  # of each pass: frame, µs, dark µs
        self.markers = 0  # of trigger out 2
        self.hardware, self.status, self.mode = 1, 1, 1
        self.size = 64, 24
        self.table, self.entries, self.count = {}, 0, 0
        self.pictures: dict[tuple[int, int], np.ndarray] = {}  # by controller and index
        self.coming: list = [None, None]  # index, bytes to come and those that came
        self.busy = self.error = 0
        self.stuck = self.opened = self.unplugged = False
        self.begins = False  # whether a start shows the first pattern first
        self.refuse: dict[int, int] = {}  # error codes of commands that are to fail
        self.silent: set[int] = set()  # commands that are not answered
        self.interrupt_at: int | None = None  # report after which Ctrl-C comes
        self._message, self.replies = b"", []

    @property
    def dual(self):
        return bool(self.status & 16)

    def open(self, vendor_id=0, product_id=0, serial_number=None):
        assert (vendor_id, product_id) == (0x0451, 0xC900)
        if self.opened:
            raise OSError("open failed")
        self.opened = True

    def close(self):
        self.opened = False

    def read(self, max_length, timeout_ms=0):
        assert max_length == 64
        assert timeout_ms > 0, "0 waits for ever"
        return self.replies.pop(0) if self.replies else []

    def write(self, report):
        """One report of 64 bytes, with the report's number before it."""
        if self.unplugged:
            return -1
        assert len(report) == 65
        assert report[0] == 0
        self._message += bytes(report[1:])
        length = number(self._message, 2, 4)
        assert 2 <= length <= 508, "the buffer has 512 bytes"
        if len(self._message) >= 4 + length:
            message, self._message = self._message, b""
            assert not any(message[4 + length :]), "a command is padded with zeros"
            assert len(message) - 4 - length < 64
            self._execute(message[0], message[1], message[4 : 4 + length])
        if self.interrupt_at is not None:
            self.interrupt_at -= 1
            if self.interrupt_at < 0:
                self.interrupt_at = None
                raise KeyboardInterrupt
        return len(report)

    def _execute(self, flag, sequence, content):
        assert flag & 0b00111111 == 0
        assert not (flag & 0x80 and not flag & 0x40), "a read wants a reply"
        command, data = number(content, 0, 2), content[2:]
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
        running = self.busy > 0
        if command == 0x1A0C:  # main status
            self.busy -= running and not self.stuck
        return {
            0x0100: bytes([self.error]),
            0x0206: bytes([self.hardware]) + b"firmware".ljust(31, b"\0"),
            0x1A0A: bytes([self.status]),
            0x1A0C: bytes([2 * running]),
            0x1A1B: bytes([self.mode]),
        }[command]

    def _write(self, command, data):
        if command in (0x1A1B, 0x1A34, 0x1A31, 0x1A2A, 0x1A2C) and self.busy:
            raise Refused(NOT_ALLOWED)
        side = int(command in (0x1A2C, 0x1A2D))
        match command:
            case 0x1A1B:
                (self.mode,) = data
                self.table.clear()
            case 0x1A34:
                self._define(data)
            case 0x1A31:
                assert len(data) == 6
                self.entries, self.count = number(data, 0, 2), number(data, 2, 6)
                if self.entries > 400 or sorted(self.table) != list(range(self.entries)):
                    raise Refused(BAD_NUMBER)
                self.pictures.clear()  # they are to be loaded again
            case 0x1A2A | 0x1A2C:
                assert side == 0 or self.dual
                index = number(data, 0, 2)
                assert index <= 17
                before = [at for controller, at in self.pictures if controller == side]
                assert not before or index == min(before) - 1, "the last picture comes first"
                self.coming[side] = index, number(data, 2, 6), b""
            case 0x1A2B | 0x1A2D:
                assert 0 < number(data, 0, 2) == len(data) - 2 <= 504
                index, size, came = self.coming[side]
                came += data[2:]
                assert len(came) <= size
                self.coming[side] = index, size, came
                if len(came) == size:
                    columns = self.size[0] // (1 + self.dual)
                    self.pictures[side, index] = decode(came, columns, self.size[1])
            case 0x1A24:
                self._start(data[0])
        return b""

    def _define(self, data):
        assert len(data) == 12
        if self.mode != ON_THE_FLY:
            raise Refused(NOT_ALLOWED)
        entry, exposure, place = number(data, 0, 2), number(data, 2, 5), number(data, 10, 12)
        if entry >= 400:
            raise Refused(BAD_NUMBER)
        if exposure < 105:
            raise Refused(BAD_EXPOSURE)
        assert data[5] == 0, "one bit, no lamp, not cleared, no trigger in"
        dark, marked = number(data, 6, 9), not data[9] & 1
        self.table[entry] = exposure, dark, marked, place & 0x7FF, place >> 11

    def _start(self, what):
        if what != STARTED:
            self.busy, self.begins = STOPPED, True
            return
        if self.busy:
            raise Refused(NOT_ALLOWED)
        assert self.mode == ON_THE_FLY
        assert self.begins, "a stop makes the next start begin with the first pattern"
        self.begins = False
        assert self.count, "0 repeats the sequence for ever"
        self.shown.append([self._pattern(place % self.entries) for place in range(self.count)])
        self.busy = BUSY

    def _pattern(self, entry):
        exposure, dark, marked, index, bit = self.table[entry]
        self.markers += marked
        sides = [self.pictures[side, index] for side in range(1 + self.dual)]
        picture = np.concatenate(sides, axis=1)
        lit = picture[..., 2 - bit // 8] >> bit % 8 & 1
        return np.packbits(lit, axis=1), exposure, dark


def number(content, start, stop):
    return int.from_bytes(content[start:stop], "little")


def decode(content, columns, rows):
    """Picture (rows, columns, 3) of a header of 48 bytes and enhanced run-length encoding."""
    header, at = content[:48], 48
    assert header[:4] == bytes([0x53, 0x70, 0x6C, 0x64])
    assert (number(header, 4, 6), number(header, 6, 8)) == (columns, rows)
    assert number(header, 8, 12) == len(content) - 48
    enhanced = 2
    assert header[12:] == b"\xff" * 8 + bytes(5) + bytes([enhanced, 1]) + bytes(21)
    out = np.zeros((rows * columns, 3), np.uint8)
    done = 0

    def read_count(at):
        if content[at] < 128:
            return content[at], at + 1
        return content[at] & 127 | content[at + 1] << 7, at + 2

    while True:
        count, at = read_count(at)
        if count:  # repeats of one pixel
            pixels, at = content[at : at + 3] * count, at + 3
        else:
            count, at = read_count(at)
            assert count, "no ends of lines"
            if count == 1:
                count, at = read_count(at)
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

    module = types.ModuleType("hid")
    module.device = lambda: fake
    monkeypatch.setitem(sys.modules, "hid", module)
    known = DEVICES["dlp6500"].model_copy(update={"columns": 64, "rows": 24})
    monkeypatch.setitem(DEVICES, "dlp6500", known)
    monkeypatch.setattr(dlpc900, "DLPC900_POLL_S", 1e-3)
    return fake

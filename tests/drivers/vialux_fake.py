"""A fake of ALP4lib that keeps its rules, in place of the real one."""

import ctypes
import sys
import types

import numpy as np

from deepfsi.camera.device import Device
from deepfsi_drivers import vialux

DEVICE = Device(name="small", columns=64, rows=24)
PACKED_ROW = {1024: 128, 1920: 256, 1400: 176}  # alp.h, at ALP_DATA_BINARY_TOPDOWN
BUSY = 3  # how often the fake says that it still shows something, for each sequence


class ALPError(Exception):
    pass


class Library:
    """The C library: sequences in memory, a queue, and what was shown, in order."""

    def __init__(self):
        self.calls, self.shown, self.sequences, self.lists = [], [], {}, []
        self.queue, self.busy, self.queue_mode = [], 0, None
        self.memory, self.places, self.stuck = 1000, 2, False
        self.entries, self.table = 4096, {}
        self.allocated = False
        self.fail_at: dict[str, BaseException | int] = {}
        self.size = DEVICE.columns, DEVICE.rows
        self.on_list = lambda frames, us: None  # what happens when a list of frames is shown

    def step(self, name):
        self.calls.append(name)
        failure = self.fail_at.pop(name, None)
        if isinstance(failure, BaseException):
            raise failure
        if failure is not None:
            raise KeyError(failure) if failure > 1020 else ALPError(f"Failure {failure}.")

    def note(self, number):
        controls = self.sequences[number]["controls"]
        wide = controls.get(vialux.Alp.FLUT_MODE) == vialux.Alp.FLUT_18BIT
        if vialux.Alp.FLUT_MODE in controls:
            frames = self.table[vialux.Alp.FLUT_WRITE_18BIT if wide else vialux.Alp.FLUT_WRITE_9BIT]
            shown = frames[: controls[vialux.Alp.FLUT_ENTRIES9] // (1 + wide)]
            self.lists.append((shown, self.sequences[number]["us"]))
            self.on_list(*self.lists[-1])

    def AlpProjInquire(self, alp_id, which, value):
        self.step("AlpProjInquire")
        assert alp_id.value == 7, "the device's own id"
        if self.busy:
            self.busy -= not self.stuck
        if not self.busy and self.queue:
            self.shown.append(self.queue.pop(0))
            self.busy = BUSY
        answers = {
            vialux.Alp.PROJ_STATE: vialux.Alp.PROJ_ACTIVE if self.busy else 1201,
            vialux.Alp.QUEUE_AVAIL: self.places - len(self.queue),
            vialux.Alp.FLUT_MAX_ENTRIES9: self.entries,
        }
        value._obj.value = answers[which.value]
        return 0


class ALP4:
    """ALP4lib's class, as far as the driver may use it."""

    library: Library

    def __init__(self, version="4.3", libDir=None):
        print("Loading library")
        self._ALPLib, self.ALP_ID = self.library, ctypes.c_ulong(0)
        self._ALPLib.step("__init__")

    def _checkError(self, code, words):
        if code:
            raise ALPError(words)

    def Initialize(self, DeviceNum=None):
        self._ALPLib.step("AlpDevAlloc")
        self._ALPLib.allocated = True
        self.ALP_ID = ctypes.c_ulong(7)
        self.nSizeX, self.nSizeY = self._ALPLib.size
        self._ALPLib.step("AlpDevInquire")

    def ProjControl(self, kind, value):
        self._ALPLib.step("ProjControl")
        if kind == vialux.Alp.QUEUE_MODE:
            self._ALPLib.queue_mode = value
        else:
            assert (kind, value) == (vialux.Alp.RESET_QUEUE, vialux.Alp.DEFAULT)
            self._ALPLib.queue.clear()

    def ProjControlEx(self, kind, pointer):
        self._ALPLib.step("ProjControlEx")
        assert not self._ALPLib.busy, "the table is written while nothing is shown"
        table = pointer._obj
        assert table.nOffset == 0
        wide = kind == vialux.Alp.FLUT_WRITE_18BIT
        assert wide or kind == vialux.Alp.FLUT_WRITE_9BIT
        assert 0 < table.nSize <= self._ALPLib.entries // (1 + wide)
        self._ALPLib.table = {kind: list(table.FrameNumbers[: table.nSize])}

    def DevInquire(self, which):
        assert which == vialux.Alp.AVAIL_MEMORY
        return self._ALPLib.memory - sum(s["count"] for s in self._ALPLib.sequences.values())

    def SeqAlloc(self, nbImg=1, bitDepth=1):
        self._ALPLib.step("SeqAlloc")
        assert bitDepth == 1
        sequence = ctypes.c_long(len(self._ALPLib.calls))
        self._ALPLib.sequences[sequence.value] = {"count": nbImg, "frames": {}, "controls": {}}
        return sequence

    def SeqControl(self, kind, value, SequenceId):
        self._ALPLib.sequences[SequenceId.value]["controls"][kind] = value

    def SeqInquire(self, which, SequenceId):
        return {vialux.Alp.MIN_PICTURE_TIME: 44, vialux.Alp.MAX_PICTURE_TIME: 10**7}[which]

    def SetTiming(self, SequenceId, pictureTime):
        self._ALPLib.sequences[SequenceId.value]["us"] = pictureTime

    def SeqPut(self, imgData, SequenceId, PicOffset, PicLoad):
        self._ALPLib.step("SeqPut")
        assert not self._ALPLib.busy, "frames are loaded while nothing is shown"
        sequence = self._ALPLib.sequences[SequenceId.value]
        assert (imgData.dtype, imgData.ndim) == (np.uint8, 1)
        packed = sequence["controls"][vialux.Alp.DATA_FORMAT] == vialux.Alp.DATA_BINARY_TOPDOWN
        rows = imgData.reshape(PicLoad, self.nSizeY, PACKED_ROW[self.nSizeX] if packed else -1)
        assert packed or rows.shape[-1] == self.nSizeX, "a byte for each mirror"
        bits = np.unpackbits(rows, axis=-1)[..., : self.nSizeX] if packed else rows >> 7
        for place, frame in enumerate(np.packbits(bits, axis=-1)):
            assert PicOffset + place < sequence["count"]
            sequence["frames"][PicOffset + place] = frame.ravel()

    def Run(self, SequenceId, loop):
        self._ALPLib.step("Run")
        assert not loop
        assert self._ALPLib.queue_mode == vialux.Alp.SEQUENCE_QUEUE
        assert len(self._ALPLib.queue) < self._ALPLib.places, "the queue is full"
        self._ALPLib.queue.append(SequenceId.value)
        self._ALPLib.note(SequenceId.value)

    def FreeSeq(self, SequenceId):
        self._ALPLib.step("FreeSeq")
        del self._ALPLib.sequences[SequenceId.value]

    def Halt(self):
        self._ALPLib.step("Halt")
        self._ALPLib.busy = 0

    def Free(self):
        self._ALPLib.step("Free")
        assert not self._ALPLib.busy, "the device is freed when it is idle"
        self._ALPLib.allocated = False
        self._ALPLib.sequences.clear()
        del self._ALPLib


class tFlutWrite(ctypes.Structure):
    _fields_ = (
        ("nOffset", ctypes.c_long),
        ("nSize", ctypes.c_long),
        ("FrameNumbers", ctypes.c_ulong * 4096),
    )


def install(monkeypatch) -> Library:
    """Put the fake where the driver looks for ALP4lib, and let the driver wait for nothing."""
    fake = Library()
    module = types.ModuleType("ALP4")
    module.ALP4 = type("ALP4", (ALP4,), {"library": fake})
    module.tFlutWrite = tFlutWrite
    monkeypatch.setitem(sys.modules, "ALP4", module)
    monkeypatch.setattr(vialux, "VIALUX_POLL_S", 0)
    monkeypatch.setattr(vialux, "LIST_POLL_S", 0)
    return fake

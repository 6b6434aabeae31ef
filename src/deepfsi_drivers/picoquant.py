"""PicoQuant counters through the vendor's snAPI: records are counted as the device hands them over.

**Untested on hardware.** It was written from the source and the documentation of snAPI 1.2.5, and
is tested against a fake of it. Compare its first runs with the PTU file that they leave: counted
from there, the counts must be the same.

snAPI serves the MultiHarp 150 and 160, HydraHarp 400 and 500, TimeHarp 260 and PicoHarp 330, not
the PicoHarp 300. All give T2 records of one kind. They are handed over in blocks, of whatever came
since the last; the device keeps up to 16 records to itself, and by default overflows for 2 ms,
which is switched off here where the device can. A thread takes and counts them all the while, also
while nobody asks for counts: snAPI keeps no more than there is room for.
"""

import importlib
import queue
import threading
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import FilePath, validate_call

from deepfsi.base.errors import InputError
from deepfsi.counting.reader import PtuStream
from deepfsi.counting.streaming import FrameCounter, FrameGates

SNAPI_POLL_S = 0.0002
"""Time between two questions for records, seconds."""


class SnapiCounter:
    """Streaming counter of a PicoQuant device. Untested on hardware: see the module."""

    @validate_call
    def __init__(
        self,
        inputs: tuple[int, ...] = (0,),
        marker_bit: int = 1,
        serial: str | None = None,
        config: FilePath | None = None,
        buffer: int = 2**24,
    ) -> None:
        self.inputs = inputs
        self.marker_bit = marker_bit
        self.serial = serial
        self.config = config
        self.buffer = buffer
        self._api: Any = None
        self._frames: FrameCounter | None = None
        self._lock = threading.Lock()  # of the frames
        self._counted: queue.Queue[np.ndarray | Exception] = queue.Queue()
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        """Take hold of the device, in T2 mode, with one marker input."""
        try:
            module = importlib.import_module("snAPI.Main")
        except ImportError:
            raise InputError(
                "PicoQuant counters need snAPI, which is not installed: pip install snapi"
            ) from None
        except OSError as error:
            raise InputError(
                f"snAPI's library cannot be loaded: {error}; install the device's software"
            ) from None
        self._api = api = module.snAPI()
        try:
            found = api.getDevice() if self.serial is None else api.getDevice(self.serial)
            self._accept(found, "be found")
            self._accept(api.initDevice(module.MeasMode.T2), "be set to T2 mode")
            if self.config is not None:
                self._accept(api.loadIniConfig(str(self.config)), f"take {self.config}")
            used = [int(self.marker_bit == 1 << number) for number in range(4)]
            self._accept(api.device.setMarkerEdges(*used), "set its marker edges")
            self._accept(api.device.setMarkerEnable(*used), "switch on its marker input")
            api.device.setOflCompression(0)  # not all devices compress overflows
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        """End the recording and let go of the device."""
        try:
            self.stop()
        finally:
            self._close()

    def start(self, path: Path) -> None:
        """Begin to record into a new file, which snAPI writes."""
        if self._api is None:
            raise InputError("the PicoQuant device is not open: use `with` to open it")
        self.stop()
        if path.exists():
            raise InputError(f"{path} is there already: give a new file")
        self._accept(self._api.setPTUFilePath(str(path.absolute())), f"record into {path}")
        # Longest recording that the devices take, 100 hours, milliseconds
        self._accept(self._api.raw.startBlock(360_000_000, self.buffer, True), "start to record")
        tick_s = self._api.deviceConfig["BaseResolution"] * 1e-12
        stream = PtuStream.without_header(path, tick_s)
        self._frames = FrameCounter(self.inputs, self.marker_bit, stream)
        self._counted = queue.Queue()
        self._ending = threading.Event()
        arguments = (self._frames, path)
        self._thread = threading.Thread(target=self._read, args=arguments, daemon=True)
        self._thread.start()

    def expect(self, gates: FrameGates) -> None:
        """Tell the gates of the frames that are shown next, before they are shown."""
        if self._frames is None:
            raise InputError("nothing is recorded: start the counter first")
        with self._lock:
            self._frames.expect(gates)

    def counts_since_marker(self, timeout_s: float) -> np.ndarray:
        """Counts since the last call, as `StreamingCounter` says."""
        if self._frames is None:
            raise InputError("nothing is recorded: start the counter first")
        try:
            found = self._counted.get(timeout=timeout_s)
        except queue.Empty:
            return np.zeros((0, len(self.inputs)), np.int64)
        if isinstance(found, Exception):
            self._counted.put(found)
            raise found
        return found

    def stop(self) -> None:
        """End the recording; its file is then whole. Without one, do nothing."""
        if self._thread is not None:
            self._ending.set()
            self._thread.join()
            self._thread = self._frames = None
            self._api.raw.stopMeasure()

    def _read(self, frames: FrameCounter, path: Path) -> None:
        """Count all records until the end; the other side gets counts and errors."""
        try:
            while not self._ending.is_set():
                finished = self._api.raw.isFinished()
                words = self._api.raw.getBlock()  # a view, until the next call
                if len(words) >= self.buffer:
                    raise InputError(
                        f"{path}: more records came than the {self.buffer} that may wait, "
                        "and some were lost: give a larger `buffer`, or less light"
                    )
                with self._lock:
                    counts = frames.feed(words.data)
                if len(counts):
                    self._counted.put(counts)
                if finished:
                    raise InputError(
                        f"{path}: the PicoQuant device stopped by itself; look into "
                        "snAPI's log, and for less light if its buffer ran over"
                    )
                if not len(words):
                    self._ending.wait(SNAPI_POLL_S)
        except Exception as error:
            self._counted.put(error)

    def _close(self) -> None:
        api = self._api
        self._api = None
        if api is not None:
            api.closeDevice()

    @staticmethod
    def _accept(done: object, doing: str) -> None:
        """Raise `InputError` where snAPI says that something was not done."""
        if not done:
            raise InputError(
                f"the PicoQuant device cannot {doing}: see snAPI's log, and check that it is on, "
                "connected and not used by another program"
            )

"""PicoQuant counters through the vendor's snAPI: records are counted as the device hands them over.

**Untested on hardware.** It was written from the source and the documentation of snAPI 1.2.5, and
is tested against a fake of it.

snAPI serves the MultiHarp 150 and 160, HydraHarp 400 and 500, TimeHarp 260 and PicoHarp 330, not
the PicoHarp 300. All give T2 records of one kind. They are handed over in blocks, of whatever came
since the last; the device keeps up to 16 records to itself, and by default overflows for 2 ms,
which is switched off here where the device can. A thread takes them all the while, also while
nobody asks for counts: snAPI keeps no more than there is room for.
"""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from pydantic import FilePath, validate_call

from deepfsi.base.errors import InputError
from deepfsi.counting.events import PtuWriter
from deepfsi_drivers.device_errors import import_library
from deepfsi_drivers.file_tail import TappedCounter


class SnapiCounter(TappedCounter):
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
        super().__init__(inputs, marker_bit)
        self.marker_bit = marker_bit
        self.serial = serial
        self.config = config
        self.buffer = buffer
        self._api: Any = None

    def __enter__(self) -> Self:
        """Take hold of the device, in T2 mode, with one marker input."""
        module = import_library("the PicoQuant device", "snapi", "snAPI.Main")
        self._api = api = module.snAPI()
        try:
            opened = api.getDevice() if self.serial is None else api.getDevice(self.serial)
            self._accept(opened, "be found")
            self._accept(api.initDevice(module.MeasMode.T2), "be set to T2 mode")
            if self.config is not None:
                self._accept(api.loadIniConfig(str(self.config)), f"take {self.config}")
            used = [int(self.marker_bit == 1 << number) for number in range(4)]
            self._accept(api.device.setMarkerEdges(*used), "set its marker edges")
            self._accept(api.device.setMarkerEnable(*used), "switch on its marker input")
            api.device.setOflCompression(0)  # not all devices compress overflows
        except BaseException:
            self._free()
            raise
        return self

    def _begin(self, path: Path, stack: ExitStack) -> tuple[float, Callable[[PtuWriter], None]]:
        raw = self._api.raw
        # Longest recording that the devices take, 100 hours, milliseconds; no file of snAPI's own
        self._accept(raw.startBlock(360_000_000, self.buffer, False), "start to record")
        stack.callback(raw.stopMeasure)

        def take(writer: PtuWriter) -> None:
            finished = raw.isFinished()
            words = raw.getBlock()  # a view, until the next call
            if len(words) >= self.buffer:
                raise InputError(
                    f"{path}: more records came than the {self.buffer} that may wait, "
                    "and some were lost: give a larger `buffer`, or less light"
                )
            writer.write_records(words)
            if finished:
                raise InputError(
                    f"{path}: the PicoQuant device stopped by itself; look into "
                    "snAPI's log, and for less light if its buffer ran over"
                )

        return self._api.deviceConfig["BaseResolution"] * 1e-12, take

    def _finish(self) -> None:
        """Nothing to wait for."""

    def _free(self) -> None:
        api = self._api
        self._api = None
        if api is not None:
            api.closeDevice()

    @staticmethod
    def _accept(done: object, doing: str) -> None:
        """Raise `InputError` if snAPI reports a failure."""
        if not done:
            raise InputError(
                f"the PicoQuant device cannot {doing}: see snAPI's log, and check that it is on, "
                "connected and not used by another program"
            )

"""Swabian Instruments Time Taggers through the vendor's library: a channel is the trigger's.

**Untested on hardware.** It was written from the vendor's package, version 2.22.6, and manual, and
is tested against a fake of them. In the manual
(https://www.swabianinstruments.com/static/documentation/TimeTagger/), `api/TimeTaggerLibrary.html`
tells of channel numbers and units, `api/TimeTagger.html` of trigger levels and blocks,
`api/measurements/time_tag_streaming.html` of `TimeTagStream` and the format of tags, and
`InDepthGuides/PipelineSynchronization.html` of `sync`.

A thread takes tags all the while, and writes them to a PTU file, from which they are counted while
it grows: what is counted is what the file holds. Tags of the trigger become markers there, and
channel 1 becomes input 1. The first tag is at 0. A recording lasts 10 hours at most.
"""

import importlib
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import FilePath, FiniteFloat, validate_call

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.files import read_toml
from deepfsi.base.models import UserModel
from deepfsi.counting.events import PtuWriter
from deepfsi_drivers.device_errors import refusals
from deepfsi_drivers.file_tail import TappedCounter

MODULES = "Swabian.TimeTagger", "TimeTagger"
"""The library as installed by pip, and by the vendor's installer."""

TICK_S = 1e-12
"""Unit of the tags' times, seconds."""

MOST_TAGS = 2**22
"""Tags that may wait for the thread."""

ERROR = 1
"""Type of a tag of an error; those above tell of tags that were lost, and 0 is a signal's."""


class TaggerSettings(UserModel):
    """Settings of a Time Tagger, as a TOML file has them."""

    trigger_levels: dict[int, FiniteFloat]  # of channels, V; the others have the device's own


class TaggerCounter(TappedCounter):
    """Streaming counter of a Time Tagger. Untested on hardware: see the module."""

    def __init__(
        self,
        inputs: tuple[int, ...] = (0,),
        marker_bit: int = 1,
        *,
        trigger: int,
        settings: TaggerSettings | None = None,
    ) -> None:
        # The channel of the trigger, negative for falling edges
        channels = [each + 1 for each in inputs]
        if trigger == 0 or abs(trigger) in channels:
            raise InputError(
                f"channel {trigger} for the trigger is not allowed: give one that is no detector's "
                f"({', '.join(map(str, channels))}), negative for falling edges"
            )
        super().__init__(inputs, marker_bit)
        self._codes = {trigger: -marker_bit, **dict(zip(channels, inputs, strict=True))}
        self._levels = {} if settings is None else settings.trigger_levels
        self._module: Any = None
        self._tagger: Any = None

    def __enter__(self) -> Self:
        """Take hold of the first device that is found."""
        self._module = _find_module()
        with _refusals("be used"):
            self._tagger = self._module.createTimeTagger()
        try:
            with _refusals("take its settings"):
                for channel, level in self._levels.items():
                    self._tagger.setTriggerLevel(channel, level)
                # At most so many tags in a block, and 1 ms of latency
                self._tagger.setStreamBlockSize(2**17, 1)
        except BaseException:
            self._free()
            raise
        return self

    def _begin(self, path: Path, stack: ExitStack) -> tuple[float, Callable[[PtuWriter], None]]:
        if self._tagger is None:
            raise InputError("the Time Tagger is not open: use `with` to open it")
        with _refusals("record these channels"):
            self._finish()  # levels are settled, and what came before is gone
            stream = self._module.TimeTagStream(self._tagger, MOST_TAGS, list(self._codes))
        stack.callback(stream.stop)
        return TICK_S, _Tags(stream, self._codes, path).take

    def _finish(self) -> None:
        if not self._tagger.sync(5000):  # milliseconds
            raise InputError("the Time Tagger does not answer within 5 s: check its cable")

    def _free(self) -> None:
        tagger = self._tagger
        self._tagger = None
        if tagger is not None:
            self._module.freeTimeTagger(tagger)


@validate_call
def open_tagger(
    inputs: tuple[int, ...],
    marker_bit: int,
    trigger: int | None = None,
    config: FilePath | None = None,
) -> TaggerCounter:
    """Time Tagger with the channel of the trigger, and the settings of a TOML file."""
    if trigger is None:
        raise InputError("counter swabian needs the channel of the trigger: such as trigger=8")
    settings = None
    if config is not None:
        with as_input_error(str(config)):
            settings = TaggerSettings.model_validate(read_toml(config))
    return TaggerCounter(inputs, marker_bit, trigger=trigger, settings=settings)


class _Tags:
    """Tags of a recording, from the device's stream to the file."""

    def __init__(self, stream: Any, codes: dict[int, int], path: Path) -> None:
        self._stream = stream
        self._codes = codes
        self._path = path
        self._first: int | None = None  # time of the first tag, ps

    def take(self, writer: PtuWriter) -> None:
        """Write what has come; raise `InputError` if something was lost."""
        with _refusals("hand over its tags"):
            block = self._stream.getData()
        if not block.size:
            return
        types = block.getEventTypes()
        lost = np.flatnonzero(types)
        whole = int(lost[0]) if len(lost) else block.size
        times = block.getTimestamps()
        channels = block.getChannels()
        if self._first is None:
            self._first = int(times[0])
        times = times - self._first
        codes = np.zeros(whole, np.int64)
        for channel, code in self._codes.items():
            codes[channels[:whole] == channel] = code
        writer.write(times[:whole], codes)
        if len(lost):
            at_s = times[whole] * TICK_S
            missed = int(block.getMissedEvents().sum())
            raise InputError(f"{self._path}: {_describe(int(types[whole]), at_s, missed)}")
        if block.size >= MOST_TAGS:
            raise InputError(
                f"{self._path}: more tags came than the {MOST_TAGS} that may wait, and some were "
                "lost: give less light, or free the computer of other work"
            )


def _describe(kind: int, at_s: float, missed: int) -> str:
    """Words for a tag of an error or of tags that were lost."""
    if kind == ERROR:
        return (
            f"the Time Tagger tells of an error {at_s:.6g} s after its first tag: check its clock "
            "and its cable, and record again"
        )
    return (
        f"the Time Tagger overflowed {at_s:.6g} s after its first tag, and lost {missed} tags or "
        "more: give less light, and record again"
    )


def _find_module() -> Any:
    for name in MODULES:
        try:
            return importlib.import_module(name)
        except ModuleNotFoundError:
            continue
        except (ImportError, OSError) as error:
            raise InputError(
                f"the Time Tagger's library cannot be loaded: {error}; install it again"
            ) from None
    raise InputError(
        "Time Taggers need their library, which is not installed: pip install Swabian-TimeTagger"
    )


def _reason(error: Exception) -> str | None:
    known = RuntimeError, ValueError, TypeError, IndexError, OverflowError
    return str(error) if isinstance(error, known) else None


_refusals = partial(refusals, "the Time Tagger", reason=_reason)

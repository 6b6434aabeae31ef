"""Swabian Instruments Time Taggers through the vendor's library; one channel is the trigger.

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
from deepfsi_drivers.device_errors import import_library, refusals
from deepfsi_drivers.file_tail import TappedCounter

TICK_S = 1e-12
"""Unit of the tags' times, seconds."""

MOST_TAGS = 2**22
"""Tags that may wait for the thread."""

ERROR = 1
"""Type of a tag of an error; larger types tell of lost tags, and 0 is a signal."""


class TaggerSettings(UserModel):
    """Settings of a Time Tagger, as a TOML file has them."""

    trigger_levels: dict[int, FiniteFloat]  # of channels, V; the others have the device's own


class TaggerCounter(TappedCounter):
    """Streaming counter of a Time Tagger. Untested on hardware: see the module."""

    @validate_call
    def __init__(
        self,
        inputs: tuple[int, ...] = (0,),
        marker_bit: int = 1,
        *,
        trigger: int = 0,
        config: FilePath | None = None,
    ) -> None:
        # The channel of the trigger is negative for falling edges; `config` is a TOML file
        channels = [number + 1 for number in inputs]
        if trigger == 0 or abs(trigger) in channels:
            raise InputError(
                f"channel {trigger} for the trigger is not allowed: give one that is no detector's "
                f"({', '.join(map(str, channels))}), negative for falling edges"
            )
        super().__init__(inputs, marker_bit)
        self._codes = {trigger: -marker_bit, **dict(zip(channels, inputs, strict=True))}
        self._levels: dict[int, float] = {}
        if config is not None:
            with as_input_error(str(config)):
                self._levels = TaggerSettings.model_validate(read_toml(config)).trigger_levels
        self._module: Any = None
        self._tagger: Any = None

    def __enter__(self) -> Self:
        """Take hold of the first device that is found."""
        # As installed by pip, and by the vendor's installer
        names = "Swabian.TimeTagger", "TimeTagger"
        self._module = import_library("the Time Tagger", "Swabian-TimeTagger", *names)
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
        with _refusals("record these channels"):
            self._finish()  # levels are settled, and what came before is gone
            stream = self._module.TimeTagStream(self._tagger, MOST_TAGS, list(self._codes))
        stack.callback(stream.stop)
        first: int | None = None  # time of the first tag, ps

        def take(writer: PtuWriter) -> None:
            nonlocal first
            with _refusals("hand over its tags"):
                block = stream.getData()
            if not block.size:
                return
            types = block.getEventTypes()
            lost = np.flatnonzero(types)
            # events before the loss are kept
            sound = int(lost[0]) if len(lost) else block.size
            times = block.getTimestamps()
            if first is None:
                first = int(times[0])
            times = times - first
            channels = block.getChannels()[:sound]
            codes = np.zeros(sound, np.int64)
            for channel, code in self._codes.items():
                codes[channels == channel] = code
            writer.write(times[:sound], codes)
            if len(lost):
                missed = int(block.getMissedEvents().sum())
                text = _describe(int(types[sound]), times[sound] * TICK_S, missed)
                raise InputError(f"{path}: {text}")
            if block.size >= MOST_TAGS:
                raise InputError(
                    f"{path}: more tags came than the {MOST_TAGS} that may wait, and some were "
                    "lost: give less light, or free the computer of other work"
                )

        return TICK_S, take

    def _finish(self) -> None:
        if not self._tagger.sync(5000):  # milliseconds
            raise InputError("the Time Tagger does not answer within 5 s: check its cable")

    def _free(self) -> None:
        tagger = self._tagger
        self._tagger = None
        if tagger is not None:
            self._module.freeTimeTagger(tagger)


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


def _reason(error: Exception) -> str | None:
    known = RuntimeError, ValueError, TypeError, IndexError, OverflowError
    return str(error) if isinstance(error, known) else None


_refusals = partial(refusals, "the Time Tagger", reason=_reason)

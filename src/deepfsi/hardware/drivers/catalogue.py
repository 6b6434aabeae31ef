"""Projectors and counters that a run knows by name: a new device is its driver and a line here."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from deepfsi.base.errors import InputError, check_choice
from deepfsi.hardware.drivers.dlpc900 import Dlpc900Projector
from deepfsi.hardware.drivers.file_tail import FollowedCounter
from deepfsi.hardware.drivers.picoquant import SnapiCounter
from deepfsi.hardware.drivers.protocols import PassProjector, StreamingCounter, StreamingProjector
from deepfsi.hardware.drivers.swabian import open_tagger
from deepfsi.hardware.drivers.vialux import VialuxLooks, VialuxProjector


@dataclass(frozen=True)
class DeviceSettings:
    """Settings of devices; each device takes some of them."""

    inputs: tuple[int, ...] = (0,)  # inputs of the counter that detectors are wired to, from 0
    marker_bit: int = 1  # bit of the markers at the start of each frame
    counter_config: Path | None = None  # the counter's own file of settings
    marker_channel: int | None = None  # channel of the trigger, of a counter without marker inputs
    alp_version: str | None = None  # version of the ALP interface
    ask_to_record: Callable[[Path, float], None] | None = None


@dataclass(frozen=True)
class _ProjectorDriver:
    """A kind of projector: how it is opened, for passes and for lists of frames.

    `settings` are the fields of `DeviceSettings` that it alone takes; `no_lists` says why it shows
    no lists of frames that are chosen during a run.
    """

    passes: Callable[[DeviceSettings], PassProjector]
    lists: Callable[[DeviceSettings], StreamingProjector] | None = None
    no_lists: str = ""
    settings: tuple[str, ...] = ()


@dataclass(frozen=True)
class _CounterDriver:
    """A kind of counter: how it is opened, and the fields of `DeviceSettings` that it takes."""

    open: Callable[[DeviceSettings], StreamingCounter]
    settings: tuple[str, ...] = ()


PROJECTORS = {
    "vialux": _ProjectorDriver(
        passes=lambda settings: VialuxProjector(settings.alp_version),
        lists=lambda settings: VialuxLooks(settings.alp_version),
        settings=("alp_version",),
    ),
    "dlpc900": _ProjectorDriver(
        passes=lambda settings: Dlpc900Projector(),
        no_lists="a DLPC900 shows a table that is loaded before: use projector vialux, or `deepfsi "
        "camera record` of a fixed design",
    ),
}
"""Projectors by name."""

COUNTERS = {
    "picoquant": _CounterDriver(
        lambda settings: SnapiCounter(
            settings.inputs, settings.marker_bit, config=settings.counter_config
        ),
        settings=("counter_config",),
    ),
    "swabian": _CounterDriver(
        lambda settings: open_tagger(
            settings.inputs,
            settings.marker_bit,
            trigger=settings.marker_channel,
            config=settings.counter_config,
        ),
        settings=("counter_config", "marker_channel"),
    ),
    "followed": _CounterDriver(
        lambda settings: FollowedCounter(
            settings.inputs, settings.marker_bit, waits=settings.ask_to_record
        )
    ),
}
"""Counters by name; `followed` is a PicoQuant counter whose software writes the photon file."""


def open_projector(name: str, settings: DeviceSettings) -> PassProjector:
    """Projector for passes of all frames, not yet taken hold of."""
    check_choice("projector", name, PROJECTORS)
    return PROJECTORS[name].passes(settings)


def open_list_projector(name: str, settings: DeviceSettings) -> StreamingProjector:
    """Projector for lists of frames that a live run chooses."""
    check_choice("projector", name, PROJECTORS)
    driver = PROJECTORS[name]
    if driver.lists is None:
        raise InputError(f"live runs choose frames while they run, and {driver.no_lists}")
    return driver.lists(settings)


def open_counter(name: str, settings: DeviceSettings) -> StreamingCounter:
    """Counter that counts frame by frame while it records, not yet taken hold of."""
    check_choice("counter", name, COUNTERS)
    return COUNTERS[name].open(settings)

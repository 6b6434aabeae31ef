"""Drivers of pattern projectors and photon counters, and what a run asks of them."""

from deepfsi.hardware.drivers.catalogue import (
    COUNTERS,
    PROJECTORS,
    DeviceSettings,
    open_counter,
    open_list_projector,
    open_projector,
)
from deepfsi.hardware.drivers.dlpc900 import Dlpc900Projector
from deepfsi.hardware.drivers.protocols import (
    PATIENCE_S,
    PassProjector,
    Setup,
    StreamingCounter,
    StreamingProjector,
)
from deepfsi.hardware.drivers.vialux import VialuxProjector

__all__ = [
    "COUNTERS",
    "PATIENCE_S",
    "PROJECTORS",
    "DeviceSettings",
    "Dlpc900Projector",
    "PassProjector",
    "Setup",
    "StreamingCounter",
    "StreamingProjector",
    "VialuxProjector",
    "open_counter",
    "open_list_projector",
    "open_projector",
]

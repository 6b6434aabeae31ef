"""A virtual camera and virtual devices: optics, detectors and electronics simulated."""

from deepfsi.hardware.virtual.camera import (
    CAMERAS,
    MirrorLight,
    RecordingSettings,
    VirtualCamera,
    arrival_rates,
    expected_events,
    record_scenes,
)
from deepfsi.hardware.virtual.detector import DETECTOR_TICK_S, Detector, Stream, divide
from deepfsi.hardware.virtual.setup import (
    Latencies,
    VirtualCounter,
    VirtualOptics,
    VirtualProjector,
    virtual_setup,
)

__all__ = [
    "CAMERAS",
    "DETECTOR_TICK_S",
    "Detector",
    "Latencies",
    "MirrorLight",
    "RecordingSettings",
    "Stream",
    "VirtualCamera",
    "VirtualCounter",
    "VirtualOptics",
    "VirtualProjector",
    "arrival_rates",
    "divide",
    "expected_events",
    "record_scenes",
    "virtual_setup",
]

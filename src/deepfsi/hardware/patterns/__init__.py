"""Patterns for a micromirror device: frames, their times and gates, and their files."""

from deepfsi.hardware.patterns.controllers import Dlpc900
from deepfsi.hardware.patterns.folder import (
    FrameSettings,
    Patterns,
    check_patterns,
    export_patterns,
    read_frames,
    read_patterns,
)
from deepfsi.hardware.patterns.frames import make_frames, unpack
from deepfsi.hardware.patterns.manifest import (
    Brightness,
    DesignRails,
    Frame,
    LookPlan,
    Manifest,
)
from deepfsi.hardware.patterns.photomask import write_photomask
from deepfsi.hardware.patterns.timing import GatePlan

__all__ = [
    "Brightness",
    "DesignRails",
    "Dlpc900",
    "Frame",
    "FrameSettings",
    "GatePlan",
    "LookPlan",
    "Manifest",
    "Patterns",
    "check_patterns",
    "export_patterns",
    "make_frames",
    "read_frames",
    "read_patterns",
    "unpack",
    "write_photomask",
]

"""Photon files: timestamps read, also while they arrive, counted in windows, and written."""

from deepfsi.hardware.photons.ptu import PtuWriter
from deepfsi.hardware.photons.reader import (
    PhotonSource,
    PtuFile,
    PtuStream,
    WindowCounter,
    count_windows,
    cut_windows,
    read_markers,
    read_photons,
    summarise,
)
from deepfsi.hardware.photons.records import Part, marker_slack_s
from deepfsi.hardware.photons.scan import ScanMarkers, count_scan
from deepfsi.hardware.photons.timestamps import read_timestamps

__all__ = [
    "Part",
    "PhotonSource",
    "PtuFile",
    "PtuStream",
    "PtuWriter",
    "ScanMarkers",
    "WindowCounter",
    "count_scan",
    "count_windows",
    "cut_windows",
    "marker_slack_s",
    "read_markers",
    "read_photons",
    "read_timestamps",
    "summarise",
]

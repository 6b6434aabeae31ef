"""Calibration of a camera: where each cell of the device looks, and how brightly."""

from deepfsi.hardware.calibration.fit import (
    calibrate_run,
    expected_background,
    fit_calibration,
    spot_scenes,
    write_spots,
)
from deepfsi.hardware.calibration.reference import (
    ReferenceFit,
    find_reference,
    find_reference_of_masks,
    write_reference,
)
from deepfsi.hardware.calibration.scans import (
    SCAN_NAMES,
    find_detectors,
    find_gains,
    save_detectors,
    scan_rails,
)
from deepfsi.hardware.calibration.view import camera_view, view_dataset

__all__ = [
    "SCAN_NAMES",
    "ReferenceFit",
    "calibrate_run",
    "camera_view",
    "expected_background",
    "find_detectors",
    "find_gains",
    "find_reference",
    "find_reference_of_masks",
    "fit_calibration",
    "save_detectors",
    "scan_rails",
    "spot_scenes",
    "view_dataset",
    "write_reference",
    "write_spots",
]

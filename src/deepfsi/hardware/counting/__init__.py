"""Photons to counts: frames found by markers, gates counted, counts corrected; tables, too."""

from deepfsi.hardware.counting.acquisition import (
    Acquisition,
    Calibration,
    ReferenceVerdict,
    Scene,
    prepare_run,
    read_run,
)
from deepfsi.hardware.counting.count import CountSettings, count_run
from deepfsi.hardware.counting.counts import Counts, read_counts
from deepfsi.hardware.counting.streaming import FrameCounter, FrameCounts, FrameGates
from deepfsi.hardware.counting.tables import TableSettings, count_table, table_of_series

__all__ = [
    "Acquisition",
    "Calibration",
    "CountSettings",
    "Counts",
    "FrameCounter",
    "FrameCounts",
    "FrameGates",
    "ReferenceVerdict",
    "Scene",
    "TableSettings",
    "count_run",
    "count_table",
    "prepare_run",
    "read_counts",
    "read_run",
    "table_of_series",
]

"""Design and camera together: counts to classes, scenes of a run, calibration, looks."""

from deepfsi.lab.calibration import calibrate, check_view, gains_of
from deepfsi.lab.classify import classify_run, classify_table
from deepfsi.lab.looks import open_looks
from deepfsi.lab.rails import design_rails, patterns_for_now
from deepfsi.lab.results import ClassifiedRun, ClassifiedScene

__all__ = [
    "ClassifiedRun",
    "ClassifiedScene",
    "calibrate",
    "check_view",
    "classify_run",
    "classify_table",
    "design_rails",
    "gains_of",
    "open_looks",
    "patterns_for_now",
]

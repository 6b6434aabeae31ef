"""Design and camera together: counts to classes, data of a design, calibration, looks."""

from deepfsi.lab.calibration import calibrate, check_view, gains_of
from deepfsi.lab.classify import ClassifiedRun, ClassifiedScene, classify_run, classify_table
from deepfsi.lab.design_data import data_of, data_of_file, displayed, open_design, picture_hashes
from deepfsi.lab.looks import design_rails, open_looks
from deepfsi.lab.prediction import predict
from deepfsi.lab.transits import classify_transits, simulate_transits

__all__ = [
    "ClassifiedRun",
    "ClassifiedScene",
    "calibrate",
    "check_view",
    "classify_run",
    "classify_table",
    "classify_transits",
    "data_of",
    "data_of_file",
    "design_rails",
    "displayed",
    "gains_of",
    "open_design",
    "open_looks",
    "picture_hashes",
    "predict",
    "simulate_transits",
]

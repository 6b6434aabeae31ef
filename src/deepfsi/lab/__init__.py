"""Design and camera together: counts to classes, data of a design, calibration, looks."""

from deepfsi.lab.calibration import calibrate, check_view, gains_of
from deepfsi.lab.classify import classify_run, classify_table
from deepfsi.lab.design_data import data_of, data_of_file, open_design
from deepfsi.lab.looks import camera_of, design_rails, open_looks, virtual_camera
from deepfsi.lab.losses import plan_losses
from deepfsi.lab.prediction import predict
from deepfsi.lab.scenes import displayed, listed_scenes, picture_hashes, scenes_of
from deepfsi.lab.transits import classify_transits, simulate_transits

__all__ = [
    "calibrate",
    "camera_of",
    "check_view",
    "classify_run",
    "classify_table",
    "classify_transits",
    "data_of",
    "data_of_file",
    "design_rails",
    "displayed",
    "gains_of",
    "listed_scenes",
    "open_design",
    "open_looks",
    "picture_hashes",
    "plan_losses",
    "predict",
    "scenes_of",
    "simulate_transits",
    "virtual_camera",
]

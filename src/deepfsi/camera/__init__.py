"""The apparatus as a user describes it: optics, device, detectors, noise, light (no torch)."""

from deepfsi.camera.camera import PRESETS, Camera, CameraSource, Levels
from deepfsi.camera.dead_time import NO_DEAD_TIME, CorrectionFactors, CounterEffects, DeadTime
from deepfsi.camera.detectors import (
    ONE_DETECTOR,
    DetectorMap,
    SeveralDetectors,
)
from deepfsi.camera.device import (
    BIT_PLANES,
    DEVICE_SOURCES,
    DEVICES,
    LONGEST_PICTURE_S,
    Device,
    find_device,
)
from deepfsi.camera.layout import DmdGrid, DmdLayout, find_grid
from deepfsi.camera.light import (
    TOO_DIM,
    PhotonBudget,
    check_budget,
    check_one_budget,
    photons_per_pixel,
    share_out,
    summed_reflectance,
)
from deepfsi.camera.names import (
    LIGHT_LAWS,
    NOISES,
    LightLawName,
    NoiseName,
    NoiseSetting,
    RailsKind,
    Readout,
    SummedReflectance,
    check_light_law,
    check_noise,
    find_noise,
    noise_name,
    noise_text,
)
from deepfsi.camera.stop_rule import LiveSettings, StopRule

__all__ = [
    "BIT_PLANES",
    "DEVICES",
    "DEVICE_SOURCES",
    "LIGHT_LAWS",
    "LONGEST_PICTURE_S",
    "NOISES",
    "NO_DEAD_TIME",
    "ONE_DETECTOR",
    "PRESETS",
    "TOO_DIM",
    "Camera",
    "CameraSource",
    "CorrectionFactors",
    "CounterEffects",
    "DeadTime",
    "DetectorMap",
    "Device",
    "DmdGrid",
    "DmdLayout",
    "Levels",
    "LightLawName",
    "LiveSettings",
    "NoiseName",
    "NoiseSetting",
    "PhotonBudget",
    "RailsKind",
    "Readout",
    "SeveralDetectors",
    "StopRule",
    "SummedReflectance",
    "check_budget",
    "check_light_law",
    "check_noise",
    "check_one_budget",
    "find_device",
    "find_grid",
    "find_noise",
    "noise_name",
    "noise_text",
    "photons_per_pixel",
    "share_out",
    "summed_reflectance",
]

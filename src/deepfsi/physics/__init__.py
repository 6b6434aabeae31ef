"""Masks, light and noise: what the light does between a scene and the counts."""

from deepfsi.physics.clicks import full_gates, to_training_light
from deepfsi.physics.detection import Detection
from deepfsi.physics.laws import (
    ROUNDING_SLACK,
    frame_peaks,
    frames,
    light_law,
    signed_parts,
    through,
)
from deepfsi.physics.masks import FixedMasks, LearnedMasks
from deepfsi.physics.noise import Fluctuation, NoiseFunction, Poisson, noise_of, root
from deepfsi.physics.rails import Rails
from deepfsi.physics.scanner import Scanner, project, project_rails
from deepfsi.physics.surroundings import library_defaults, torch_device
from deepfsi.physics.training_noise import (
    Draws,
    SeedStream,
    TrainingNoise,
    ml_gauss_features,
    side_by_side,
)
from deepfsi.physics.transit import FixedPattern, LearnedPattern, ScenePath, in_levels

__all__ = [
    "ROUNDING_SLACK",
    "Detection",
    "Draws",
    "FixedMasks",
    "FixedPattern",
    "Fluctuation",
    "LearnedMasks",
    "LearnedPattern",
    "NoiseFunction",
    "Poisson",
    "Rails",
    "Scanner",
    "ScenePath",
    "SeedStream",
    "TrainingNoise",
    "frame_peaks",
    "frames",
    "full_gates",
    "in_levels",
    "library_defaults",
    "light_law",
    "ml_gauss_features",
    "noise_of",
    "project",
    "project_rails",
    "root",
    "side_by_side",
    "signed_parts",
    "through",
    "to_training_light",
    "torch_device",
]

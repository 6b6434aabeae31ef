"""Recordings of the virtual camera that the tests share."""

from pathlib import Path

import numpy as np

from deepfsi.base.progress import SILENT
from deepfsi.counting.acquisition import Acquisition, Scene
from deepfsi.lab.virtual_optics import VirtualCamera, record_scenes
from deepfsi.patterns.folder import Patterns


def record(
    out: Path, patterns: Path, x: np.ndarray, camera: VirtualCamera, flux: float,
    exposure_s: float, names=None, labels=None, report=SILENT, **settings,
) -> Path:  # fmt: skip
    """Record scenes with the patterns of a folder, named by their places unless given."""
    shown = Patterns.read(patterns)
    named = zip(names or map(str, range(len(x))), labels or [None] * len(x), strict=True)
    told = {"flux": flux or None, "camera": camera.model_dump(mode="json"), **settings}
    scenes = tuple(Scene(name=name, label=label) for name, label in named)
    acquisition = Acquisition.plan(shown.manifest, scenes, exposure_s=exposure_s, **told)
    record_scenes(out, shown, x, acquisition, report)
    return out

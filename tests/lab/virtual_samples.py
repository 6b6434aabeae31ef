"""Scenes and patterns that the tests of the virtual camera share."""

from pathlib import Path

import numpy as np
import pytest
import torch

from deepfsi import Scanner
from deepfsi.camera.detectors import DetectorMap
from deepfsi.camera.device import Device
from deepfsi.camera.layout import DmdLayout
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.rails import DesignRails
from deepfsi.physics.laws import light_law
from shared import virtual_runs

OPTICS = [("equal-dwell", "dual"), ("free-dwell", "single"), ("two-arm", "dual")]
every_optics = pytest.mark.parametrize(("light", "rails"), OPTICS)

DEVICE = Device(name="small", columns=36, rows=26, shortest_us=10, settle_us=2)
SHAPE = (3, 4)
SUMMED_REFLECTANCE = 7.0


def scenes(number: int = 3, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    return np.random.default_rng(4).uniform(0.1, 1, (number, *shape)).astype(np.float32)


def patterns(folder: Path, light="equal-dwell", rails="dual", dwell=2e-3, cells=None) -> Patterns:
    """Export five random masks, one of them with a dark rail; cells are the detectors' numbers."""
    wild = np.random.default_rng(3).random((5, 12)) - (0.5 if rails == "dual" else 0)
    wild[1] = abs(wild[1])
    fitted = light_law(light).fit(torch.from_numpy(wild), rails).numpy()
    detectors = None if cells is None else DetectorMap(count=max(cells) + 1, cells=cells)
    design = DesignRails(fitted, light, SHAPE, SUMMED_REFLECTANCE, None, None, detectors)
    return Patterns.from_rails(design, DEVICE, dwell, layout=DmdLayout(stretch=True)).write(folder)


def record(folder: Path, x: np.ndarray, name="run", **settings) -> Path:
    """Record scenes with the patterns in `folder`/p, named by their places."""
    return virtual_runs.record(folder / name, folder / "p", x, **{"seed": 0, **settings})


def expected(shown: Patterns, x: np.ndarray, photons: float, detection=None) -> np.ndarray:
    """What the scanner expects of the realised rails, (S, rails, m, detectors if several)."""
    rails = torch.from_numpy(shown.rails)
    scanner = Scanner.from_rails(rails, detection=detection)
    flat = torch.from_numpy(x.reshape(len(x), -1).astype(np.float64))
    return scanner.rates(flat * (photons / SUMMED_REFLECTANCE)).numpy()

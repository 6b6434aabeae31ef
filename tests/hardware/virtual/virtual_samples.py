"""Scenes and patterns that the tests of the virtual camera share."""

from pathlib import Path

import numpy as np
import torch

from deepfsi.base import Progress
from deepfsi.camera import Device, DmdLayout
from deepfsi.hardware.patterns import DesignRails, FrameSettings, export_patterns
from deepfsi.physics import light_law

DEVICE = Device(name="small", columns=36, rows=26, shortest_us=10, settle_us=2)
SHAPE = (3, 4)
SUMMED_REFLECTANCE = 7.0


def scenes(number: int = 3, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    return np.random.default_rng(4).uniform(0.1, 1, (number, *shape)).astype(np.float32)


def patterns(folder: Path, light: str = "equal-dwell", rails: str = "dual", masks=5, dwell=2e-3):
    """Export random masks, one of them with a dark rail."""
    wild = np.random.default_rng(3).random((masks, 12)) - (0.5 if rails == "dual" else 0)
    wild[1] = abs(wild[1])
    fitted = light_law(light).fit(torch.from_numpy(wild), rails).numpy()
    design = DesignRails(fitted, light, SHAPE, SUMMED_REFLECTANCE)
    settings = FrameSettings(DEVICE, dwell, layout=DmdLayout(stretch=True))
    return export_patterns(design, settings, folder)


def into(shares: list[float]) -> Progress:
    """Report that keeps the shares."""
    return Progress(lambda share, _: shares.append(share))

"""Patterns that the tests share: masks of few cells on a small device."""

from pathlib import Path

import numpy as np
import pytest

from deepfsi.base.progress import SILENT
from deepfsi.camera.device import DEVICES, Device, find_device
from deepfsi.camera.layout import DmdLayout
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.rails import DesignRails

SMALL = find_device("67x50")
"""Not whole bytes across, and cells of 8 x 8 leave margins."""

UNEQUAL = np.array([0.999, 0.001])[None, :, None].repeat(16, axis=2)
every_format = pytest.mark.parametrize("form", ["npy", "bmp", "raw", "planes"])


def family(name: str) -> Device:
    """A device of few mirrors with the limits of a named one.

    Its rows have no whole bytes, and no whole 4 bytes of a bitmap.
    """
    return DEVICES[name].model_copy(update={"columns": 37, "rows": 26})


BOARD = family("dlp6500")


def grey(masks: int = 5, pixels: int = 16, rails: int = 2, seed: int = 0) -> np.ndarray:
    """Free-dwell rails, unlike each other in their peaks."""
    rng = np.random.default_rng(seed)
    out = rng.random((rails, masks, pixels)) * rng.random((rails, masks, 1))
    return out / out.max(axis=-1).sum()


def export(
    folder: Path, rails=None, light="free-dwell", image_shape=(4, 4), s=3.0, file=None,
    report=SILENT, **changes,
):  # fmt: skip
    usual = {"device": SMALL, "dwell_s": 1e-3, "layout": DmdLayout(stretch=True)}
    design = DesignRails(grey() if rails is None else rails, light, image_shape, s, file)
    return Patterns.from_rails(design, **{**usual, **changes}).write(folder, report)

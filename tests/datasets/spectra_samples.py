"""A small hyperspectral image whose pixels tell where they are."""

from __future__ import annotations

import numpy as np

from deepfsi.datasets import SpectralImage


def fields(side=60, classes=4):
    """A label map of square fields with unlabelled paths between them."""
    labels = np.zeros((side, side), np.uint8)
    step = side // 4
    for i in range(4):
        for j in range(4):
            inside = slice(i * step, (i + 1) * step - 1), slice(j * step, (j + 1) * step - 1)
            labels[inside] = 1 + (i + j) % classes
    return labels


def numbered(labels, bands=5):
    """A cube whose first two bands tell the row and column, the last the class."""
    cube = np.full((*labels.shape, bands), 30, np.int16)
    cube[..., 0], cube[..., 1] = np.indices(labels.shape)
    cube[..., -1] = labels * 20
    cube[0, 0, 2], cube[-1, -1, 2] = -100, 300  # what becomes 0 and 1
    return cube


LABELS = fields()

IMAGE = SpectralImage("farm", numbered(LABELS), LABELS)

NM = np.linspace(400.02, 2498.96, 220).round(6)

"""Designs that were learned on measured readouts: their scale, and no masks.

Such a design is one of impulse imaging without noise, whose "pixels" are the readouts, each mapped
from its span to [0, 1]. Offset and gain of that map stand in `Design.info`.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.designfile.provenance import READOUTS

if TYPE_CHECKING:
    from deepfsi.design.design import Design

READOUT_PHOTONS = 1e4
"""Budget that the design needs and that, without noise, nothing depends on."""


class ReadoutClasses(NamedTuple):
    """Answers to readouts of a detector."""

    chances: np.ndarray  # (n, C)
    scenes: np.ndarray  # (n, k): readouts as the design sees them
    outside: float  # share of readouts outside of the span of those of the training's table


def classify_readouts(design: "Design", values: np.ndarray) -> ReadoutClasses:
    """Classify new readouts (n, k), in the unit of those of the training."""
    if values.ndim != 2 or values.shape[1] != design.masks:
        raise InputError(
            f"readouts of shape {values.shape} do not fit: give {design.masks} for each recording"
        )
    known = design.info[READOUTS]
    x = (values - np.array(known["offset"])) / np.array(known["gain"])
    chances = design.classify(x / design.summed_reflectance * READOUT_PHOTONS, READOUT_PHOTONS)
    return ReadoutClasses(chances, x, float(((x < 0) | (x > 1)).mean()))

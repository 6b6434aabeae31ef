"""Names of light laws, rails, readouts, noises and scales, and limits, shared by all parts."""

import re
from typing import Annotated, Literal, get_args

from pydantic import Field

from deepfsi.base import plugins as imports
from deepfsi.base.errors import check_known

Light = Literal["column", "equal-dwell", "free-dwell", "two-arm"]
"""Name of a light law, see `optics.constraints`."""

LOOK_LIGHT: tuple[Light, ...] = ("free-dwell", "two-arm")
"""Light laws under which a device can show masks that are made while it looks."""

RailsKind = Literal["dual", "single"]
"""Rails of each mask: positive and negative part, or one non-negative frame."""

Readout = Literal["difference", "both"]
"""What a network reads of two rails."""

Scale = Literal["each", "common"]
"""Whether each feature has a standard deviation of its own, or all a common one."""

Noise = Literal["none", "gaussian", "poisson", "ml_gauss", "camera", "click"]
"""Name of a detector noise, see `optics.noise`."""

MLP, VIT = "mlp", "vit"
"""Names of the paper's classifier, and of the transformer of patches, in settings."""

MOST_LAYERS = 64
"""Hidden layers of a network at most."""

Widths = Annotated[tuple[Annotated[int, Field(ge=1)], ...], Field(max_length=MOST_LAYERS)]
"""Widths of the hidden layers of a network."""

SummedReflectance = Annotated[float, Field(ge=1e-6, allow_inf_nan=False)]
"""Mean summed reflectance of training scenes, s."""


def check_noise(name: str) -> str:
    """Return the name or import path of a noise, or raise `InputError` that names the closest."""
    if not re.fullmatch(imports.PATTERN, name):
        check_known("noise", name, get_args(Noise))
    return name

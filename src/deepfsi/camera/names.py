"""Names of light laws, rails, readouts, noises and scales, and limits, shared by all parts."""

import re
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, Field, PlainSerializer, WithJsonSchema

from deepfsi.base import plugins as imports
from deepfsi.base.errors import check_known
from deepfsi.base.plugins import UNNAMED

LightLawName = Literal["column", "equal-dwell", "free-dwell", "two-arm"]
"""Name of a light law, see `optics.constraints`."""

LOOK_LIGHT: tuple[LightLawName, ...] = ("free-dwell", "two-arm")
"""Light laws under which a device can show masks that are made while it looks."""

RailsKind = Literal["dual", "single"]
"""Rails of each mask: positive and negative part, or one non-negative frame."""

Readout = Literal["difference", "both"]
"""What a network reads of two rails."""

Scale = Literal["each", "common"]
"""Whether each feature has a standard deviation of its own, or all a common one."""

NoiseName = Literal["none", "gaussian", "poisson", "ml_gauss", "camera", "click"]
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
        check_known("noise", name, get_args(NoiseName))
    return name


NOISES = {"poisson": "photon noise", "gaussian": "Gaussian read noise", "camera": "camera noise"}


def noise_text(noise: str) -> str:
    """Name of a noise model for headings and sentences."""
    return NOISES.get(noise, f"{noise} noise")


def noise_name(noise: Any) -> str:
    """Name or import path of a noise that is given by name or as a function."""
    if isinstance(noise, str):
        return noise
    from deepfsi.optics.noise import resolve

    return resolve(noise)[0]


def _known_noise(noise: Any) -> Any:
    if not (isinstance(noise, str) or callable(noise)):
        raise ValueError("give a noise's name, or noise(rates, generator) of your own")
    if isinstance(noise, str) and noise != UNNAMED:
        check_noise(noise)
    return noise


NoiseSetting = Annotated[
    Any,
    AfterValidator(_known_noise),
    PlainSerializer(noise_name, return_type=str),
    WithJsonSchema({"type": "string"}),
]
"""Name of a noise, import path of one's own, or its function."""

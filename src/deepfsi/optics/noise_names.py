"""A noise as a setting: its name, the import path of one's own, or its function."""

from typing import Annotated, Any

from pydantic import AfterValidator, PlainSerializer, WithJsonSchema

from deepfsi.base.plugins import UNNAMED
from deepfsi.laws import check_noise

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


Noise = Annotated[
    Any,
    AfterValidator(_known_noise),
    PlainSerializer(noise_name, return_type=str),
    WithJsonSchema({"type": "string"}),
]
"""Name of a noise, import path of one's own, or its function."""

"""Names of light laws, noises, rails and readouts, and the facts of laws and noises.

Other modules ask facts, never names: only `LIGHT_LAWS` and `NOISES` tell one name from another.
"""

import re
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, Field, PlainSerializer, WithJsonSchema

from deepfsi.base.errors import InputError, check_choice
from deepfsi.base.registry import IMPORT_PATH, UNNAMED_PLUGIN, import_path

LightLawName = Literal["column", "equal-dwell", "free-dwell", "two-arm", "dose"]
"""Name of a light law, see `physics.laws`."""

RailsKind = Literal["dual", "single"]
"""Rails of each mask: positive and negative part, or one non-negative frame."""

Readout = Literal["difference", "both"]
"""What a network reads of two rails."""

NoiseName = Literal["none", "gaussian", "poisson", "ml_gauss", "camera", "click"]
"""Name of a detector noise, see `physics.noise`."""

SummedReflectance = Annotated[float, Field(ge=1e-6, allow_inf_nan=False)]
"""Mean summed reflectance of training scenes, s."""


@dataclass(frozen=True)
class LightLawFacts:
    """Facts of a light law, true for all masks."""

    optics: str  # a phrase for the optics that realise it
    in_turn: bool = True
    one_device: bool = True  # True if one micromirror device shows the masks
    lights_all: bool = False
    arms: int = 1  # arms of the device whose light is counted
    looks: bool = False  # True if masks can be chosen while the exposure runs
    equal_times: bool = False  # True if all frames are shown for the same time
    usual_rails: RailsKind = "single"
    usual_readout: Readout = "difference"


LIGHT_LAWS: dict[str, LightLawFacts] = {
    "column": LightLawFacts(
        "optics that split each pixel's light among all readouts, with a detector for each",
        in_turn=False,
        one_device=False,
        usual_rails="dual",
    ),
    "equal-dwell": LightLawFacts("one DMD, every frame for the same time", equal_times=True),
    "free-dwell": LightLawFacts("one DMD, every frame for a time of its own", looks=True),
    "two-arm": LightLawFacts(
        "one DMD with a detector on each arm",
        lights_all=True,
        arms=2,
        looks=True,
        usual_rails="dual",
        usual_readout="both",
    ),
    "dose": LightLawFacts(
        "a projector that lights the scene with the masks, and one detector",
        one_device=False,
        lights_all=True,
    ),
}
"""Facts of each light law, by its name."""


def check_light_law(light: str, rails: str) -> None:
    """Raise `InputError` unless a light law exists and allows these rails."""
    check_choice("light law", light, LIGHT_LAWS)
    check_choice("rails", rails, get_args(RailsKind))
    if LIGHT_LAWS[light].arms == 2 and rails == "single":
        raise InputError(
            "two-arm with a single rail is not allowed: each arm is a rail; use dual rails, and "
            "not raster or s-matrix, which have one"
        )


@dataclass(frozen=True)
class NoiseFacts:
    """Facts of a noise, true for all rates."""

    title: str  # name for headings and sentences
    shot: bool = False  # whether mean and variance grow with the light as for photons
    counting: bool = False  # True if whole counts are drawn, whose mean is known
    dark: bool = False
    read_noise: bool = False
    gates: bool = False
    dead_time: bool = True
    fluctuation: bool = True
    steady: bool = True  # False if the light fluctuates from frame to frame, as a camera says
    usual_sigma: float = 1.0  # `sigma` of a camera where it is not given, counts rms per readout
    trains_as: NoiseName | None = None  # noise that is trained under in its place
    stands_for: NoiseName | None = None  # noise whose smooth stand-in it is

    @property
    def read_noise_alone(self) -> bool:
        """True if it is read noise alone, independent of the light."""
        return self.read_noise and not self.shot

    @property
    def exact(self) -> bool:
        """Whether counts are photons of steady light and nothing else."""
        return self.shot and self.counting and self.steady and not (self.dark or self.read_noise)


NOISES: dict[str, NoiseFacts] = {
    "none": NoiseFacts("none noise"),
    "gaussian": NoiseFacts("Gaussian read noise", read_noise=True),
    "poisson": NoiseFacts("photon noise", shot=True, counting=True, trains_as="ml_gauss"),
    "ml_gauss": NoiseFacts("ml_gauss noise", shot=True, stands_for="poisson"),
    "camera": NoiseFacts(
        "camera noise",
        shot=True,
        counting=True,
        dark=True,
        read_noise=True,
        usual_sigma=0.0,
    ),
    "click": NoiseFacts(
        "click noise", counting=True, gates=True, dead_time=False, fluctuation=False
    ),
}
"""Facts of each noise of the package, by its name."""


def find_noise(noise: Any) -> NoiseFacts:
    """Facts of a noise by its name or function; a user's noise has only a name."""
    name = noise_name(noise)
    return NOISES.get(name) or NoiseFacts(f"{name} noise")


def noise_text(noise: str) -> str:
    """Name of a noise for headings and sentences."""
    return find_noise(noise).title


def check_noise(name: str) -> str:
    """Return the name or import path of a noise, or raise `InputError` that names the closest."""
    if not re.fullmatch(IMPORT_PATH, name):
        check_choice("noise", name, NOISES)
    return name


def noise_name(noise: Any) -> str:
    """Name or import path of a noise that is given by name or as a function."""
    if isinstance(noise, str):
        return noise
    name = getattr(noise, "name", None)  # of an object of the package's, such as `Click`
    return name if name in NOISES else import_path(noise) or UNNAMED_PLUGIN


def _check_setting(noise: Any) -> Any:
    if not (isinstance(noise, str) or callable(noise)):
        raise ValueError("give a noise's name, or noise(rates, generator) of your own")
    if isinstance(noise, str) and noise != UNNAMED_PLUGIN:
        check_noise(noise)
    return noise


NoiseSetting = Annotated[
    Any,
    AfterValidator(_check_setting),
    PlainSerializer(noise_name, return_type=str),
    WithJsonSchema({"type": "string"}),
]
"""Name of a noise, or a user's noise: its import path or function."""

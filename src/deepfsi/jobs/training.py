"""Settings of a training: its steps, its network, its precision and its start.

A classifier and a loss of a user's own are a name, an import path, or the object itself.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer, WithJsonSchema

from deepfsi.base.errors import InputError
from deepfsi.base.models import Amount, Count, Positive, StrictModel, UserModel
from deepfsi.base.registry import IMPORT_PATH, UNNAMED_PLUGIN, import_path, installed
from deepfsi.camera.names import NoiseSetting
from deepfsi.jobs.designs import DESIGNS, check_design

MOST_READY = 2**16
"""Masks of a dictionary, at most: tables of them are held for each scene."""

MLP = "mlp"
"""The paper's classifier, which is the usual one."""


@dataclass(frozen=True)
class ClassifierFacts:
    """Facts of a classifier."""

    sizes: tuple[str, ...] = ()  # its arguments, whole numbers of 1 or more
    features: str = ""  # parts of scenes that it reads, as in `Exposure`
    # For a classifier of another package: its entry in a header, and the import path of its class
    entry: type[StrictModel] | None = None
    network: str = ""


CUSTOM_CLASSIFIER = ClassifierFacts()


def find_classifier(name: str) -> ClassifierFacts:
    """Facts of a classifier that settings or a design file name."""
    # Equal to that of a user's own, but another object: `is` tells them apart
    if name == MLP:
        return ClassifierFacts()
    path = installed().parts["classifier"].get(name)
    return resolve_name(path) if path else CUSTOM_CLASSIFIER


MOST_LAYERS = 64
"""Largest number of hidden layers of a network."""

Widths = Annotated[tuple[Count, ...], Field(max_length=MOST_LAYERS)]
"""Widths of the hidden layers of a network."""

Scale = Literal["each", "common"]
"""Whether each feature has a standard deviation of its own, or all a common one."""


def part_name(part: Any) -> Any:
    """Name or import path of a classifier or a loss, `UNNAMED_PLUGIN` of one that has none."""
    if part is None or isinstance(part, str):
        return part
    return import_path(part) or UNNAMED_PLUGIN


def _check_own(part: Any, advice: str) -> Any:
    """A part of a user's own or its import path; else an error that says what to give."""
    named = isinstance(part, str) and re.fullmatch(f"{IMPORT_PATH}|{UNNAMED_PLUGIN}", part)
    if not (named or callable(part)):
        raise ValueError(advice)
    return part


def _classifier(part: Any) -> Any:
    known = isinstance(part, str) and find_classifier(part) is not CUSTOM_CLASSIFIER
    return part if known else _check_own(part, f"give {MLP}, or module:factory of your own")


def _loss(part: Any) -> Any:
    advice = "give module:function, or a function of outputs and truth"
    return part if part is None else _check_own(part, advice)


OwnPart = Annotated[
    Any, PlainSerializer(part_name, return_type=str | None), WithJsonSchema({"type": "string"})
]
"""Name or import path of a part, or the part itself."""


def _start(name: str) -> str:
    if DESIGNS[check_design(name)].make is None:
        raise InputError(f"masks cannot start from {name}: name a fixed design")
    return name


def _widths(text: Any) -> Any:
    return [width for width in text.split(",") if width] if isinstance(text, str) else text


class Training(UserModel):
    """Settings of a training: its steps, its network, its precision and its start.

    Examples
    --------
    >>> import deepfsi
    >>> deepfsi.Training(epochs=20, hidden=(256, 128), start="class-pairs").lr
    0.01
    """

    epochs: int = Field(default=40, ge=1, le=100_000, description="passes over the training scenes")
    batch: int | None = Field(
        default=None, ge=2, description="scenes of a step; default: a hundredth, 32 to 500"
    )
    lr: Positive = Field(
        default=1e-2, description="peak learning rate of one cycle, unless tuned for the design"
    )
    mask_lr: Positive = Field(
        default=1e-1, description="peak learning rate of the masks, relative to their rms"
    )
    hidden: Annotated[Widths, BeforeValidator(_widths)] = Field(
        default=(40, 128), description="widths of the hidden layers of mlp; default: 40,128"
    )
    dropout: float = Field(
        default=0.0, ge=0, lt=1, description="share of hidden units left out in a step"
    )
    classifier: Annotated[OwnPart, AfterValidator(_classifier)] = Field(
        default=MLP, description="mlp, or module:factory of a torch module of your own"
    )
    classifier_arguments: dict[str, Any] = Field(
        default={}, description="keyword arguments of that factory, besides the numbers"
    )
    scale: Scale = Field(
        default="common", description="standard deviation of features: each, or common"
    )
    decay: Amount = Field(default=0.0, description="decoupled weight decay of the classifier")
    balance: bool = Field(
        default=False, description="weigh scenes so that all classes count alike in the loss"
    )
    counts: Positive | None = Field(
        default=None,
        description="mean counts of an exposure: masks learn which photons of the budget to count",
    )
    start: Annotated[str, AfterValidator(_start)] = Field(
        default="pca",
        description="design that learned masks start from; default: pca, for few counts random",
    )
    start_counts: Positive = Field(
        default=10.0,
        exclude_if=lambda times: times == 10,  # keys and files of before it stay as they are
        description="of few counts: masks start at this multiple of them, if gates allow it",
    )
    clusters: Count | None = Field(
        default=None,
        description="of adaptive masks: centres of a class as prior; default: all scenes",
    )
    dictionary: int | None = Field(
        default=None,
        ge=2,
        le=MOST_READY,
        exclude_if=lambda count: count is None,
        description="of adaptive masks: so many masks stay on the device; default: made anew",
    )
    precision: Literal["auto", "float32", "bfloat16"] = Field(
        default="auto",
        description="type of products: float32, bfloat16, or auto (bfloat16 below the noise)",
    )
    loss: Annotated[OwnPart, AfterValidator(_loss)] = Field(
        default=None,
        description="module:function of a loss of your own, of outputs (n, C) and truth (n,) of "
        "classes or (n, q) of values; default: cross entropy, or the squared error of values",
    )
    noise: NoiseSetting | None = Field(
        default=None,
        description="noise of the training, if other than the camera's; default: ml_gauss for "
        "photon noise",
    )

    @property
    def is_custom(self) -> bool:
        """True if the classifier is a user's own."""
        return find_classifier(part_name(self.classifier)) is CUSTOM_CLASSIFIER


TrainingSource = Training | Mapping[str, Any]
"""Settings of a training, or its fields."""

TUNED: dict[str, dict[str, Any]] = {
    "impulse": {"lr": 5e-3},
    "truncated-hadamard": {"lr": 5e-3},
    "raster": {"lr": 5e-3, "scale": "each"},
    "hadamard": {"lr": 5e-3, "scale": "each"},
}
"""Where a design does better with other settings than the defaults of `Training`.

Chosen on the last 10 000 training images of MNIST at 1e3, 1e4 and 1e5 photons, each design from
the same grid: lr 2e-3, 5e-3, 1e-2; scale each, common; dropout 0, 0.1 (for those of a thousand
readouts at one setting at most). Designs not named here, but for learned ones and PCA, are untuned.
"""

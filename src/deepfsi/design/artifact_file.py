"""The design file: tensors and a JSON header in one safetensors file that holds no code."""

import json
import math
import os
from collections.abc import Mapping
from importlib.metadata import version
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import torch
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator
from safetensors.torch import save as to_bytes
from torch import Tensor, nn

from deepfsi.base.errors import InputError
from deepfsi.base.plugins import PATTERN
from deepfsi.camera.names import MOST_LAYERS, LightLawName, Readout, SummedReflectance, Widths
from deepfsi.design.classifiers import Mlp, Vit, restored
from deepfsi.design.consistency import ReadoutDistribution
from deepfsi.design.exposure.conditioned import ConditionedExposure
from deepfsi.design.exposure.looks import LooksExposure
from deepfsi.design.exposure.passing import PassingExposure
from deepfsi.design.exposure.trained import FixedExposure, PatchExposure, TrainedExposure
from deepfsi.design.file_content import SCHEMA, Info, damaged, read_known_masks
from deepfsi.design.own import OwnClassifier
from deepfsi.design.temperatures import Temperatures
from deepfsi.design.training_data import TrainingScenes
from deepfsi.design.values import Values
from deepfsi.design.view_test import SceneModel
from deepfsi.jobs.designs import check_design
from deepfsi.jobs.entries import ExposureEntry
from deepfsi.optics import constraints
from deepfsi.optics.detection import Detection
from deepfsi.optics.rails import Rails

if TYPE_CHECKING:
    from deepfsi.design.artifact import Design

WORDS = ("name", "light", "summed_reflectance", "image_shape", "classes", "info")
"""Fields of a design that its header holds as they are."""

STATISTICS = ("mean", "std", "shares")
"""Tensors of one number a feature."""

KINDS: dict[str, type[TrainedExposure]] = {
    "fixed": FixedExposure,
    "conditioned": ConditionedExposure,
    "adaptive": LooksExposure,
    "patches": PatchExposure,
    "passing": PassingExposure,
}
"""What a design does with the masks of its file, by the kind of their entry."""

STRICT = ConfigDict(extra="forbid", strict=True)
"""Configuration of what a design file's header holds: no further fields, no conversions."""

Count = Annotated[int, Field(ge=1)]


class MlpSize(BaseModel):
    """Entry of the header for an `Mlp`: its parameters of the same names.

    Attributes
    ----------
    hidden : tuple of int
        Widths of the hidden layers.
    dropout : float
        Share of hidden units left out in a step of training.
    """

    model_config = STRICT

    kind: Literal["mlp"]
    hidden: Widths
    dropout: float = Field(ge=0, lt=1)
    patches: ClassVar = 1


class VitSize(BaseModel):
    """Entry of the header for a `Vit`: its parameters of the same names.

    Attributes
    ----------
    patches : int
        Patches of an image.
    width : int
        Numbers that stand for a patch.
    depth : int
        Transformer blocks.
    heads : int
        Attention heads of a block.
    hidden : int
        Hidden units of a block's feed-forward network.
    """

    model_config = STRICT

    kind: Literal["vit"]
    patches: Count
    width: Count
    depth: int = Field(ge=1, le=MOST_LAYERS)
    heads: Count
    hidden: Count


class OwnShape(BaseModel):
    """Entry of the header for an `OwnClassifier`: its parameters of the same names.

    Attributes
    ----------
    factory : str
        module:name of the function or class that makes the module; empty of one given as an object.
    arguments : dict
        Its keyword arguments.
    """

    model_config = STRICT

    kind: Literal["own"]
    factory: str = Field(pattern=f"^({PATTERN})?$")
    arguments: dict[str, Any]
    patches: ClassVar = 1


class Header(BaseModel):
    """Header of a design file: all of a design but its tensors.

    Attributes
    ----------
    name : str
        Which design, such as deepfsi.
    light : str
        Light law that the rails obey.
    summed_reflectance : float
        s, the training scenes' mean summed reflectance: λ = Φ x / s.
    image_shape : tuple of int
        Rows and columns of a scene, or values of a spectrum.
    classes : tuple of str
        Names, in the order of the classifier's outputs; none of a design that estimates values.
    values : tuple of str
        Names of these, likewise.
    info : dict
        Provenance: settings of the training, data and their hash, versions, device, seconds.
    schema_number : int
        `SCHEMA`; "schema" in the file.
    deepfsi : str
        Version of the package that wrote it.
    readout : str
        What is read of two rails, of `detection.Detection`.
    exposure, classifier
        Kind and sizes: what rebuilds them, with the tensors.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, populate_by_name=True)

    schema_number: Literal[1] = Field(SCHEMA, alias="schema")
    deepfsi: str = version("deepfsi")
    name: Annotated[str, AfterValidator(check_design)]
    light: LightLawName
    readout: Readout
    summed_reflectance: SummedReflectance
    image_shape: tuple[Count, ...]
    classes: tuple[str, ...]
    values: tuple[str, ...] = ()
    exposure: ExposureEntry
    classifier: Annotated[MlpSize | VitSize | OwnShape, Field(discriminator="kind")]
    info: Info

    @model_validator(mode="after")
    def _consistent(self) -> "Header":
        if (self.classifier.kind == "vit") != (self.exposure.kind == "patches"):
            raise ValueError("a transformer reads patches, and nothing else does")
        if bool(self.classes) == bool(self.values):
            raise ValueError("a design answers either classes or values")
        return self


def pack(design: "Design") -> bytes:
    """Content of a design file, or `InputError` if its classifier cannot be described."""
    classifier, values = design.classifier, design.values
    if not isinstance(classifier, Mlp | Vit | OwnClassifier):
        raise InputError(
            f"a design with a {type(classifier).__name__} classifier cannot be saved: "
            "give it as deepfsi.OwnClassifier(module)"
        )
    own = isinstance(classifier, OwnClassifier)
    weights: dict[str, dict[str, Tensor]] = {
        "classifier": classifier.weights if own else classifier.state_dict(),  # type: ignore[dict-item]
        "exposure": design.exposure.weights,
        "distribution": design.distribution.tensors if design.distribution else {},
        "scenes": design.scene_model.tensors if design.scene_model else {},
        "temperatures": design.temperatures.tensors if design.temperatures else {},
        "values": values.tensors if values else {},
    }
    header = Header(
        exposure=design.exposure.entry(),
        classifier=classifier.header,  # type: ignore[arg-type]
        readout=design.detection.readout,
        values=values.names if values else (),
        **{name: getattr(design, name) for name in WORDS},
    )
    every = {name: getattr(design, name) for name in STATISTICS}
    every["rails"] = design.rails.stacked
    if design.detection.labels is not None:
        every["detectors"] = design.detection.labels
    if design.training_scenes is not None:
        every |= {k: torch.from_numpy(v) for k, v in design.training_scenes.tensors.items()}
    for part, state in weights.items():
        every |= {f"{part}.{key}": value for key, value in state.items()}
    # cloned: a user's module may share one tensor between layers
    whole = {key: value.detach().cpu().contiguous().clone() for key, value in every.items()}
    words = header.model_dump(mode="json", by_alias=True)
    return to_bytes(whole, metadata={"deepfsi": json.dumps(words)})


def read_design(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Fields of `artifact.Design` that a file holds, or `InputError` as for `Design.load`."""
    text, arrays = read_known_masks(path)
    tensors = {key: torch.from_numpy(held) for key, held in arrays.items()}
    try:
        fields = _fields(Header.model_validate_json(text), tensors)
        return {**fields, "training_scenes": TrainingScenes.restored(arrays)}
    except (KeyError, TypeError, ValueError, RuntimeError, IndexError) as error:
        raise damaged(path, text) from error


def _fields(header: Header, tensors: Mapping[str, Tensor]) -> dict[str, Any]:
    """Fields of `artifact.Design`, or an error where header and tensors do not fit together."""
    own = header.classifier.kind == "own"
    ours = [key for key in tensors if not (own and key.startswith("classifier."))]
    for key in ours:
        computed = key in ("rails", *STATISTICS) or key.startswith(("classifier.", "exposure."))
        if computed and tensors[key].dtype != torch.float32:
            raise ValueError(f"{key} holds numbers of another type")
        if not bool(torch.isfinite(tensors[key]).all()):
            raise ValueError("tensors are not finite")
    statistics = {name: tensors[name] for name in STATISTICS}
    rails, (_, masks, pixels) = Rails.of(tensors["rails"]), tensors["rails"].shape
    detection = _detection(header, tensors.get("detectors"))
    features = masks * detection.width(rails.count)
    if {each.shape for each in statistics.values()} != {(features,)} or (
        statistics["std"] <= 0
    ).any():
        raise ValueError("statistics are not those of the masks")
    constraints.check_light(header.light, rails.kind)
    constraints.check(rails.stacked, header.light)
    exposure = KINDS[header.exposure.kind].restored(
        header.exposure, _weights(tensors, "exposure."), features, rails, header.light
    )
    exposure.check(rails, header.light, header.image_shape)
    if math.prod(header.image_shape) != pixels * header.classifier.patches:
        raise ValueError("images have other pixels than masks on all patches")
    weights, size = _weights(tensors, "classifier."), header.classifier
    classifier: nn.Module
    if isinstance(size, OwnShape):
        classifier = OwnClassifier(None, size.factory, size.arguments, weights)
    else:
        classifier = restored(
            {"mlp": Mlp, "vit": Vit}[size.kind],
            weights,
            inputs=exposure.input_count(features),
            classes=len(header.classes or header.values),
            **size.model_dump(exclude={"kind"}),
        )
    words = {name: getattr(header, name) for name in WORDS}
    known = _weights(tensors, "distribution.")
    shape = exposure.compared(rails.count, masks * detection.count)
    arrays = {name: each.numpy() for name, each in known.items()}
    distribution = ReadoutDistribution.restored(arrays, *shape) if known else None
    kept = {name: each.numpy() for name, each in _weights(tensors, "scenes.").items()}
    pixels = math.prod(header.image_shape)
    model = SceneModel.restored(kept, pixels, len(header.classes) or 1) if kept else None
    held, scale = (_weights(tensors, part) for part in ("temperatures.", "values."))
    parts = {
        "rails": rails,
        "exposure": exposure,
        "detection": detection,
        "classifier": classifier,
        "distribution": distribution,
        "scene_model": model,
        "temperatures": Temperatures.restored(held, exposure.count_stops(masks)) if held else None,
        "values": Values.restored(header.values, scale) if header.values else None,
    }
    return {**words, **statistics, **parts}


def _detection(header: Header, labels: Tensor | None) -> Detection:
    """Detection of a design file, or an error where its detectors do not fit its scenes."""
    if labels is None:
        return Detection(header.readout)
    return Detection.of(labels.numpy(), header.image_shape, header.readout)


def _weights(tensors: Mapping[str, Tensor], part: str) -> dict[str, Tensor]:
    """Tensors of a part of a design among those of its file."""
    return {key.removeprefix(part): value for key, value in tensors.items() if key.startswith(part)}

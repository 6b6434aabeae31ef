"""A design and its file: what the file keeps of a design, and a design of a file."""

from collections.abc import Mapping
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor, nn

from deepfsi.base import InputError
from deepfsi.camera import DetectorMap
from deepfsi.designfile import CustomEntry, DesignFile, MaskHeader, damaged_design
from deepfsi.exposure.conditioned import ConditionedExposure
from deepfsi.exposure.looks import LooksExposure
from deepfsi.exposure.passing import PassingExposure
from deepfsi.exposure.trained import FixedExposure, PatchExposure, TrainedExposure
from deepfsi.networks.classifiers import Mlp, Vit, restored
from deepfsi.networks.custom import OwnClassifier
from deepfsi.networks.values import Values
from deepfsi.physics import Detection, Rails, light_law

if TYPE_CHECKING:
    from deepfsi.design.design import Design

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


def file_of(design: "Design") -> DesignFile:
    """File of a design, or `InputError` if its classifier cannot be described."""
    classifier = design.classifier
    values = design.values
    if not isinstance(classifier, Mlp | Vit | OwnClassifier):
        raise InputError(
            f"a design with a {type(classifier).__name__} classifier cannot be saved: "
            "give it as deepfsi.OwnClassifier(module)"
        )
    header = MaskHeader(
        deepfsi=version("deepfsi"),
        exposure=design.exposure.entry(),
        classifier=classifier.header,  # type: ignore[arg-type]
        readout=design.detection.readout,
        values=values.names if values else (),
        **{name: getattr(design, name) for name in WORDS},
    )
    custom = isinstance(classifier, OwnClassifier)
    tensors: dict[str, Tensor] = {name: getattr(design, name) for name in STATISTICS}
    tensors["rails"] = design.rails.stacked
    if design.detection.labels is not None:
        tensors["detectors"] = design.detection.labels
    networks: dict[str, Mapping[str, Tensor]] = {
        "classifier": classifier.weights if custom else classifier.state_dict(),  # type: ignore[dict-item]
        "exposure": design.exposure.weights,
        "values": values.tensors if values else {},
    }
    for network, state in networks.items():
        tensors |= {f"{network}.{name}": tensor for name, tensor in state.items()}
    arrays = {name: as_array(tensor) for name, tensor in tensors.items()}
    every = {
        "distribution": design.distribution,
        "scenes": design.scene_model,
        "temperatures": design.temperatures,
    }
    for owner, fitted in every.items():
        if fitted is not None:
            arrays |= {f"{owner}.{name}": array for name, array in fitted.arrays.items()}
    if design.training_scenes is not None:
        arrays |= design.training_scenes.arrays
    return DesignFile(header, arrays)


def as_array(tensor: Tensor) -> np.ndarray:
    """A tensor as NumPy, or `InputError` where NumPy has no such numbers."""
    try:
        return tensor.detach().cpu().contiguous().numpy()
    except TypeError:
        raise InputError(
            f"weights of type {tensor.dtype} cannot be saved: give a classifier of float32"
        ) from None


def fields_of(file: DesignFile) -> dict[str, Any]:
    """Fields of `artifact.Design` of a file, or `InputError` as for `Design.load`."""
    header = file.mask_header
    try:
        return _fields(file, header)
    except (KeyError, TypeError, ValueError, RuntimeError, IndexError) as error:
        raise damaged_design(file.path or "this", file.text or "") from error


def _fields(file: DesignFile, header: MaskHeader) -> dict[str, Any]:
    """Fields of a design, or an error where header and arrays do not fit together."""
    rails = Rails.of(torch.from_numpy(file.rails))
    detection = Detection(header.readout)
    if file.arrays.get("detectors") is not None:
        detectors = DetectorMap.of(file.arrays["detectors"], header.image_shape)
        detection = Detection.by(detectors, header.readout)
    light_law(header.light).check(rails.stacked)
    weights = {name: torch.from_numpy(array) for name, array in file.arrays_of("exposure").items()}
    exposure = KINDS[header.exposure.kind].restored(
        header.exposure, weights, file.feature_count, rails, header.light
    )
    exposure.check(rails, header.light, header.image_shape)
    scales = {name: torch.from_numpy(array) for name, array in file.arrays_of("values").items()}
    return {
        **{name: getattr(header, name) for name in WORDS},
        **{name: torch.from_numpy(file.arrays[name]) for name in STATISTICS},
        "rails": rails,
        "exposure": exposure,
        "detection": detection,
        "classifier": _classifier(file, header, exposure.input_count(file.feature_count)),
        "distribution": file.distribution,
        "scene_model": file.scene_model,
        "temperatures": file.temperatures,
        "values": Values.restored(header.values, scales) if header.values else None,
        "training_scenes": file.training_scenes,
    }


def _classifier(file: DesignFile, header: MaskHeader, inputs: int) -> nn.Module:
    """Classifier of a file, of so many inputs; one of its maker's own without its code."""
    sizes = header.classifier
    weights = {
        name: torch.from_numpy(array) for name, array in file.arrays_of("classifier").items()
    }
    if isinstance(sizes, CustomEntry):
        return OwnClassifier(None, sizes.factory, sizes.arguments, weights)
    return restored(
        {"mlp": Mlp, "vit": Vit}[sizes.kind],
        weights,
        inputs=inputs,
        classes=len(header.classes or header.values),
        **sizes.model_dump(exclude={"kind"}),
    )

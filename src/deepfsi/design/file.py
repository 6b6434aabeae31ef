"""A design and its file: what the file keeps of a design, and a design of a file."""

from collections.abc import Mapping
from importlib.metadata import version
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor, nn

from deepfsi.adaptive.exposure import training_of
from deepfsi.base.errors import InputError
from deepfsi.camera.detectors import DetectorMap
from deepfsi.designfile.design_file import (
    STATISTICS,
    AdaptiveHeader,
    CustomEntry,
    DesignFile,
    DesignHeader,
    MaskHeader,
    damaged_design,
)
from deepfsi.exposure.kind import Clicks, TrainedMasks
from deepfsi.jobs.exposures import AdaptiveMasks
from deepfsi.networks.classifiers import Classifier, Values, find_network
from deepfsi.networks.custom import OwnClassifier
from deepfsi.physics.detection import Detection, Rails
from deepfsi.physics.laws import light_law

if TYPE_CHECKING:
    from deepfsi.design.design import Design

WORDS = ("name", "classes", "info")
"""Fields of a design that its header holds as they are."""


def file_of(design: "Design") -> DesignFile:
    """File of a design, or `InputError` if its classifier cannot be described."""
    entry = design.exposure.entry()
    words = {name: getattr(design, name) for name in WORDS}
    words |= {"deepfsi": version("deepfsi"), "image_shape": design.image_shape}
    arrays = design.exposure.arrays
    header: DesignHeader
    if isinstance(entry, AdaptiveMasks):
        header = AdaptiveHeader(settings=entry, **words)
    else:
        classifier = design.classifier
        if not isinstance(classifier, Classifier):
            raise InputError(
                f"a design with a {type(classifier).__name__} classifier cannot be saved: "
                "give it as deepfsi.OwnClassifier(module)"
            )
        optics = design.mask_exposure.optics
        header = MaskHeader(
            exposure=entry,
            classifier=classifier.header,  # type: ignore[arg-type]
            light=optics.light,
            readout=optics.detection.readout,
            summed_reflectance=optics.summed_reflectance,
            values=design.values.names if design.values else (),
            **words,
        )
        arrays = arrays | _network_arrays(design)
    if design.training_scenes is not None:
        arrays = arrays | design.training_scenes.arrays
    return DesignFile(header, arrays)


def _network_arrays(design: "Design") -> dict[str, np.ndarray]:
    """Arrays of the classifier, of values, and of what was fitted to counts and logits."""
    classifier = design.classifier
    own = isinstance(classifier, OwnClassifier)
    networks: dict[str, Mapping[str, Tensor]] = {
        "classifier": classifier.weights if own else classifier.state_dict(),  # type: ignore[union-attr,dict-item]
        "exposure": design.mask_exposure.weights,
        "values": design.values.tensors if design.values else {},
    }
    arrays = {
        f"{network}.{name}": _as_array(tensor)
        for network, state in networks.items()
        for name, tensor in state.items()
    }
    fitted = {
        "distribution": design.distribution,
        "scenes": design.scene_model,
        "temperatures": design.temperatures,
    }
    for owner, part in fitted.items():
        if part is not None:
            arrays |= {f"{owner}.{name}": array for name, array in part.arrays.items()}
    return arrays


def _as_array(tensor: Tensor) -> np.ndarray:
    """A tensor as NumPy, or `InputError` where NumPy has no such numbers."""
    try:
        return tensor.detach().cpu().contiguous().numpy()
    except TypeError:
        raise InputError(
            f"weights of type {tensor.dtype} cannot be saved: give a classifier of float32"
        ) from None


def fields_of(file: DesignFile) -> dict[str, Any]:
    """Fields of `Design` of a file, or `InputError` as for `Design.load`."""
    header = file.header
    if isinstance(header, AdaptiveHeader):
        kind = training_of(header.settings.price is not None).kind
    try:
        if isinstance(header, AdaptiveHeader):
            fields: dict[str, Any] = {"exposure": kind.restored(header, file.arrays)}
        else:
            fields = _mask_fields(file, header)
        return fields | {
            **{name: getattr(header, name) for name in WORDS},
            "training_scenes": file.training_scenes,
        }
    except (KeyError, TypeError, ValueError, RuntimeError, IndexError) as error:
        raise damaged_design(file.path or "this", file.text or "") from error


def _mask_fields(file: DesignFile, header: MaskHeader) -> dict[str, Any]:
    """Fields of a design of masks, or an error where header and arrays do not fit together."""
    rails = Rails.of(torch.from_numpy(file.rails))
    detection = Detection(header.readout)
    if file.arrays.get("detectors") is not None:
        detectors = DetectorMap.of(file.arrays["detectors"], header.image_shape)
        detection = Detection.by(detectors, header.readout)
    light_law(header.light).check(rails.stacked)
    optics = TrainedMasks(
        rails=rails,
        light=header.light,
        image_shape=header.image_shape,
        detection=detection,
        summed_reflectance=header.summed_reflectance,
        clicks=Clicks.of(header.info),
        **{name: torch.from_numpy(file.arrays[name]) for name in STATISTICS},
    )
    kind = resolve_name(header.exposure.restored_by)
    exposure = kind.restored(header.exposure, _tensors(file, "exposure"), optics)
    return {
        "exposure": exposure,
        "classifier": _classifier(file, header, exposure.input_count(file.feature_count)),
        "distribution": file.distribution,
        "scene_model": file.scene_model,
        "temperatures": file.temperatures,
        "values": (
            Values.restored(header.values, _tensors(file, "values")) if header.values else None
        ),
    }


def _tensors(file: DesignFile, owner: str) -> dict[str, Tensor]:
    """Tensors of what a design has, such as its `classifier`, by their names there."""
    return {name: torch.from_numpy(array) for name, array in file.arrays_of(owner).items()}


def _classifier(file: DesignFile, header: MaskHeader, inputs: int) -> nn.Module:
    """Classifier of a file, of so many inputs; one of its maker's own without its code."""
    sizes = header.classifier
    weights = _tensors(file, "classifier")
    if isinstance(sizes, CustomEntry):
        return OwnClassifier(None, sizes.factory, sizes.arguments, weights)
    classes = len(header.classes or header.values)
    further = sizes.model_dump(exclude={"kind"})
    with torch.device("meta"):  # what the sizes ask for is compared before it takes memory
        network = find_network(sizes.kind)(inputs=inputs, classes=classes, **further)
    network.load_state_dict(weights, assign=True)
    return network.eval()

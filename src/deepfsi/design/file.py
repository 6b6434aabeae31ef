"""From a design to its file, and back."""

from importlib.metadata import version
from math import prod
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from deepfsi.adaptive.exposure import AdaptiveExposure, training_of
from deepfsi.base.errors import InputError
from deepfsi.design.networks import Classifier, OwnClassifier, find_network
from deepfsi.designfile.design_file import (
    STATISTICS,
    AdaptiveHeader,
    CustomEntry,
    DesignFile,
    DesignHeader,
    MaskHeader,
    Temperatures,
    damaged_design,
)
from deepfsi.designfile.misfit import UsualMisfit
from deepfsi.designfile.provenance import TrainingScenes, trained_camera
from deepfsi.designfile.view_test import SceneModel
from deepfsi.exposure.kind import Clicks
from deepfsi.exposure.training_set import Values
from deepfsi.physics.detection import Detection, Rails
from deepfsi.physics.laws import light_law

# `design` imports this module
if TYPE_CHECKING:
    from deepfsi.design.design import Design


def file_of(design: "Design") -> DesignFile:
    """File of a design, or `InputError` if its classifier cannot be described."""
    exposure = design.exposure
    words: dict[str, Any] = {
        "name": design.name,
        "classes": design.classes,
        "info": design.info,
        "image_shape": design.image_shape,
        "deepfsi": version("deepfsi"),
    }
    arrays = exposure.arrays
    header: DesignHeader
    if isinstance(exposure, AdaptiveExposure):
        header = AdaptiveHeader(settings=exposure.settings, **words)
    else:
        classifier = design.classifier
        if not isinstance(classifier, Classifier):
            raise InputError(
                f"a design with a {type(classifier).__name__} classifier cannot be saved: "
                "give it as deepfsi.OwnClassifier(module)"
            )
        masks = design.mask_exposure
        header = MaskHeader(
            exposure=masks.entry,  # type: ignore[arg-type]
            classifier=classifier.header,  # type: ignore[arg-type]
            light=masks.light,
            readout=masks.detection.readout,
            summed_reflectance=masks.summed_reflectance,
            values=design.values.names if design.values else (),
            **words,
        )
        tensors = {"classifier": classifier.weights, "exposure": masks.weights}
        if design.values:
            tensors["values"] = {"mean": design.values.mean, "std": design.values.std}
        arrays |= {
            f"{owner}.{name}": tensor.detach().cpu().contiguous().numpy()
            for owner, state in tensors.items()
            for name, tensor in state.items()
        }
        models = {
            "misfit": design.usual_misfit,
            "scenes": design.scene_model,
            "temperatures": design.temperatures,
        }
        for owner, model in models.items():
            if model is not None:  # its fields are arrays
                arrays |= {f"{owner}.{name}": array for name, array in vars(model).items()}
    if design.training_scenes is not None:
        arrays |= design.training_scenes.arrays
    return DesignFile(header, arrays)


def fields_of(file: DesignFile) -> dict[str, Any]:
    """Fields of `Design` of a file; `InputError` for what `Design.load` refuses."""
    header = file.header
    if isinstance(header, AdaptiveHeader):
        kind = training_of(header.settings.price is not None).kind
    try:
        if isinstance(header, AdaptiveHeader):
            fields: dict[str, Any] = {"exposure": kind.restored(header, file.arrays)}
        else:
            fields = _mask_fields(file, header)
        return fields | {
            "name": header.name,
            "classes": header.classes,
            "info": header.info,
            "training_scenes": TrainingScenes.restored(file.arrays),
        }
    except (KeyError, TypeError, ValueError, RuntimeError, IndexError) as error:
        raise damaged_design(file.path or "this") from error


def _mask_fields(file: DesignFile, header: MaskHeader) -> dict[str, Any]:
    """Fields of a design of masks, or an error where header and arrays do not fit together."""
    rails = Rails.of(torch.from_numpy(file.rails))
    detection = Detection(header.readout)
    if file.detectors is not None:
        detection = Detection.by(file.detectors, header.readout)
    light_law(header.light).check(rails.stacked)
    statistics = {name: torch.from_numpy(file.arrays[name]) for name in STATISTICS}
    features = rails.masks * detection.width(rails.count)
    alike = {tensor.shape for tensor in statistics.values()} == {(features,)}
    if not alike or not bool((statistics["std"] > 0).all()):
        raise ValueError("statistics are not those of the masks")
    camera = trained_camera(header.info)
    exposure = resolve_name(header.exposure.restored_by)(
        entry=header.exposure,
        rails=rails,
        light=header.light,
        image_shape=header.image_shape,
        detection=detection,
        summed_reflectance=header.summed_reflectance,
        clicks=camera and Clicks.of(camera, header.info["job"]["photons"]),
        weights=_tensors(file, "exposure"),
        **statistics,
    )
    fields = {
        "exposure": exposure,
        "classifier": _classifier(file, header, exposure.input_count),
    }
    if header.values:
        fields["values"] = Values.restored(header.values, _tensors(file, "values"))
    if arrays := file.arrays_of("misfit"):
        fields["usual_misfit"] = UsualMisfit.restored(arrays, 1)
    if arrays := file.arrays_of("scenes"):
        sizes = prod(header.image_shape), len(header.classes) or 1
        fields["scene_model"] = SceneModel.restored(arrays, *sizes)
    if arrays := file.arrays_of("temperatures"):
        fields["temperatures"] = Temperatures.restored(arrays, 1)
    return fields


def _tensors(file: DesignFile, owner: str) -> dict[str, Tensor]:
    """Tensors of the design's parts, such as its `classifier`, by their names there."""
    return {name: torch.from_numpy(array) for name, array in file.arrays_of(owner).items()}


def _classifier(file: DesignFile, header: MaskHeader, inputs: int) -> nn.Module:
    """Classifier of a file; a user's module comes without its code."""
    sizes = header.classifier
    weights = _tensors(file, "classifier")
    if isinstance(sizes, CustomEntry):
        return OwnClassifier(None, sizes.factory, sizes.arguments, weights)
    classes = len(header.classes or header.values)
    further = sizes.model_dump(exclude={"kind"})
    with torch.device("meta"):  # takes no memory before the sizes of the file's tensors are checked
        network = find_network(sizes.kind)(inputs=inputs, classes=classes, **further)
    # tensors of "meta" have no memory: the file's take their place
    network.load_state_dict(weights, assign=True)
    return network.eval()

"""Header of a design file: all of a design but its arrays, as JSON.

There are two kinds, by when the masks are known: before an exposure (`MaskHeader`), or only while
the camera looks (`AdaptiveHeader`). Nothing of a field's name, order or default may change.
"""

import math
from importlib.metadata import version
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, SerializeAsAny, model_validator

from deepfsi.base.models.strict import Count, StrictModel, of_kinds
from deepfsi.base.plugins import IMPORT_PATH
from deepfsi.camera.names import LightLawName, Readout, SummedReflectance
from deepfsi.jobs.designs import check_design
from deepfsi.jobs.exposures import AdaptiveMasks, ExposureEntry
from deepfsi.jobs.training import Widths, find_classifier

DESIGN_SCHEMA: Literal[1] = 1
"""Number of the design file's schema."""


def _check_info(info: dict[str, Any]) -> dict[str, Any]:
    if any(not isinstance(info.get(part, {}), dict) for part in ("job", "data", "detector_light")):
        raise ValueError("the provenance is no table")
    budget = info.get("job", {}).get("photons", 1.0)
    if type(budget) not in (int, float) or not 0 < budget < math.inf:
        raise ValueError("the training has no budget")
    return info


DesignInfo = Annotated[dict[str, Any], AfterValidator(_check_info)]
"""Provenance of a design: job and data of its training, and what was measured of it."""


class MlpEntry(StrictModel, strict=True):
    """Entry of the header for an `Mlp`: its parameters of the same names."""

    kind: Literal["mlp"]
    hidden: Widths  # widths of the hidden layers
    dropout: float = Field(ge=0, lt=1)  # share of hidden units left out in a step of training
    parts: ClassVar = 1


class CustomEntry(StrictModel, strict=True):
    """Entry of the header for an `OwnClassifier`: its parameters of the same names.

    Attributes
    ----------
    factory : str
        module:name of the function or class that makes the module; empty of one given as an object.
    arguments : dict
        Its keyword arguments.
    """

    kind: Literal["own"]
    factory: str = Field(pattern=f"^({IMPORT_PATH})?$")
    arguments: dict[str, Any]
    parts: ClassVar = 1


class MaskHeader(StrictModel, strict=True, populate_by_name=True):
    """Header of a design whose masks are known before an exposure.

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
        `DESIGN_SCHEMA`; "schema" in the file.
    deepfsi : str
        Version of the package that wrote it.
    readout : str
        What is read of two rails, of `detection.Detection`.
    exposure, classifier
        Kind and sizes: what rebuilds them, with the tensors.
    """

    schema_number: Literal[1] = Field(DESIGN_SCHEMA, alias="schema")
    deepfsi: str = version("deepfsi")
    name: Annotated[str, AfterValidator(check_design)]
    light: LightLawName
    readout: Readout
    summed_reflectance: SummedReflectance
    image_shape: tuple[Count, ...]
    classes: tuple[str, ...]
    values: tuple[str, ...] = ()
    exposure: ExposureEntry
    classifier: Annotated[
        SerializeAsAny[Annotated[MlpEntry | CustomEntry, Field(discriminator="kind")]],
        of_kinds((MlpEntry, CustomEntry), lambda kind: find_classifier(str(kind)).entry),
    ]
    info: DesignInfo

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if find_classifier(self.classifier.kind).features != self.exposure.features:
            raise ValueError("classifier and masks have features of different kinds")
        if bool(self.classes) == bool(self.values):
            raise ValueError("a design answers either classes or values")
        return self

    @property
    def mask_shape(self) -> tuple[int, ...]:
        """Shape of a mask."""
        return self.exposure.mask_shape(self.image_shape)


class AdaptiveHeader(StrictModel, populate_by_name=True):
    """Header of a design that makes each mask while the camera looks."""

    schema_number: Literal[1] = Field(DESIGN_SCHEMA, alias="schema")
    deepfsi: str = version("deepfsi")
    name: Literal["adaptive"] = "adaptive"
    settings: AdaptiveMasks  # looks, and the share of the exposure that each takes
    image_shape: tuple[Count, ...]
    classes: tuple[str, ...]
    info: DesignInfo


DesignHeader = MaskHeader | AdaptiveHeader
"""Header of a design file."""

"""The design file: a JSON header and arrays in one safetensors file that holds no code.

A camera's computer, a page and a report read it without torch. There are two kinds, by when the
masks are known: before an exposure (`MaskHeader`), or only while the camera looks
(`AdaptiveHeader`). Nothing of a field's name, order or default may change.
"""

import json
import math
import os
from collections.abc import Container, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, SerializeAsAny, model_validator
from safetensors.numpy import save

from deepfsi.base.arrays import read_tensors
from deepfsi.base.errors import InputError
from deepfsi.base.models import Count, StrictModel, of_kinds
from deepfsi.base.registry import IMPORT_PATH
from deepfsi.camera.detectors import DetectorMap
from deepfsi.camera.light import TOO_DIM
from deepfsi.camera.names import LightLawName, Readout, SummedReflectance
from deepfsi.datasets.alike import thumbnail_places
from deepfsi.jobs.designs import DESIGNS, check_design
from deepfsi.jobs.exposures import AdaptiveMasks, ExposureEntry
from deepfsi.jobs.training import Widths, find_classifier

DESIGN_SCHEMA: Literal[1] = 1
"""Number of the design file's schema."""


def _check_info(info: dict[str, Any]) -> dict[str, Any]:
    tables = all(type(info.get(part, {})) is dict for part in ("job", "data", "detector_light"))
    budget: Any = info.get("job", {}).get("photons", 1.0) if tables else None
    if type(budget) not in (int, float) or not 0 < budget < math.inf:
        raise ValueError("the provenance is no table, or the training has no budget")
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
    """Entry of the header for an `OwnClassifier`: its parameters of the same names."""

    kind: Literal["own"]
    # module:name of the function or class that makes the module; empty of one given as an object
    factory: str = Field(pattern=f"^({IMPORT_PATH})?$")
    arguments: dict[str, Any]  # its keyword arguments
    parts: ClassVar = 1


class MaskHeader(StrictModel, strict=True, populate_by_name=True):
    """Header of a design whose masks are known before an exposure."""

    # Number of the schema; "schema" in the file
    schema_number: Literal[1] = Field(DESIGN_SCHEMA, alias="schema")
    deepfsi: str = version("deepfsi")  # version of the package that wrote it
    name: Annotated[str, AfterValidator(check_design)]  # which design, such as deepfsi
    light: LightLawName  # light law that the rails obey
    readout: Readout  # what is read of two rails
    # s, the training scenes' mean summed reflectance: λ = Φ x / s
    summed_reflectance: SummedReflectance
    image_shape: tuple[Count, ...]  # rows and columns of a scene, or values of a spectrum
    # Names, in the order of the classifier's outputs; none of a design that estimates values
    classes: tuple[str, ...]
    values: tuple[str, ...] = ()  # names of these, likewise
    exposure: ExposureEntry  # kind and sizes: what rebuilds it, with the tensors
    # Kind and sizes, likewise
    classifier: Annotated[
        SerializeAsAny[Annotated[MlpEntry | CustomEntry, Field(discriminator="kind")]],
        of_kinds((MlpEntry, CustomEntry), lambda kind: find_classifier(str(kind)).entry),
    ]
    # Provenance: settings of the training, data and their hash, versions, device, seconds
    info: DesignInfo

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        alike = find_classifier(self.classifier.kind).features == self.exposure.features
        if not alike or bool(self.classes) == bool(self.values):
            raise ValueError("classifier and masks do not fit, or answers are of both kinds")
        return self

    def fits(self, arrays: Mapping[str, np.ndarray], whole: bool) -> bool:
        """Whether arrays are of the masks of this header."""
        if not _are_sound(arrays, self.image_shape, own=self.classifier.kind == "own"):
            return False
        if not (whole or "rails" in arrays):
            return True
        rails, _, pixels = arrays["rails"].shape
        mask_pixels = math.prod(self.exposure.mask_shape(self.image_shape))
        scene_pixels = math.prod(self.image_shape)
        fit = pixels == mask_pixels and scene_pixels == pixels * self.classifier.parts
        return fit and rails in (1, 2)


class AdaptiveHeader(StrictModel, populate_by_name=True):
    """Header of a design that makes each mask while the camera looks."""

    schema_number: Literal[1] = Field(DESIGN_SCHEMA, alias="schema")
    deepfsi: str = version("deepfsi")
    name: Literal["adaptive"] = "adaptive"
    settings: AdaptiveMasks  # looks, and the share of the exposure that each takes
    image_shape: tuple[Count, ...]
    classes: tuple[str, ...]
    info: DesignInfo

    def fits(self, arrays: Mapping[str, np.ndarray], whole: bool) -> bool:
        """Whether arrays are of a prior of scenes, and of the looks of this header."""
        if not (whole and _are_sound(arrays, self.image_shape)):
            return not whole
        scenes, components = arrays["levels"].shape
        pixels = math.prod(self.image_shape)
        looks = self.settings.looks
        kinds: dict[str, tuple[tuple[int, ...], type]] = {
            "mean": ((pixels,), np.float32),
            "components": ((components, pixels), np.float32),
            "steps": ((components,), np.float32),
            "levels": ((scenes, components), np.int8),
            "members": ((scenes,), np.int32),
            "sizes": ((len(self.classes),), np.int64),
            "numbers": ((2,), np.float64),
            "shares": ((looks,), np.float32),
        }
        stored = len(arrays.get("dictionary", ()))
        if "dictionary" in arrays:
            kinds["dictionary"] = ((stored, -(-pixels // 8)), np.uint8)
        fit = all(
            arrays[name].shape == shape and arrays[name].dtype == kind
            for name, (shape, kind) in kinds.items()
        )
        # Each scene or centre stands for one or more, and belongs to one class
        sizes = arrays["sizes"]
        light, spread = arrays["numbers"]
        populated = arrays["members"].min() > 0 and sizes.min() >= 0 and sizes.sum() == scenes
        lit = light > 0 and math.isclose(light, arrays["mean"].sum(dtype=float), rel_tol=1e-3)
        timed = len(arrays.get("temperature_logs", arrays["shares"])) == looks
        asked = self.settings.dictionary or 0
        # a small data set may have fewer different masks than were asked for
        ready = min(asked, 1) <= stored <= asked
        return bool(fit and populated and lit and timed and ready and 0 <= spread <= 1e2)


def _are_sound(arrays: Mapping[str, np.ndarray], shape: tuple[int, ...], own: bool = False) -> bool:
    """Whether arrays are finite and of their types; a user's own classifier has any."""
    for name, array in arrays.items():
        if own and name.startswith("classifier."):
            continue
        computed = name in ("rails", *STATISTICS) or name.startswith(("classifier.", "exposure."))
        if (computed and array.dtype != np.float32) or not np.isfinite(array).all():
            return False
    hashes = arrays.get("training_scenes", np.zeros(0, np.int32))
    rising = bool((hashes[1:] > hashes[:-1]).all())
    fit = hashes.dtype == np.int32 and hashes.ndim == 1 and rising
    if (small := arrays.get("training_thumbnails")) is not None:
        places = (len(hashes), *map(len, thumbnail_places(shape)))
        fit &= small.dtype == np.uint8 and small.shape == places and small.ndim == 3
        fit &= arrays["training_limit"].shape == (1,)
    return fit


DesignHeader = MaskHeader | AdaptiveHeader
"""Header of a design file."""

CALIBRATION_REACH = 100.0
"""Highest budget of a calibration over the highest of the training; lowest over lowest inverse."""

LOG_BOUNDS = (-3.0, 15.0)
"""Least and largest log τ."""


def calibration_budgets(low: float, high: float) -> np.ndarray:
    """Budgets that calibrate a design, two a decade."""
    low = low / CALIBRATION_REACH
    high = high * CALIBRATION_REACH
    return np.geomspace(low, high, 1 + int(np.ceil(2 * np.log10(high / low) - 1e-9)))


@dataclass(frozen=True)
class Temperatures:
    """Temperatures of a design over budgets and stops."""

    logs: np.ndarray  # (K, B), log τ after each number of looks, rising, at each budget
    budgets: np.ndarray  # (B,), of whole exposures, rising in equal ratios

    @classmethod
    def restored(cls, arrays: Mapping[str, np.ndarray], stops: int) -> "Temperatures":
        """Temperatures from a design file, or `ValueError` if they have other stops."""
        logs, budgets = (arrays[name].astype(float) for name in ("logs", "budgets"))
        fit = logs.shape == (stops, len(budgets)) and len(budgets) >= 2 and budgets.min() > 0
        ratios = np.diff(np.log(budgets))
        rising = fit and ratios.min() > 0 and np.allclose(ratios, ratios[0], rtol=1e-3)
        if not rising or np.abs(logs - logs.clip(*LOG_BOUNDS)).max() > 1e-6:
            raise ValueError("temperatures are not of this design")
        return cls(logs, budgets)

    @property
    def dimmest(self) -> float:
        """Lowest budget at which a design answers: a tenth of the training's lowest."""
        return float(self.budgets[0]) * CALIBRATION_REACH / TOO_DIM

    def scaled(self, factor: float) -> "Temperatures":
        """Temperatures of a device that needs `factor` times the budget for the same counts."""
        return Temperatures(self.logs, self.budgets * factor)


STATISTICS = ("mean", "std", "shares")
"""Arrays of one number a feature."""

MASKS_ARE_MADE = (
    "makes its masks while the camera looks, and this takes masks that are known before: `deepfsi "
    "evaluate`, `page`, `dmd export` and `camera live` take it"
)
"""Why a design of adaptive masks is refused."""

DAMAGED = (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError)
"""Errors that arrays raise if they do not fit their header."""


@dataclass(frozen=True, eq=False)
class DesignFile:
    """A design as its file holds it.

    Sizes: m masks of N cells, on 2 rails or 1.
    """

    header: DesignHeader
    arrays: Mapping[str, np.ndarray]  # by their names in the file
    path: Path | None = None  # where it was read
    text: str | None = None  # the header as it was read, JSON

    @classmethod
    def read(cls, path: str | os.PathLike[str], arrays: Container[str] | None = None) -> Self:
        """Read a design file, or a part of one."""
        text = ""
        try:
            text, tensors = read_tensors(path, "deepfsi", "give a design file", arrays)
            facts = json.loads(text)
            if int(facts["schema"]) != DESIGN_SCHEMA:
                raise ValueError(facts["schema"])
            code = DESIGNS.get(str(facts.get("name")))
            kind = AdaptiveHeader if code is not None and code.adaptive else MaskHeader
            header = kind.model_validate_json(text)
            if not header.fits(tensors, whole=arrays is None):
                raise ValueError("arrays are not those of the header")
        # JSON that is nested deeply overflows the stack
        except (RecursionError, *DAMAGED) as error:
            if isinstance(error, InputError) and not text:
                raise  # it is no file, or larger than any
            raise damaged_design(path) from error
        return cls(header, tensors, Path(path), text)

    def to_bytes(self) -> bytes:
        """Content of the file; for a file that was read, the same bytes."""
        text = self.text
        if text is None:
            text = json.dumps(self.header.model_dump(mode="json", by_alias=True))
        arrays = {name: np.asarray(array, order="C") for name, array in self.arrays.items()}
        return save(arrays, metadata={"deepfsi": text})

    def arrays_of(self, owner: str) -> dict[str, np.ndarray]:
        """Arrays of the design's parts, such as its `classifier`, by their names there."""
        start = f"{owner}."
        items = self.arrays.items()
        return {name.removeprefix(start): array for name, array in items if name.startswith(start)}

    @property
    def mask_header(self) -> MaskHeader:
        """The header of a design whose masks are known before it is shown, or `InputError`."""
        if isinstance(self.header, MaskHeader):
            return self.header
        raise InputError(f"{self.path or 'this design'} {MASKS_ARE_MADE}")

    @property
    def rails(self) -> np.ndarray:
        """Rails of the masks (2 or 1, m, N), the positive ones first."""
        return self.arrays["rails"]

    @property
    def masks(self) -> int:
        """m, number of masks."""
        return self.arrays["rails"].shape[1]

    @cached_property
    def detectors(self) -> DetectorMap | None:
        """Detectors of the pixels; None where one sees all."""
        labels = self.arrays.get("detectors")
        return None if labels is None else DetectorMap.of(labels, self.header.image_shape)


def damaged_design(path: str | os.PathLike[str]) -> InputError:
    """Error for a file that is no whole design, or one of another version."""
    return InputError(
        f"{path} is not a whole deepfsi design file, or is of another version: give a .safetensors "
        "file that `deepfsi design` or Design.save wrote, or make it again"
    )


SHIPPED_DESIGNS = Path(str(files(__package__) / "shipped"))
"""Folder of the published designs."""


def find_design(name: str | os.PathLike[str]) -> Path:
    """Path of a design file, or of a published design if no file has this name."""
    path = Path(name)
    shipped = SHIPPED_DESIGNS / f"{path.name}.safetensors"
    if path.exists():
        return path
    # a published name has no folder
    if os.fspath(name) == path.name and shipped.exists():
        return shipped
    raise InputError(
        f"no design file at {path}: give one, or dmd-mnist or adaptive-mnist, or make one with "
        "`deepfsi design`"
    )

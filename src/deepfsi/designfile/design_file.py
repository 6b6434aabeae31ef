"""The design file: a JSON header and arrays in one safetensors file that holds no code.

A camera's computer, a page and a report read it without torch.
"""

import json
import math
import os
from collections.abc import Container, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
from safetensors.numpy import save

from deepfsi.base.errors import InputError, other_version
from deepfsi.base.numeric.arrays import DamagedError, read_tensors
from deepfsi.camera.camera import Camera
from deepfsi.camera.detectors import DetectorMap
from deepfsi.designfile.distribution import ReadoutDistribution
from deepfsi.designfile.header import DESIGN_SCHEMA, AdaptiveHeader, DesignHeader, MaskHeader
from deepfsi.designfile.provenance import TrainingScenes, trained_camera
from deepfsi.designfile.temperatures import Temperatures
from deepfsi.designfile.view_test import SceneModel
from deepfsi.jobs.designs import DESIGNS

STATISTICS = ("mean", "std", "shares")
"""Arrays of one number a feature."""

REFLECTANCE_SLACK = 1e-3
"""What rounding may change of a reflectance, or of a sum of them, relative."""

MOST_REFLECTANCE = 1e3
"""Largest sum of all components of a prior."""

MOST_SPREAD = 1e2
"""Largest spread of a prior."""

HEADER_KEY = "deepfsi"
"""Key of the header in the file's metadata."""

DAMAGED = (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError)
"""What arrays raise that do not fit their header."""


@dataclass(frozen=True, eq=False)
class DesignFile:
    """A design as its file holds it.

    Sizes: m masks of N cells, on 2 rails or 1; D detectors; k features, which the network reads.
    """

    header: DesignHeader
    arrays: Mapping[str, np.ndarray]  # by their names in the file
    path: Path | None = None  # where it was read
    text: str | None = None  # the header as it was read, JSON

    @classmethod
    def read(cls, path: str | os.PathLike[str], arrays: Container[str] | None = None) -> Self:
        """Read a design file, or a part of one."""
        if not Path(path).exists():
            raise InputError(f"no design file at {path}: make one with `deepfsi design -o {path}`")
        text = ""
        try:
            text, tensors = read_tensors(path, HEADER_KEY, "give a design file", arrays)
            facts = json.loads(text)
            if int(facts["schema"]) != DESIGN_SCHEMA:
                raise ValueError(facts["schema"])
            code = DESIGNS.get(str(facts.get("name")))
            kind = AdaptiveHeader if code is not None and code.adaptive else MaskHeader
            file = cls(kind.model_validate_json(text), tensors, Path(path), text)
            file.check(whole=arrays is None)
        except (DamagedError, RecursionError, *DAMAGED) as error:
            if isinstance(error, InputError) and not text:
                raise  # it is no file, or larger than any
            raise damaged_design(path, text) from error
        return file

    def to_bytes(self) -> bytes:
        """Content of the file: of one that was read, its bytes."""
        text = self.text
        if text is None:
            text = json.dumps(self.header.model_dump(mode="json", by_alias=True))
        whole = {name: np.asarray(array, order="C") for name, array in self.arrays.items()}
        return save(whole, metadata={HEADER_KEY: text})

    def arrays_of(self, owner: str) -> dict[str, np.ndarray]:
        """Arrays of what a design has, such as its `classifier`, by their names there."""
        start = f"{owner}."
        every = self.arrays.items()
        return {name.removeprefix(start): array for name, array in every if name.startswith(start)}

    def check(self, whole: bool = True) -> None:
        """Raise an error of `DAMAGED` unless arrays are finite and, as a whole, fit the header."""
        custom = isinstance(self.header, MaskHeader) and self.header.classifier.kind == "own"
        networks = ("classifier.", "exposure.")
        for name, array in self.arrays.items():
            if custom and name.startswith("classifier."):
                continue  # whatever its maker's module keeps
            computed = name in ("rails", *STATISTICS) or name.startswith(networks)
            if computed and array.dtype != np.float32:
                raise ValueError(f"{name} holds numbers of another type")
            if not np.isfinite(array).all():
                raise ValueError(f"{name} is not finite")
        _ = self.training_scenes
        if isinstance(self.header, AdaptiveHeader):
            if whole:
                _check_prior(self.header, self.arrays)
            return
        if not whole and "rails" not in self.arrays:
            return
        rails, _, pixels = self.arrays["rails"].shape
        if rails not in (1, 2) or pixels != math.prod(self.header.mask_shape):
            raise ValueError("rails are not of the masks of these scenes")
        if not whole:
            return
        if {self.arrays[name].shape for name in STATISTICS} != {(self.feature_count,)}:
            raise ValueError("statistics are not those of the masks")
        if not (self.arrays["std"] > 0).all():
            raise ValueError("standard deviations are not above 0")
        if math.prod(self.header.image_shape) != pixels * self.header.classifier.parts:
            raise ValueError("images have other pixels than masks of all parts")
        _ = self.distribution, self.scene_model, self.temperatures

    # What it is

    @property
    def mask_header(self) -> MaskHeader:
        """The header of a design whose masks are known before it is shown, or `InputError`."""
        if isinstance(self.header, MaskHeader):
            return self.header
        raise InputError(
            f"{self.path or 'this design'} makes its masks while the camera looks, and this takes "
            "masks that are known before: `deepfsi evaluate`, `show`, `page`, `dmd export` "
            "and `camera live` take it"
        )

    @property
    def camera(self) -> Camera | None:
        """The camera that it was trained for; None of files of older versions."""
        return trained_camera(self.header.info)

    @property
    def photons(self) -> float | None:
        """Budget Φ of the training, counts of an exposure; None where that is not known."""
        return self.header.info.get("job", {}).get("photons")

    @cached_property
    def training_scenes(self) -> TrainingScenes | None:
        """Hashes of the scenes that it was made with; None of files of older versions."""
        return TrainingScenes.restored(self.arrays)

    # Of masks that are known before

    @property
    def rails(self) -> np.ndarray:
        """Rails of the masks (2 or 1, m, N), the positive ones first."""
        return self.arrays["rails"]

    @property
    def rail_count(self) -> int:
        """Number of rails: 2 of signed masks, or 1."""
        return len(self.arrays["rails"])

    @property
    def masks(self) -> int:
        """m, number of masks."""
        return self.arrays["rails"].shape[1]

    @cached_property
    def detectors(self) -> np.ndarray | None:
        """Detector (N,) of each pixel, 0 .. D-1; None where one sees all."""
        labels = self.arrays.get("detectors")
        return None if labels is None else DetectorMap.of(labels, self.header.image_shape).labels

    @property
    def detector_count(self) -> int:
        """D, number of detectors."""
        return 1 if self.detectors is None else int(self.detectors.max()) + 1

    @cached_property
    def feature_count(self) -> int:
        """k, numbers that the network reads of the counts."""
        width = self.rail_count if self.mask_header.readout == "both" else 1
        return self.masks * self.detector_count * width

    @cached_property
    def distribution(self) -> ReadoutDistribution | None:
        """Distribution of the readouts of training scenes; None where there were too few."""
        arrays = self.arrays_of("distribution")
        readouts = self.rail_count, self.masks * self.detector_count
        return ReadoutDistribution.restored(arrays, readouts) if arrays else None

    @cached_property
    def scene_model(self) -> SceneModel | None:
        """Model of the training scenes; None where there were too few."""
        arrays = self.arrays_of("scenes")
        pixels = math.prod(self.header.image_shape)
        classes = len(self.header.classes) or 1
        return SceneModel.restored(arrays, pixels, classes) if arrays else None

    @cached_property
    def temperatures(self) -> Temperatures | None:
        """Divisors of the logits at each budget; None where none were fitted."""
        arrays = self.arrays_of("temperatures")
        return Temperatures.restored(arrays, 1) if arrays else None


def damaged_design(path: str | os.PathLike[str], header: str = "") -> InputError:
    """Error for a file that is no whole design, or one of another version."""
    if words := other_version(header, DESIGN_SCHEMA, "make it again with `deepfsi design`"):
        return InputError(f"{path} {words}")
    return InputError(
        f"{path} is not a whole deepfsi design file: give a .safetensors file that "
        "`deepfsi design` or Design.save wrote"
    )


def _check_prior(header: AdaptiveHeader, arrays: Mapping[str, np.ndarray]) -> None:
    """Raise `ValueError` unless arrays are of a prior of scenes, and of the header's looks."""
    scenes, components = arrays["levels"].shape
    pixels = math.prod(header.image_shape)
    looks = header.settings.looks
    shapes = {
        "mean": ((pixels,), np.float32),
        "components": ((components, pixels), np.float32),
        "steps": ((components,), np.float32),
        "levels": ((scenes, components), np.int8),
        "members": ((scenes,), np.int32),
        "sizes": ((len(header.classes),), np.int64),
        "numbers": ((2,), np.float64),
        "shares": ((looks,), np.float32),
    }
    for name, (shape, kind) in shapes.items():
        if arrays[name].shape != shape or arrays[name].dtype != kind:
            raise ValueError(f"{name} is not of this design")
    if (header.settings.dictionary is None) != ("dictionary" not in arrays):
        raise ValueError("the header and the arrays do not agree on a dictionary")
    if header.settings.dictionary is not None:
        bits = arrays["dictionary"]
        fits = bits.ndim == 2 and bits.shape[1] == -(-pixels // 8) and bits.dtype == np.uint8
        if not (fits and 1 <= len(bits) <= header.settings.dictionary):
            raise ValueError("dictionary is not of this design")
    if len(arrays.get("temperature_logs", arrays["shares"])) != looks:
        raise ValueError("temperatures are of other looks")
    if not isinstance(header.info.get("job", {}).get("camera"), dict):
        raise ValueError("no camera is known")
    mean = arrays["mean"]
    farthest = 127 * arrays["steps"] @ np.abs(arrays["components"])
    brightest = 1 + REFLECTANCE_SLACK
    if mean.min() < 0 or mean.max() > brightest or farthest.max() > MOST_REFLECTANCE:
        raise ValueError("the prior holds no reflectances")
    sizes = arrays["sizes"]
    light, spread = arrays["numbers"]
    lit = math.isclose(light, mean.sum(dtype=float), rel_tol=REFLECTANCE_SLACK)
    populated = arrays["members"].min() > 0 and sizes.min() >= 0 and sizes.sum() == scenes
    if not (lit and populated and 0 <= spread <= MOST_SPREAD):
        raise ValueError("the scenes of the prior are none")

"""The design file: a JSON header and arrays in one safetensors file that holds no code.

A camera's computer, a page and a report read it without torch, and it answers counts by itself
where its classifier is the package's own network, an `Mlp`: in 32-bit numbers, as torch does.
"""

import json
import math
import os
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import TypeAdapter
from safetensors.numpy import save

from deepfsi.base.errors import InputError, as_input_error, other_version
from deepfsi.base.numeric.arrays import DamagedError, read_tensors
from deepfsi.camera.camera import Camera
from deepfsi.camera.detectors import DetectorMap
from deepfsi.camera.light import share_out
from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.camera.stop_rule import StopRule
from deepfsi.designfile.distribution import ReadoutDistribution
from deepfsi.designfile.header import DESIGN_SCHEMA, AdaptiveHeader, DesignHeader, MaskHeader
from deepfsi.designfile.provenance import TrainingScenes, click_gates, trained_camera
from deepfsi.designfile.temperatures import Temperatures
from deepfsi.designfile.view_test import SceneModel
from deepfsi.jobs.designs import DESIGNS
from deepfsi.jobs.exposures import LARGEST_SCORE, ConditionedEntry, LooksEntry

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

Layer = tuple[np.ndarray, np.ndarray]
"""Weights (inputs, outputs) and biases (outputs,) of a linear layer, float32."""

DAMAGED = (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError)
"""What arrays raise that do not fit their header."""


@dataclass(frozen=True, eq=False)
class DesignFile:
    """A design as its file holds it.

    Sizes: m masks of N cells, on 2 rails or 1; D detectors; k features, which the networks read; q
    dwells of a look; K looks; C classes.
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
            "masks that are known before: `deepfsi evaluate`, `stop`, `show`, `page`, `dmd "
            "export` and `camera live` take it"
        )

    @property
    def camera(self) -> Camera | None:
        """The camera that it was trained for; None of files of older versions."""
        return trained_camera(self.header.info)

    @property
    def photons(self) -> float | None:
        """Budget Φ of the training, counts of an exposure; None where that is not known."""
        return self.header.info.get("job", {}).get("photons")

    @property
    def stop_rule(self) -> StopRule | None:
        """When an exposure stops; None where no rule was chosen."""
        with as_input_error("the design's stopping rule", "make it again with `deepfsi stop`"):
            return TypeAdapter(StopRule | None).validate_python(self.header.info.get("stopping"))

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
        """k, numbers that the networks read of the counts."""
        width = self.rail_count if self.mask_header.readout == "both" else 1
        return self.masks * self.detector_count * width

    @property
    def each_rail(self) -> bool:
        """True if the two rails of a mask are frames of their own: not on two arms."""
        return self.rail_count == 2 and LIGHT_LAWS[self.mask_header.light].arms == 1

    @cached_property
    def frames(self) -> int:
        """q, number of dwells of a look; those of a mask's two rails follow one another."""
        return self.masks * (2 if self.each_rail else 1)

    @cached_property
    def looks(self) -> LooksEntry:
        """Entry of several looks, or `InputError` where the exposure has one."""
        entry = self.mask_header.exposure
        if not isinstance(entry, LooksEntry):
            raise InputError(
                "this design has one look: learn one of several {looks}", setting="looks"
            )
        return entry

    @cached_property
    def distribution(self) -> ReadoutDistribution | None:
        """Distribution of the readouts of training scenes; None where there were too few.

        Where dwells are chosen, of all rails in one row, and of all mirrors ON.
        """
        arrays = self.arrays_of("distribution")
        if not arrays:
            return None
        entry = self.mask_header.exposure
        readouts = self.masks * self.detector_count
        if isinstance(entry, LooksEntry):
            row = (1, self.rail_count * readouts + 1)
            return ReadoutDistribution.restored(arrays, row, entry.looks)
        return ReadoutDistribution.restored(arrays, (self.rail_count, readouts), looks=0)

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
        stops = self.mask_header.exposure.count_stops(self.masks)
        return Temperatures.restored(arrays, stops) if arrays else None

    # What its networks answer

    @cached_property
    def classifier(self) -> tuple[Layer, ...]:
        """Layers of the classifier, or `InputError` where that is not the package's own `Mlp`."""
        header = self.mask_header
        entry = header.exposure
        if header.classifier.kind != "mlp":
            raise InputError(
                "a loop with a classifier of your own is not possible: learn the design with the "
                "package's own, an Mlp"
            )
        if click_gates(header.info) is not None:
            raise InputError("this design reads clicks, which `Design.classify` answers")
        inputs = self.feature_count
        if isinstance(entry, LooksEntry):
            inputs += self.frames
        elif isinstance(entry, ConditionedEntry):
            inputs = entry.masks * entry.width + 2
        return self._layers("classifier", inputs, len(header.classes or header.values))

    @cached_property
    def chooser(self) -> tuple[Layer, ...]:
        """Layers of the network that chooses dwells, or `InputError` where there is none."""
        _ = self.looks
        return self._layers("exposure", self.feature_count + self.frames + 1, self.frames)

    def _layers(self, network: str, inputs: int, outputs: int) -> tuple[Layer, ...]:
        """Layers of a network, or `InputError` where they do not follow each other.

        Weights are copied to (inputs, outputs): products with a transposed view have other bits.
        """
        arrays = self.arrays_of(network)
        layers: list[Layer] = []
        width = inputs
        while (weight := arrays.get(f"layers.{len(layers)}.weight")) is not None:
            bias = arrays.get(f"layers.{len(layers)}.bias")
            if bias is None or weight.ndim != 2 or weight.shape != (*bias.shape, width):
                break
            layers.append((np.ascontiguousarray(weight.T), bias))
            width = len(bias)
        if 2 * len(layers) != len(arrays) or not layers or width != outputs:
            raise InputError("the design's networks do not fit its masks: give a whole design file")
        return tuple(layers)

    def features(self, counts: np.ndarray) -> np.ndarray:
        """Features (k,) of counts (rails, m, D)."""
        if self.rail_count == 1:
            return counts[0].ravel()
        if self.mask_header.readout == "difference":
            return (counts[0] - counts[1]).ravel()
        return counts.swapaxes(0, 1).ravel()

    def inputs(self, features: np.ndarray, dwell: np.ndarray | None = None) -> np.ndarray:
        """Standardised features (k,), and relative dwells (q,) where they are chosen, float32."""
        mean = self.arrays["mean"]
        std = self.arrays["std"]
        if dwell is None:
            count = len(features)
            return (features.astype(np.float32) - mean[:count]) / std[:count]
        relative = dwell.astype(np.float32) * np.float32(self.frames)
        by_feature = np.repeat(relative, len(mean) // len(relative))
        scaled = (features.astype(np.float32) - by_feature * mean) / std
        return np.concatenate([scaled, relative / np.float32(3)])

    def next_dwell(self, inputs: np.ndarray, look: int, shortest: float = 0.0) -> np.ndarray:
        """Dwells (q,) of a look, from inputs (k + q,): shares of the exposure, 1 / K together."""
        looks = self.looks
        weight, bias = self.chooser[0]
        left = np.float32(1 - look / looks.looks)  # the last input
        first = weight[:-1], bias + left * weight[-1]
        scores = _outputs((first, *self.chooser[1:]), inputs).astype(float)
        bounded = LARGEST_SCORE * np.tanh(scores / LARGEST_SCORE)
        return share_out(_softmax(bounded) / looks.looks, max(shortest, looks.shortest))

    @cached_property
    def first_dwell(self) -> np.ndarray:
        """Dwells (q,) of the first look, which are the same for every scene."""
        with np.errstate(all="ignore"):  # of weights near the largest number
            inputs = self.inputs(np.zeros(self.feature_count), np.zeros(self.frames))
            dwell = self.next_dwell(inputs, 0)
        if not np.isfinite(dwell).all():
            raise InputError("the design's networks do not fit its masks: give a whole design file")
        return dwell

    def chances(self, inputs: np.ndarray, photons: float) -> np.ndarray:
        """Calibrated probabilities (C,) of the classes, float64, from inputs (k,) or (k + q,)."""
        entry = self.mask_header.exposure
        conditioned = inputs
        if isinstance(entry, ConditionedEntry):
            conditioned = _conditioned(entry, inputs, photons)
        logits = _outputs(self.classifier, conditioned).astype(float)
        if self.temperatures is None:
            return _softmax(logits)
        return _softmax(logits / self.temperatures.after(self._stop(inputs), photons))

    def _stop(self, inputs: np.ndarray) -> float:
        """Number of the stop, from 1, that an exposure has come to; between stops a fraction."""
        entry = self.mask_header.exposure
        if isinstance(entry, LooksEntry):  # by the time that the dwells of the inputs took
            frames = self.frames
            return 3 * float(inputs[-frames:].sum()) / frames * entry.looks
        if isinstance(entry, ConditionedEntry):
            return entry.count_stops(len(inputs) // entry.width)
        return 1.0


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


def _conditioned(entry: ConditionedEntry, inputs: np.ndarray, photons: float) -> np.ndarray:
    """Inputs of a classifier that knows the budget and the number of masks, float32."""
    ratio = np.float32(photons) / np.float32(entry.used * entry.photons)
    middle = math.log(entry.span) / 2
    level = (np.log(ratio) - np.float32(middle)) / np.float32(max(middle, 1.0))
    share = np.float32(len(inputs) // entry.width) / np.float32(entry.masks)
    dark = np.zeros(entry.masks * entry.width - len(inputs), np.float32)  # of masks not shown
    return np.concatenate([inputs, dark, [level, share]], dtype=np.float32)


def _outputs(layers: Sequence[Layer], inputs: np.ndarray) -> Any:
    """Outputs of a network with rectified hidden layers."""
    hidden = inputs
    for weight, bias in layers[:-1]:
        hidden = np.maximum(hidden @ weight + bias, np.float32(0))
    weight, bias = layers[-1]
    return hidden @ weight + bias


def _softmax(scores: np.ndarray) -> np.ndarray:
    """Probabilities of scores, float64."""
    powers = np.exp(scores - scores.max())
    return powers / powers.sum()

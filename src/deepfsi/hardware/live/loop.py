"""Loop of a design of several looks: its networks in NumPy, so that a camera needs no torch.

The networks are those of the design, in 32-bit numbers, and are written beside the patterns as
`loop.safetensors`. After each look both are given what was counted so far: the features over the
budget and the share of the exposure that each frame had.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field
from safetensors.numpy import save

from deepfsi.base.arrays import DamagedError, read_tensors
from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.models import StrictModel
from deepfsi.camera.light import share_out
from deepfsi.camera.names import Readout
from deepfsi.camera.stop_rule import StopRule
from deepfsi.design.consistency import ReadoutDistribution
from deepfsi.design.view_test import SceneModel
from deepfsi.hardware.patterns.looks import Looks

TEMPERATURES = ("temperatures.logs", "temperatures.budgets")
"""Tensors of the calibration, float64."""

Layer = tuple[np.ndarray, np.ndarray]
"""Weights (inputs, outputs) and biases (outputs,) of a linear layer, float32."""


class LoopHeader(StrictModel):
    """Header of a loop's file: all but the numbers of its networks."""

    schema_version: Literal[2] = 2
    looks: int = Field(ge=2, le=64)  # K, each 1 / K of the exposure
    masks: int = Field(ge=1)  # m, 2 or 1, and D
    rails: Literal[1, 2]
    detectors: int = Field(ge=1)
    each_rail: bool  # whether the two rails of a mask are frames with dwells of their own
    readout: Readout  # what is read of two rails
    classes: tuple[str, ...] = Field(min_length=1)
    largest_score: float = Field(gt=0)  # bound of the scores whose softmax dwells are
    # Shortest dwell that the design was learned for, a share of the exposure
    shortest: float = Field(ge=0, lt=1)
    rule: StopRule | None = None  # of the design, where it has one
    # Budget that the design was trained at, counts of an exposure; none where that is not known
    photons: float | None = Field(None, gt=0, allow_inf_nan=False)

    @property
    def frames(self) -> int:
        """q, number of dwells; those of a mask's two rails follow one another."""
        return self.masks * (2 if self.each_rail else 1)

    @property
    def features(self) -> int:
        """k, numbers that the networks read of the counts."""
        read = self.rails if self.readout == "both" else 1
        return self.masks * self.detectors * read


@dataclass(frozen=True)
class Loop:
    """Two networks: one says the class, the other the dwells of the next look."""

    header: LoopHeader
    mean: np.ndarray  # (k,): float32, of the features for equal dwells
    std: np.ndarray  # (k,)
    classifier: tuple[Layer, ...]
    chooser: tuple[Layer, ...]
    # Log τ after each look at each budget (K, B), and these budgets, as `design.confidence` has
    # them; None where the design has none
    temperatures: tuple[np.ndarray, np.ndarray] | None = None
    # Of the readouts of training scenes, and of all mirrors ON; none where there were too few
    distribution: ReadoutDistribution | None = None
    scene_model: SceneModel | None = None  # of the training; none where there were too few

    def features(self, counts: np.ndarray) -> np.ndarray:
        """Features (k,) of counts (rails, m, D)."""
        if self.header.rails == 1:
            return counts[0].ravel()
        if self.header.readout == "difference":
            return (counts[0] - counts[1]).ravel()
        return counts.swapaxes(0, 1).ravel()

    def inputs(self, features: np.ndarray, dwell: np.ndarray) -> np.ndarray:
        """Inputs (k + q,) of the classifier, of features over the budget (k,) and dwells (q,)."""
        relative = dwell.astype(np.float32) * np.float32(self.header.frames)
        each = np.repeat(relative, len(self.mean) // len(relative))
        scaled = (features.astype(np.float32) - each * self.mean) / self.std
        return np.concatenate([scaled, relative / np.float32(3)])

    def classify(self, inputs: np.ndarray, photons: float) -> np.ndarray:
        """Calibrated probabilities (C,) of the classes, float64, for a budget."""
        logits = _outputs(self.classifier, inputs).astype(float)
        return _softmax(logits / self._temperature(inputs, photons))

    def _temperature(self, inputs: np.ndarray, photons: float) -> float:
        """Divisor of the logits, after the time that the dwells of the inputs took."""
        if self.temperatures is None:
            return 1.0
        logs, budgets = self.temperatures
        looks = 3 * float(inputs[-self.header.frames :].sum()) / self.header.frames * len(logs)
        each = [np.interp(np.log(photons), np.log(budgets), row) for row in logs]
        log = np.interp(looks, np.arange(1, len(logs) + 1), each)
        return float(np.exp(log) * max(budgets[0] / photons, 1.0))

    def choose(self, inputs: np.ndarray, look: int, shortest: float = 0.0) -> np.ndarray:
        """Dwells (q,) of a look: shares of the exposure, float64, of 1 / K together."""
        # inputs (k + q,)
        header, (weight, bias) = self.header, self.chooser[0]
        left = np.float32(1 - look / header.looks)  # the last input
        first = weight[:-1], bias + left * weight[-1]
        scores = _outputs((first, *self.chooser[1:]), inputs).astype(float)
        bounded = header.largest_score * np.tanh(scores / header.largest_score)
        return share_out(_softmax(bounded) / header.looks, max(shortest, header.shortest))

    @property
    def first(self) -> np.ndarray:
        """Dwells (q,) of the first look, which are the same for every scene."""
        header = self.header
        return self.choose(self.inputs(np.zeros(header.features), np.zeros(header.frames)), 0)

    @property
    def looks(self) -> Looks:
        """Looks as a manifest of patterns has them."""
        return Looks(
            count=self.header.looks,
            each_rail=self.header.each_rail,
            first=tuple(self.first.tolist()),
            shortest=self.header.shortest,
            loop_sha256=sha256(self.to_bytes()).hexdigest(),
        )

    def to_bytes(self) -> bytes:
        """Content of the file."""
        tensors = {"mean": self.mean, "std": self.std}
        for name, layers in (("classifier", self.classifier), ("chooser", self.chooser)):
            for place, (weight, bias) in enumerate(layers):
                tensors |= {f"{name}.{place}.weight": weight, f"{name}.{place}.bias": bias}
        if self.distribution is not None:
            held = self.distribution.arrays.items()
            tensors |= {f"distribution.{name}": each for name, each in held}
        whole = {name: np.asarray(held, np.float32, order="C") for name, held in tensors.items()}
        if self.scene_model is not None:
            whole |= {f"scenes.{name}": each for name, each in self.scene_model.arrays.items()}
        if self.temperatures is not None:
            whole |= dict(zip(TEMPERATURES, self.temperatures, strict=True))
        return save(whole, metadata={"deepfsi-loop": self.header.model_dump_json()})


def read_loop(path: Path) -> Loop:
    """Loop of a file, or `InputError` if it is missing, damaged or none."""
    again = "export the patterns again"
    try:
        text, tensors = read_tensors(path, "deepfsi-loop", again)
    except DamagedError:
        raise InputError(f"{path} is not a whole loop of a design: {again}") from None
    with as_input_error(str(path), again, text, schema=2):
        header = LoopHeader.model_validate_json(text)
    try:
        return loop_from(header, tensors)
    except (KeyError, ValueError, IndexError):
        raise InputError(f"{path} has networks that do not fit its masks: {again}") from None


def loop_from(header: LoopHeader, tensors: Mapping[str, np.ndarray]) -> Loop:
    """Loop of tensors as its file names them, or an error where they do not fit its header."""
    inputs = header.features + header.frames
    known, kept = (
        {name.removeprefix(part): held for name, held in tensors.items() if name.startswith(part)}
        for part in ("distribution.", "scenes.")
    )
    readouts = 1, header.rails * header.masks * header.detectors + 1
    loop = Loop(
        header,
        _checked(tensors["mean"], header.features),
        _checked(tensors["std"], header.features),
        _layers(tensors, "classifier", inputs, len(header.classes)),
        _layers(tensors, "chooser", inputs + 1, header.frames),
        _temperatures(tensors, header.looks) if TEMPERATURES[0] in tensors else None,
        ReadoutDistribution.restored(known, readouts, header.looks) if known else None,
        SceneModel.restored(kept, kept["rest"].size, len(header.classes)) if kept else None,
    )
    with np.errstate(all="ignore"):  # of weights near the largest number
        _checked(loop.first.astype(np.float32), header.frames)
    return loop


def _checked(values: np.ndarray, *shape: int) -> np.ndarray:
    """Numbers of a shape, or `ValueError`."""
    if values.shape != shape or values.dtype != np.float32 or not np.isfinite(values).all():
        raise ValueError(shape)
    return values


def _temperatures(tensors: Mapping[str, np.ndarray], looks: int) -> tuple[np.ndarray, np.ndarray]:
    """Temperatures and their budgets, or an error where they are none of so many looks."""
    logs, budgets = (tensors[name] for name in TEMPERATURES)
    if logs.shape != (looks, len(budgets)) or not np.isfinite(logs).all():
        raise ValueError(TEMPERATURES)
    if not (np.isfinite(budgets).all() and budgets.min() > 0 and (np.diff(budgets) > 0).all()):
        raise ValueError(TEMPERATURES)
    return logs, budgets


def _layers(
    tensors: Mapping[str, np.ndarray], name: str, inputs: int, outputs: int
) -> tuple[Layer, ...]:
    """Layers of a network, or an error where they do not follow each other."""
    widths = [inputs]
    layers: list[Layer] = []
    while f"{name}.{len(layers)}.weight" in tensors:
        weight, bias = (tensors[f"{name}.{len(layers)}.{part}"] for part in ("weight", "bias"))
        width = weight.shape[1]
        layers.append((_checked(weight, widths[-1], width), _checked(bias, width)))
        widths.append(width)
    if len(layers) < 1 or widths[-1] != outputs:
        raise ValueError(name)
    return tuple(layers)


def _outputs(layers: Sequence[Layer], hidden: np.ndarray) -> Any:
    """Outputs of a network with rectified hidden layers."""
    for weight, bias in layers[:-1]:
        hidden = np.maximum(hidden @ weight + bias, np.float32(0))
    weight, bias = layers[-1]
    return hidden @ weight + bias


def _softmax(scores: np.ndarray) -> np.ndarray:
    """Probabilities of scores, float64."""
    powers = np.exp(scores - scores.max())
    return powers / powers.sum()

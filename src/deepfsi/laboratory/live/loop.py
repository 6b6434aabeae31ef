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
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from deepfsi.errors import InputError, as_input_error
from deepfsi.frozen import Frozen
from deepfsi.hardware.patterns.looks import Looks
from deepfsi.hardware.recording.live_settings import StopRule
from deepfsi.laws import Readout
from deepfsi.optics.dwells import share_out

SMALLEST = float(np.finfo(np.float32).tiny)
"""Probability below which none is told from 0."""

Layer = tuple[np.ndarray, np.ndarray]
"""Weights (inputs, outputs) and biases (outputs,) of a linear layer, float32."""


class LoopHeader(Frozen):
    """Header of a loop's file: all but the numbers of its networks."""

    schema_version: Literal[1] = 1
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

    def classify(self, inputs: np.ndarray) -> np.ndarray:
        """Probabilities (C,) of the classes, float64."""
        return _softmax(_outputs(self.classifier, inputs).astype(float))

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
        whole = {name: np.ascontiguousarray(held, np.float32) for name, held in tensors.items()}
        return save(whole, metadata={"deepfsi-loop": self.header.model_dump_json()})


def read_loop(path: Path) -> Loop:
    """Loop of a file, or `InputError` if it is missing, damaged or none."""
    again = "export the patterns again"
    try:
        with safe_open(path, framework="numpy") as file:
            text = (file.metadata() or {})["deepfsi-loop"]
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except FileNotFoundError:
        raise InputError(f"{path} is missing: {again}") from None
    except (SafetensorError, KeyError, OSError, ValueError):
        raise InputError(f"{path} is not a whole loop of a design: {again}") from None
    with as_input_error(str(path), again):
        header = LoopHeader.model_validate_json(text)
    inputs = header.features + header.frames
    try:
        loop = Loop(
            header,
            _checked(tensors["mean"], header.features),
            _checked(tensors["std"], header.features),
            _layers(tensors, "classifier", inputs, len(header.classes)),
            _layers(tensors, "chooser", inputs + 1, header.frames),
        )
    except (KeyError, ValueError, IndexError):
        raise InputError(f"{path} has networks that do not fit its masks: {again}") from None
    return loop


def _checked(values: np.ndarray, *shape: int) -> np.ndarray:
    """Numbers of a shape, or `ValueError`."""
    if values.shape != shape or values.dtype != np.float32 or not np.isfinite(values).all():
        raise ValueError(shape)
    return values


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


def judge(chances: np.ndarray, look: int, rule: StopRule | None) -> tuple[np.ndarray, bool]:
    """Probabilities (C,) as a rule calibrates them, and whether the exposure may stop."""
    # chances (C,)
    if rule is None:
        return chances, False
    if rule.temperatures:
        log = np.log(np.maximum(chances, SMALLEST))
        chances = _softmax(log / rule.temperatures[look])
    return chances, bool(chances.max() > rule.threshold)

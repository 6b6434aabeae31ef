"""The design file: tensors and a JSON header in one safetensors file that holds no code."""

import json
import os
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as to_bytes
from torch import Tensor

from deepfsi.design.adaptive import AdaptiveDwells
from deepfsi.design.classifiers import Mlp
from deepfsi.errors import InputError
from deepfsi.optics import constraints

if TYPE_CHECKING:
    from deepfsi.design.artifact import Design

SCHEMA = 3
"""Of the newest file that can be read; 2 has what a classifier is told, 3 has a schedule."""


def build_mlp(
    tensors: Mapping[str, np.ndarray],
    part: str,
    inputs: int,
    outputs: int,
    hidden: Sequence[int],
    dropout: float = 0.0,
) -> Mlp:
    """A network of a design file."""
    network = Mlp(inputs, outputs, hidden, dropout, torch.Generator())
    network.load_state_dict(weights_of(tensors, part))
    network.generator = None
    return network.eval()


def sound_schedule(schedule: AdaptiveDwells, design: "Design") -> bool:
    """Whether a schedule of a design file fits its design."""
    whole = type(schedule.looks) is int and 2 <= schedule.looks <= 64
    alone = design.light == "free-dwell" and design.told is None and len(design.rails) == 1
    return whole and alone and constraints.excess(design.rails, "equal-dwell") < constraints.SLACK


def pack(design: "Design", schema: int, classifier: dict[str, Any], **more: Any) -> bytes:
    """Content of a design file: tensors, and a header with what rebuilds the classifier."""
    tensors = {name: getattr(design, name) for name in ("rails", "mean", "std", "shares")}
    for key, value in design.classifier.state_dict().items():
        tensors[f"classifier.{key}"] = value
    if design.schedule is not None:
        for key, value in design.schedule.network.state_dict().items():
            tensors[f"schedule.{key}"] = value
    header = {
        "schema": schema,
        "deepfsi": version("deepfsi"),
        "name": design.name,
        "light": design.light,
        "summed_reflectance": design.summed_reflectance,
        "image_shape": list(design.image_shape),
        "classes": list(design.classes),
        "classifier": classifier,
        "info": design.info,
        **more,
    }
    whole = {key: value.detach().cpu().contiguous() for key, value in tensors.items()}
    return to_bytes(whole, metadata={"deepfsi": json.dumps(header)})


def weights_of(tensors: Mapping[str, np.ndarray], part: str) -> dict[str, Tensor]:
    """State of a network among the tensors of a design file, those whose names begin so."""
    return {
        key.removeprefix(part): torch.from_numpy(value)
        for key, value in tensors.items()
        if key.startswith(part)
    }


def read_design(
    path: str | os.PathLike[str],
) -> tuple[dict[str, Any], Mapping[str, np.ndarray]]:
    """Header and numpy tensors of a design file, without building a network.

    Raises
    ------
    InputError
        As `Design.load`.
    """
    if not Path(path).is_file():
        raise InputError(f"no design file at {path}: make one with `deepfsi design -o {path}`")
    try:
        with safe_open(path, framework="numpy") as file:
            header = json.loads((file.metadata() or {})["deepfsi"])
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
        schema = int(header["schema"])
    except (SafetensorError, KeyError, TypeError, ValueError, OSError) as error:
        raise damaged(path) from error
    if schema > SCHEMA:
        raise InputError(
            f"{path} has schema {schema}, and this version reads up to {SCHEMA}: upgrade deepfsi"
        )
    return header, tensors


def kind_of(header: Mapping[str, Any]) -> Any:
    """Kind of the classifier that a header tells of, "mlp" or "vit"; None where it tells none."""
    classifier = header.get("classifier")
    return classifier.get("kind") if isinstance(classifier, dict) else None


def damaged(path: str | os.PathLike[str]) -> InputError:
    """Say that a file is no whole design."""
    return InputError(
        f"{path} is not a whole deepfsi design file: give a .safetensors file that "
        "`deepfsi design` or Design.save wrote"
    )

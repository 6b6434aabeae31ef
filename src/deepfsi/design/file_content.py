"""The bytes of a design file: its header, and its tensors in NumPy, as a camera has no torch."""

import json
import math
import os
from collections.abc import Container
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator

from deepfsi.base.arrays import DamagedError, read_tensors
from deepfsi.base.errors import InputError, other_version
from deepfsi.jobs.designs import DESIGNS

if TYPE_CHECKING:
    from deepfsi.design.values import Values

SCHEMA: Literal[1] = 1
"""Number of the design file's schema."""


def _check_info(info: dict[str, Any]) -> dict[str, Any]:
    if any(not isinstance(info.get(part, {}), dict) for part in ("job", "data", "detector_light")):
        raise ValueError("the provenance is no table")
    budget = info.get("job", {}).get("photons", 1.0)
    if type(budget) not in (int, float) or not 0 < budget < math.inf:
        raise ValueError("the training has no budget")
    return info


Info = Annotated[dict[str, Any], AfterValidator(_check_info)]
"""Provenance of a design: job and data of its training, and what was measured of it."""


def read_content(
    path: str | os.PathLike[str], wanted: Container[str] | None = None
) -> tuple[str, dict[str, np.ndarray]]:
    """Header, as JSON, and tensors, all or those wanted; `InputError` as for `Design.load`."""
    if not Path(path).exists():
        raise InputError(f"no design file at {path}: make one with `deepfsi design -o {path}`")
    text = ""
    try:
        text, tensors = read_tensors(path, "deepfsi", "give a design file", wanted)
        schema = int(json.loads(text)["schema"])
    except (DamagedError, KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise error if isinstance(error, InputError) else damaged(path, text) from error
    if schema != SCHEMA:
        raise damaged(path, text)
    return text, tensors


def is_adaptive(header: str) -> bool:
    """True of the header of a design that makes its masks while the camera looks."""
    code = DESIGNS.get(str(json.loads(header).get("name")))
    return code is not None and code.adaptive


def read_known_masks(path: str | os.PathLike[str]) -> tuple[str, dict[str, np.ndarray]]:
    """Header and tensors of a design whose masks are known before it is shown."""
    text, tensors = read_content(path)
    if is_adaptive(text):
        raise InputError(
            f"{path} makes its masks while the camera looks, and this takes masks that are known "
            "before: `deepfsi evaluate`, `stop`, `show`, `page`, `dmd export` and `camera live` "
            "take it"
        )
    return text, tensors


def check_classes(values: "Values | tuple[str, ...] | None", what: str) -> None:
    """Raise `InputError` where a design estimates values and `what` is of classes."""
    if values:
        names = values if isinstance(values, tuple) else values.names
        raise InputError(
            f"{what} is of classes, and this design estimates {', '.join(names)}: use "
            "Design.estimate, or `deepfsi evaluate`"
        )


def damaged(path: str | os.PathLike[str], header: str = "") -> InputError:
    """Error for a file that is no design of this version, by its header as far as it was read."""
    if words := other_version(header, SCHEMA, "make it again with `deepfsi design`"):
        return InputError(f"{path} {words}")
    return InputError(
        f"{path} is not a whole deepfsi design file: give a .safetensors file that "
        "`deepfsi design` or Design.save wrote"
    )

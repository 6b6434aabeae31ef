"""The bytes of a design file: its header, and its tensors in NumPy, as a camera has no torch."""

import json
import os
from pathlib import Path
from typing import Any, Literal

import numpy as np
from safetensors import SafetensorError, safe_open

from deepfsi.errors import InputError

SCHEMA: Literal[1] = 1
"""Number of the design file's schema."""


def read_content(path: str | os.PathLike[str]) -> tuple[str, dict[str, np.ndarray]]:
    """Header, as JSON, and tensors of a design file, or `InputError` as for `Design.load`."""
    if not Path(path).is_file():
        raise InputError(f"no design file at {path}: make one with `deepfsi design -o {path}`")
    try:
        with safe_open(path, framework="numpy") as file:
            text = (file.metadata() or {})["deepfsi"]
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
        header: dict[str, Any] = json.loads(text)
        schema = int(header["schema"])
    except (SafetensorError, KeyError, TypeError, ValueError, OSError, RecursionError) as error:
        raise damaged(path) from error
    if schema > SCHEMA:
        raise InputError(
            f"{path} has schema {schema}, and this version reads {SCHEMA}: upgrade deepfsi"
        )
    return text, tensors


def damaged(path: str | os.PathLike[str]) -> InputError:
    """Error for a file that is no design."""
    return InputError(
        f"{path} is not a whole deepfsi design file: give a .safetensors file that "
        "`deepfsi design` or Design.save wrote"
    )

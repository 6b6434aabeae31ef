"""The bytes of a design file: its header, and its tensors in NumPy, as a camera has no torch."""

import json
import os
from pathlib import Path
from typing import Literal

import numpy as np

from deepfsi.errors import InputError
from deepfsi.tables.tensor_files import DamagedError, read_tensors

SCHEMA: Literal[1] = 1
"""Number of the design file's schema."""


def read_content(path: str | os.PathLike[str]) -> tuple[str, dict[str, np.ndarray]]:
    """Header, as JSON, and tensors of a design file, or `InputError` as for `Design.load`."""
    if not Path(path).exists():
        raise InputError(f"no design file at {path}: make one with `deepfsi design -o {path}`")
    try:
        text, tensors = read_tensors(path, "deepfsi", "give a design file")
        schema = int(json.loads(text)["schema"])
    except (DamagedError, KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise error if isinstance(error, InputError) else damaged(path) from error
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

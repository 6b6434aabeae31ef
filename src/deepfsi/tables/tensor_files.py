"""Tensors and a text in a safetensors file, without torch."""

import os
from collections.abc import Container
from pathlib import Path

import numpy as np
from safetensors import safe_open

from deepfsi.files import open_regular

LARGEST = 2**33
"""Bytes of a file of tensors at most."""


class DamagedError(Exception):
    """A file holds no tensors with the text that is asked for; its reader says what to do."""


def read_tensors(
    path: str | os.PathLike[str], key: str, advice: str, wanted: Container[str] | None = None
) -> tuple[str, dict[str, np.ndarray]]:
    """Text of a key in a file's header and its tensors, all or those wanted."""
    with open_regular(path, LARGEST, advice):
        try:
            with safe_open(Path(path), framework="numpy") as file:
                text = (file.metadata() or {})[key]
                names = [name for name in file.keys() if wanted is None or name in wanted]  # noqa: SIM118
                return text, {name: file.get_tensor(name) for name in names}
        except Exception as error:  # it raises almost anything on a damaged file
            raise DamagedError(path) from error

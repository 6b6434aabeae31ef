"""Arrays of real numbers in ``.npy`` files, and in ``.mat`` files up to version 7."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from deepfsi.errors import InputError

NUMBERS = (
    *("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"),
    *("single", "double", "logical"),
)
"""Names in ``.mat`` files of the types that hold numbers."""


def read_npy(path: Path) -> npt.NDArray[Any]:
    """Array of a ``.npy`` file, or `InputError` if it holds something else than real numbers."""
    try:
        # mapped, so that no more is read than the file holds
        values: npt.NDArray[Any] = np.lib.format.open_memmap(path, mode="r")
        if values.dtype.kind not in "biuf":
            raise ValueError(f"it holds {values.dtype}")
    except (OSError, ValueError, EOFError) as error:
        raise InputError(
            f"cannot read an array of real numbers from {path} ({error}); write it with numpy.save"
        ) from error
    return np.array(values)


def list_variables(path: Path, dimensions: Sequence[int]) -> dict[str, tuple[int, ...]]:
    """Shapes of the numeric variables in a ``.mat`` file that have so many dimensions, by name.

    Raises `InputError` if the file is damaged or of version 7.3.
    """
    from scipy.io import whosmat

    with _as_input_error(path):
        return {
            name: shape
            for name, shape, kind in whosmat(path)
            if kind in NUMBERS and len(shape) in dimensions
        }


def read_variable(path: Path, name: str, shape: tuple[int, ...], largest: int) -> npt.NDArray[Any]:
    """Variable of a ``.mat`` file.

    Parameters
    ----------
    path : Path
    name : str
        One of those that `list_variables` gives.
    shape : tuple of int
        Its shape according to `list_variables`.
    largest : int
        Values at most: a small file may claim more than memory holds.

    Raises
    ------
    InputError
        If it is larger, damaged or complex.
    """
    from scipy.io import loadmat

    if np.prod(shape, dtype=float) > largest:
        raise InputError(f"{path}: {name} has the shape {shape}: give {largest} values or fewer")
    with _as_input_error(path):
        values: npt.NDArray[Any] = loadmat(path, variable_names=[name])[name]
    if values.dtype.kind not in "biuf":
        raise InputError(f"{path}: {name} holds complex numbers: give real ones")
    return np.ascontiguousarray(values)


@contextmanager
def _as_input_error(path: Path) -> Iterator[None]:
    try:
        yield
    except NotImplementedError as error:
        raise InputError(f"{path} is of version 7.3; save it in MATLAB with '-v7'") from error
    except Exception as error:  # scipy raises almost anything on a damaged file
        raise InputError(f"cannot read {path} as a .mat file ({error}); save it again") from error

"""Arrays in ``.npy``, ``.npz`` and ``.mat`` files."""

import io
import os
import struct
import warnings
import zlib
from collections.abc import Container, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import psutil
from safetensors import safe_open

from deepfsi.base.errors import InputError
from deepfsi.base.files import UNPACKED_RATIO, check_unpacked, open_regular, read_regular

LARGEST_ARRAY_FILE = 2**36
"""Largest file of arrays, in bytes."""


def split_variable(source: str) -> tuple[Path, str]:
    """Path and variable of FILE or FILE:VARIABLE."""
    end = source.lower().rfind(".mat:") + len(".mat")
    if end < len(".mat") or Path(source).exists():
        return Path(source), ""
    return Path(source[:end]), source[end + 1 :]


def read_array(
    path: Path,
    dimensions: Sequence[int],
    variable: str = "",
    *,
    usual: str = "",
    advice: str = "",
) -> npt.NDArray[Any]:
    """Array of a ``.npy`` file, or a variable of a ``.mat`` file.

    Variables with a number of axes other than `dimensions` do not count. Without a name the only
    one is taken, or `usual`.
    """
    if path.suffix.lower() != ".mat":
        return read_npy(path)
    arrays = {name: array for name, array in _read_mat(path).items() if array.ndim in dimensions}
    if not variable:
        variable = next(iter(arrays)) if len(arrays) == 1 else usual
    if variable not in arrays:
        lacking = f"no variable {variable!r}" if variable else "not one variable alone"
        axes = " or ".join(map(str, dimensions))
        raise InputError(
            f"{path} has {lacking} of real numbers in {axes} dimensions, but "
            f"{', '.join(arrays) or 'none'}: {advice or f'name one as {path}:VARIABLE'}"
        )
    values = arrays[variable]
    check_memory(values.nbytes, f"the values of {path}: {variable}", "give fewer")
    return np.ascontiguousarray(_native(values))


def read_npz(
    path: Path, advice: str = "write plain arrays of numbers or strings with numpy.savez"
) -> dict[str, npt.NDArray[Any]]:
    """Arrays of a ``.npz`` file by their names, all of them in memory."""
    with open_regular(path, LARGEST_ARRAY_FILE, advice) as file:
        try:
            with np.load(file) as arrays:  # of a path numpy leaves a damaged file open
                size = sum(entry.file_size for entry in arrays.zip.infolist())
                check_unpacked(size, path.stat().st_size, str(path), advice)
                check_memory(size, f"the arrays of {path}", "give fewer or smaller ones")
                read = {name: _native(arrays[name]) for name in arrays.files}
            for array in read.values():
                if array.dtype.kind == "U" and array.nbytes:
                    array.tolist()  # fails at what are no characters
            return read
        except InputError:
            raise
        except Exception as error:  # zipfile and numpy raise almost anything on damaged files
            raise InputError(f"cannot read {path} ({error}); {advice}") from None


def read_npy(path: Path) -> npt.NDArray[Any]:
    """Array of a ``.npy`` file; `InputError` if it does not hold real numbers."""
    with open_regular(path, LARGEST_ARRAY_FILE, "give a .npy file"):
        try:
            # Mapped first: a header may claim more values than the file holds
            values: npt.NDArray[Any] = np.lib.format.open_memmap(path, mode="r")
            if values.dtype.kind not in "biuf":
                raise ValueError(f"it holds {values.dtype}")
        except Exception as error:  # numpy's parser raises almost anything on a damaged header
            raise InputError(
                f"cannot read an array of real numbers from {path} ({error}); write it with "
                "numpy.save"
            ) from error
    check_memory(values.nbytes, f"the values of {path}", "give fewer")
    return _native(np.array(values))


def _native(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Array in the byte order of this machine, which torch needs."""
    return values.astype(values.dtype.newbyteorder("="), copy=False)


def _read_mat(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Arrays of real numbers in a ``.mat`` file, by name."""
    from scipy.io import loadmat

    content = read_regular(path, LARGEST_ARRAY_FILE, "give a .mat file")
    try:
        _check_mat(content)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of strings and tables, which have no names
            variables = loadmat(io.BytesIO(content))
    except Exception as error:  # scipy raises almost anything on a damaged file
        raise InputError(
            f"cannot read {path} as a .mat file ({error}); save it again, with '-v7'"
        ) from error
    return {
        name: values
        for name, values in variables.items()
        if isinstance(values, np.ndarray) and values.dtype.kind in "biuf" and name[:2] != "__"
    }


def _check_mat(content: bytes) -> None:
    """Raise `ValueError` for a bomb, and for an element at whose type scipy ends the process."""
    # 128 bytes of header, then variables. They and their elements begin with type and length
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128], "")
    start = 128
    most = 2**27 + UNPACKED_RATIO * len(content)  # bytes
    while order and start + 8 <= len(content):
        kind, length = struct.unpack_from(f"{order}II", content, start)
        start += 8
        variable = content[start : start + length]
        if kind == 15:  # compressed, with another tag of 8 bytes
            variable = zlib.decompressobj().decompress(variable, most)[8:]
            most -= len(variable)
            if most <= 8:
                raise ValueError("it unpacks to far more than its size explains")
        _check_elements(variable, order)
        start += length


def _check_elements(variable: bytes, order: str) -> None:
    """Raise `ValueError` where a variable has elements of an unknown type."""
    start = 0
    while start + 8 <= len(variable):
        kind, length = struct.unpack_from(f"{order}II", variable, start)
        # 8, 10 and 11 are reserved; the upper half of a short element's tag is its length
        if (kind & 0xFFFF) not in {*range(1, 8), 9, *range(12, 19)}:
            raise ValueError(f"a part of type {kind}")
        start += 8
        if kind < 1 << 16:  # else the values are in the tag
            start += -(-length // 8) * 8  # padded to 8 bytes


LARGEST_TENSORS = 2**33
"""Largest file of tensors, in bytes."""


def read_tensors(
    path: str | os.PathLike[str], key: str, advice: str, wanted: Container[str] | None = None
) -> tuple[str, dict[str, np.ndarray]]:
    """Text of a key in a file's header, and its wanted tensors; `ValueError` if damaged."""
    with open_regular(path, LARGEST_TENSORS, advice):
        try:
            with safe_open(Path(path), framework="numpy") as file:
                text = (file.metadata() or {})[key]
                names = [name for name in file.keys() if wanted is None or name in wanted]  # noqa: SIM118
                return text, {name: file.get_tensor(name) for name in names}
        except Exception as error:  # safetensors raises almost anything on damaged files
            raise ValueError(f"{path} is damaged") from error


def free_memory() -> float:
    """Bytes that programs may still take on this machine without swapping."""
    return float(psutil.virtual_memory().available)


def check_memory(needed: float, what: str, advice: str, free: float | None = None) -> None:
    """Raise `InputError` if more bytes are needed than are free, by default on this machine."""
    free = free_memory() if free is None else free
    if needed > free:
        raise InputError(
            f"{what} need {needed / 1e9:.3g} GB of memory, and {free / 1e9:.3g} "
            f"GB are free: {advice}"
        )


def npy_header(kind: str, shape: tuple[int, ...]) -> bytes:
    """Header of an array's .npy file, as `numpy.save` writes it."""
    header = io.BytesIO()
    content = {"descr": kind, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(header, content)
    return header.getvalue()

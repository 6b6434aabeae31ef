"""Arrays in ``.npy``, ``.npz``, ``.mat`` and HDF5 files.

A ``.mat`` file of version 7.3 is an HDF5 file, in which MATLAB turns the order of axes around; it
is turned back here. Either needs h5py, an extra of the package.
"""

import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from deepfsi.errors import InputError
from deepfsi.memory import check_memory, free_memory

HDF5 = (".h5", ".hdf5")
"""Ends of the names of HDF5 files."""

VARIABLES = (".mat", *HDF5)
"""Ends of the names of files that may hold several arrays, each with a name."""

NUMBERS = (
    *("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"),
    *("single", "double", "logical"),
)
"""Names in ``.mat`` files of the types that hold numbers."""

MATLAB_HDF5 = b"MATLAB 7.3"
"""Beginning of a ``.mat`` file that is an HDF5 file."""


def split_variable(source: str) -> tuple[Path, str]:
    """Path and variable of FILE or FILE:VARIABLE."""
    for suffix in VARIABLES:
        name, found, variable = source.rpartition(f"{suffix}:")
        if found and not Path(source).exists():
            return Path(name + suffix), variable
    return Path(source), ""


def read_array(
    path: Path,
    dimensions: Sequence[int],
    variable: str = "",
    *,
    largest: int,
    usual: str = "",
    advice: str = "",
) -> npt.NDArray[Any]:
    """Array of a ``.npy`` file, or a variable of so many dimensions of a ``.mat`` or HDF5 file."""
    # Of several it is the one of the name `variable`, or else `usual`
    if path.suffix.lower() not in VARIABLES:
        return read_npy(path)
    found = list_variables(path, dimensions)
    if not variable:
        variable = next(iter(found)) if len(found) == 1 else usual
    if variable not in found:
        raise InputError(
            f"{path} has {f'no variable {variable!r}' if variable else 'not one variable alone'} "
            f"of real numbers in {' or '.join(map(str, dimensions))} dimensions, but "
            f"{', '.join(found) or 'none'}: {advice or f'name one as {path}:VARIABLE'}"
        )
    return read_variable(path, variable, found[variable], largest)


def read_npz(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Arrays of a ``.npz`` file by their names, all of them in memory."""
    if not zipfile.is_zipfile(path):
        raise InputError(f"{path} is no .npz file, or not all of one; write it with numpy.savez")
    try:
        with zipfile.ZipFile(path) as members:
            size = sum(member.file_size for member in members.infolist())
        check_memory(size, free_memory(), f"the arrays of {path}", "give fewer or smaller ones")
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except InputError:
        raise
    except (EOFError, MemoryError, OSError, ValueError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(
            f"cannot read {path} ({error}); "
            "write plain arrays of numbers or strings with numpy.savez"
        ) from error


def read_npy(path: Path) -> npt.NDArray[Any]:
    """Array of a ``.npy`` file, or `InputError` if it holds something else than real numbers."""
    try:
        # mapped, so that no more is read than the file holds
        values: npt.NDArray[Any] = np.lib.format.open_memmap(path, mode="r")
        if values.dtype.kind not in "biuf":
            raise ValueError(f"it holds {values.dtype}")
    except Exception as error:  # numpy's parser raises almost anything on a damaged header
        raise InputError(
            f"cannot read an array of real numbers from {path} ({error}); write it with numpy.save"
        ) from error
    return np.array(values)


def list_variables(path: Path, dimensions: Sequence[int]) -> dict[str, tuple[int, ...]]:
    """Shapes of the numeric variables in a file that have so many dimensions, by name."""
    # Of a ``.mat`` file, or of an HDF5 file, in which a name is a path such as ``run/counts``.
    # Raises `InputError` if the file is damaged, or an HDF5 file and h5py is not installed
    if _in_hdf5(path):
        with _open_hdf5(path) as found:
            shapes = {name: _matlab_shape(path, held.shape) for name, held in found.items()}
        return {name: shape for name, shape in shapes.items() if len(shape) in dimensions}
    from scipy.io import whosmat

    with _as_input_error(path):
        return {
            name: shape
            for name, shape, kind in whosmat(path)
            if kind in NUMBERS and len(shape) in dimensions
        }


def read_variable(path: Path, name: str, shape: tuple[int, ...], largest: int) -> npt.NDArray[Any]:
    """Variable of a ``.mat`` or HDF5 file."""
    from scipy.io import loadmat

    if np.prod(shape, dtype=float) > largest:
        raise InputError(f"{path}: {name} has the shape {shape}: give {largest} values or fewer")
    values: npt.NDArray[Any]
    if _in_hdf5(path):
        with _open_hdf5(path) as found:
            values = np.asarray(found[name])
        return np.ascontiguousarray(values if path.suffix.lower() != ".mat" else values.T)
    with _as_input_error(path):
        values = loadmat(path, variable_names=[name])[name]
    if values.dtype.kind not in "biuf":
        raise InputError(f"{path}: {name} holds complex numbers: give real ones")
    return np.ascontiguousarray(values)


def _in_hdf5(path: Path) -> bool:
    """True if a file's name says HDF5, or MATLAB's header in it says version 7.3."""
    if path.suffix.lower() != ".mat":
        return True
    try:
        with path.open("rb") as file:
            return file.read(len(MATLAB_HDF5)) == MATLAB_HDF5
    except OSError as error:
        raise InputError(f"cannot read {path} ({error.strerror})") from error


def _matlab_shape(path: Path, shape: tuple[int, ...]) -> tuple[int, ...]:
    """Shape of a variable as MATLAB has it."""
    return shape[::-1] if path.suffix.lower() == ".mat" else shape


@contextmanager
def _open_hdf5(path: Path) -> Iterator[dict[str, Any]]:
    """Data sets of real numbers in an HDF5 file, by name, but those of MATLAB's own use."""
    kind = "a .mat file of version 7.3" if path.suffix.lower() == ".mat" else "an HDF5 file"
    other = ", or save it in MATLAB with '-v7'" if path.suffix.lower() == ".mat" else ""
    try:
        import h5py
    except ImportError as error:
        raise InputError(
            f"{path} is {kind}, read by the package h5py: pip install h5py{other}"
        ) from error
    held: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        real = isinstance(item, h5py.Dataset) and item.dtype.kind in "biuf"
        matlab = item.attrs.get("MATLAB_class", b"double").decode()
        if real and matlab in NUMBERS and not name.startswith("#"):
            held[name] = item

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
            yield held
    except Exception as error:  # h5py raises almost anything on a damaged file
        raise InputError(f"cannot read {path} as {kind} ({error}); save it again{other}") from error


@contextmanager
def _as_input_error(path: Path) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # scipy raises almost anything on a damaged file
        raise InputError(f"cannot read {path} as a .mat file ({error}); save it again") from error

"""Arrays in ``.npy``, ``.npz``, ``.mat`` and HDF5 files.

A ``.mat`` file of version 7.3 is an HDF5 file, in which MATLAB turns the order of axes around; it
is turned back here. Either needs h5py, an extra of the package.
"""

import io
import os
import struct
import zipfile
import zlib
from collections.abc import Container, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt
import psutil
from safetensors import safe_open

from deepfsi.base.errors import InputError
from deepfsi.base.files import check_unpacked, content_of, open_regular

HDF5_ENDINGS = (".h5", ".hdf5")
"""Ends of the names of HDF5 files."""

VARIABLE_ENDINGS = (".mat", *HDF5_ENDINGS)
"""Ends of the names of files that may hold several arrays, each with a name."""

MATLAB_NUMBERS = (
    *("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"),
    *("single", "double", "logical"),
)
"""Names in ``.mat`` files of the types that hold numbers."""

LARGEST_ARRAY_FILE = 2**36
"""Bytes of a file of arrays at most."""

LARGEST_ZIP_ENTRY = 2**33
"""Bytes of an array in a ``.npz`` file at most."""

MATLAB_HDF5 = b"MATLAB 7.3"
"""Beginning of a ``.mat`` file that is an HDF5 file."""

MAT_HEADER = 128
"""Bytes of the header of a ``.mat`` file before 7.3."""

MAT_PLAIN = 14
"""Type of a variable in a ``.mat`` file."""

MAT_DEFLATED = 15
"""Type of a variable in a ``.mat`` file that is compressed."""

MAT_TAG = 8
"""Bytes of a tag in a ``.mat`` file, which holds type and length."""

MAT_PARTS = {*range(1, 8), 9, *range(12, 19)}
"""Types of the parts of a variable in a ``.mat`` file."""

MAT_OPAQUE = 17
"""Class of variables in a ``.mat`` file that are strings, tables and the like."""

DOUBLE = 8
"""Bytes of a number."""

INFLATED_AT_ONCE = 2**20
"""Bytes that are inflated at once to be counted."""

UNCOMPRESSED = "save it uncompressed, or as a .npy file"


def split_variable(source: str) -> tuple[Path, str]:
    """Path and variable of FILE or FILE:VARIABLE."""
    for suffix in VARIABLE_ENDINGS:
        end = source.lower().rfind(f"{suffix}:") + len(suffix)
        if end >= len(suffix) and not Path(source).exists():
            return Path(source[:end]), source[end + 1 :]
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
    """Array of a ``.npy`` file, or a variable of a ``.mat`` or HDF5 file."""
    if path.suffix.lower() not in VARIABLE_ENDINGS:
        return read_npy(path, largest)
    found = _list_variables(path, dimensions)
    if not variable:
        variable = next(iter(found)) if len(found) == 1 else usual
    if variable not in found:
        raise InputError(
            f"{path} has {f'no variable {variable!r}' if variable else 'not one variable alone'} "
            f"of real numbers in {' or '.join(map(str, dimensions))} dimensions, but "
            f"{', '.join(found) or 'none'}{_others(path)}: "
            f"{advice or f'name one as {path}:VARIABLE'}"
        )
    return _read_variable(path, variable, found[variable], largest)


def read_npz(
    path: Path, advice: str = "write plain arrays of numbers or strings with numpy.savez"
) -> dict[str, npt.NDArray[Any]]:
    """Arrays of a ``.npz`` file by their names, all of them in memory."""
    with open_zip(path, advice) as archive:
        entries = archive.infolist()
        size = sum(entry.file_size for entry in entries)
        check_memory(size, free_memory(), f"the arrays of {path}", "give fewer or smaller ones")
        arrays = {}
        for entry in entries:
            where = f"{path}/{entry.filename}"
            content = read_zip_entry(
                archive, entry, where=where, largest=LARGEST_ZIP_ENTRY, advice=advice
            )
            arrays[entry.filename.removesuffix(".npy")] = _of_npy(content, where, advice)
        return arrays


def _of_npy(content: bytes, where: str, advice: str) -> npt.NDArray[Any]:
    """Array of the content of a ``.npy`` file, whose header may say anything."""
    stream = io.BytesIO(content)
    form = np.lib.format
    try:
        readers = {(1, 0): form.read_array_header_1_0, (2, 0): form.read_array_header_2_0}
        shape, fortran, dtype = readers[form.read_magic(stream)](stream)
        if min(shape, default=0) < 0:
            raise ValueError(f"its shape is {shape}")
        if dtype.hasobject:
            raise ValueError("Object arrays may hold code")
        flat = np.frombuffer(content, dtype, offset=stream.tell())  # no more than there is
        if dtype.kind == "U":
            flat.tobytes().decode("utf-32-le" if dtype.newbyteorder("<") == dtype else "utf-32-be")
        return _native(flat.reshape(shape, order="F" if fortran else "C").copy())
    except Exception as error:  # numpy's parser raises almost anything on a damaged header
        raise InputError(f"cannot read {where} ({error}); {advice}") from None


def read_npy(path: Path, largest: int = 2**30) -> npt.NDArray[Any]:
    """Array of a ``.npy`` file, or `InputError` if it holds something else than real numbers."""
    with open_regular(path, LARGEST_ARRAY_FILE, "give a .npy file"):
        try:
            # mapped, so that no more is read than the file holds
            values: npt.NDArray[Any] = np.lib.format.open_memmap(path, mode="r")
            if values.dtype.kind not in "biuf":
                raise ValueError(f"it holds {values.dtype}")
        except Exception as error:  # numpy's parser raises almost anything on a damaged header
            kind = content_of(path)
            other = "" if "(.npy)" in kind else f"; it holds {kind}"
            raise InputError(
                f"cannot read an array of real numbers from {path} ({error}){other}; write "
                "it with numpy.save"
            ) from error
    check_size(str(path), values.shape, values.dtype.itemsize, largest)
    return _native(np.array(values))


def _native(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Array with the bytes of its values in this machine's order, which torch needs."""
    return values.astype(values.dtype.newbyteorder("="), copy=False)


def check_size(what: str, shape: Sequence[int], itemsize: int, largest: int) -> None:
    """Raise `InputError` for an array that is larger than its reader allows, or than the memory."""
    size = float(np.prod(shape, dtype=float))
    if size > largest:
        raise InputError(f"{what} has the shape {tuple(shape)}: give {largest} values or fewer")
    check_memory(itemsize * size, free_memory(), f"the values of {what}", "give fewer")


def _list_variables(path: Path, dimensions: Sequence[int]) -> dict[str, tuple[int, ...]]:
    """Shapes of the numeric variables in a file, by name."""
    if _in_hdf5(path):
        with _open_hdf5(path) as found:
            shapes = {name: _matlab_shape(path, held.shape) for name, held in found.items()}
        return {name: shape for name, shape in shapes.items() if len(shape) in dimensions}
    from scipy.io import whosmat

    with _open_mat(path) as file:
        return {
            name: shape
            for name, shape, kind in whosmat(file)
            if kind in MATLAB_NUMBERS and len(shape) in dimensions and not name.startswith("__")
        }


def _others(path: Path) -> str:
    """Variables of a ``.mat`` file before 7.3 that hold other than full real numbers, in words."""
    from scipy.io import whosmat

    if _in_hdf5(path):
        return ""
    with _open_mat(path) as file:
        listed = [(name, kind) for name, _, kind in whosmat(file) if name[:2] != "__"]
    named = [f"{name} ({kind})" for name, kind in listed if kind not in MATLAB_NUMBERS]
    full = ", of which full() makes numbers of a sparse one" if "(sparse)" in str(named) else ""
    return f" (and {', '.join(named)}{full})" if named else ""


def _read_variable(path: Path, name: str, shape: tuple[int, ...], largest: int) -> npt.NDArray[Any]:
    """Variable of a ``.mat`` or HDF5 file."""
    from scipy.io import loadmat

    check_size(f"{path}: {name}", shape, DOUBLE, largest)
    size = path.stat().st_size
    check_unpacked(np.prod(shape, dtype=float), size, f"{path}: {name}", UNCOMPRESSED)
    values: npt.NDArray[Any]
    if _in_hdf5(path):
        with _open_hdf5(path) as found:
            values = _native(np.asarray(found[name]))
        return np.ascontiguousarray(values if path.suffix.lower() != ".mat" else values.T)
    with _open_mat(path) as file:
        values = loadmat(file, variable_names=[name])[name]
    if values.dtype.kind not in "biuf":
        raise InputError(f"{path}: {name} holds complex numbers: give real ones")
    return np.ascontiguousarray(_native(values))


def _in_hdf5(path: Path) -> bool:
    """True if a file's name says HDF5, or MATLAB's header in it says version 7.3."""
    if path.suffix.lower() != ".mat":
        return True
    with open_regular(path, LARGEST_ARRAY_FILE, "give a .mat file") as file:
        return file.read(len(MATLAB_HDF5)) == MATLAB_HDF5


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
        elsewhere = real and (item.external or item.is_virtual)  # numbers of other files
        empty = bool(item.attrs.get("MATLAB_empty", 0))  # it then holds the lengths of its axes
        if real and matlab in MATLAB_NUMBERS and not (elsewhere or empty or name.startswith("#")):
            held[name] = item

    try:
        with open_regular(path, LARGEST_ARRAY_FILE, "give a file"), h5py.File(path, "r") as file:
            file.visititems(visit)
            yield held
    except InputError:
        raise
    except Exception as error:  # h5py raises almost anything on a damaged file
        raise InputError(f"cannot read {path} as {kind} ({error}); save it again{other}") from error


@contextmanager
def _open_mat(path: Path) -> Iterator[IO[bytes]]:
    """Open a ``.mat`` file for scipy."""
    with open_regular(path, LARGEST_ARRAY_FILE, "give a .mat file") as file:
        try:
            yield _check_mat(file, path)
        except InputError:
            raise
        except Exception as error:  # scipy raises almost anything on a damaged file
            raise InputError(
                f"cannot read {path} as a .mat file ({error}); it holds {content_of(path)}; save "
                "it again"
            ) from error


def _check_mat(file: IO[bytes], path: Path) -> IO[bytes]:
    """File without the variables that scipy's reader does not survive, or an error for them."""
    # scipy inflates all that there is, whatever shape the variable claims, and a part of an
    # unknown type ends the process. Of a string, table or datetime of MATLAB it reads no shape:
    # these are left out
    header = file.read(MAT_HEADER)
    order = {b"IM": "<", b"MI": ">"}.get(header[-2:], "")
    found = 0
    size = path.stat().st_size
    kept: list[tuple[int, int]] = []
    while order and len(tag := file.read(MAT_TAG)) == MAT_TAG:
        kind, length = struct.unpack(f"{order}II", tag)
        start = file.tell()
        if kind == MAT_PLAIN:
            opaque = _is_opaque(file, order)
            _check_parts(file, order, min(start + length, size))
        elif kind == MAT_DEFLATED:
            inflate = zlib.decompressobj()
            left = file.read(min(length, size))
            inflated = io.BytesIO()
            while left and not inflate.eof:
                found += inflated.write(inflate.decompress(left, INFLATED_AT_ONCE))
                left = inflate.unconsumed_tail
                check_unpacked(found / DOUBLE, size, str(path), UNCOMPRESSED)
            inflated.seek(MAT_TAG)
            opaque = _is_opaque(inflated, order)
            _check_parts(inflated, order, inflated.getbuffer().nbytes)
        else:
            break
        if not opaque:
            kept.append((start - MAT_TAG, file.tell()))
    file.seek(0)
    if sum(end - start for start, end in kept) in (0, size - MAT_HEADER):
        return file
    sound = io.BytesIO(header)
    sound.seek(0, io.SEEK_END)
    for start, end in kept:
        file.seek(start)
        sound.write(file.read(end - start))
    sound.seek(0)
    return sound


def _is_opaque(file: IO[bytes], order: str) -> bool:
    """True for a variable of a MATLAB class that hides its values; the file stays where it is."""
    start = file.tell()
    flags = file.read(MAT_TAG + 4)[MAT_TAG:]
    file.seek(start)
    return len(flags) == 4 and struct.unpack(f"{order}I", flags)[0] & 0xFF == MAT_OPAQUE


def _check_parts(file: IO[bytes], order: str, end: int) -> None:
    """Raise `ValueError` for a part of a variable of an unknown type; go to the variable's end."""
    while file.tell() + MAT_TAG <= end:
        kind, length = struct.unpack(f"{order}II", file.read(MAT_TAG))
        if (kind & 0xFFFF) not in MAT_PARTS:
            raise ValueError(f"a part of type {kind}")
        if kind < 1 << 16:  # else the values are in the tag
            file.seek(-(-length // MAT_TAG) * MAT_TAG, io.SEEK_CUR)
    file.seek(end)


ZIP_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Ways of compression that are unpacked."""


@contextmanager
def open_zip(path: Path, advice: str) -> Iterator[zipfile.ZipFile]:
    """Open a zip file, or raise `InputError` if it is none or a bomb."""
    with open_regular(path, LARGEST_ARRAY_FILE, advice) as file:
        try:
            archive = zipfile.ZipFile(file)
        except Exception as error:  # zipfile raises almost anything on a damaged directory
            kind = content_of(path)
            held = "it is cut or damaged" if "a zip file" in kind else f"it holds {kind}"
            raise InputError(
                f"cannot read {path} as a zip file ({error}); {held}; {advice}"
            ) from None
        with archive:
            size = sum(info.file_size for info in archive.infolist())
            check_unpacked(size, path.stat().st_size, str(path), advice)
            yield archive


def read_zip_entry(
    archive: zipfile.ZipFile, info: zipfile.ZipInfo, *, where: str, largest: int, advice: str
) -> bytes:
    """Content of an entry of a zip file."""
    if info.flag_bits & 1:
        raise InputError(f"{where} is encrypted; pack it again without a password")
    if info.compress_type not in ZIP_METHODS:
        raise InputError(f"{where} is compressed in an unusual way; pack it with deflate or none")
    if info.file_size > largest:
        raise InputError(
            f"{where} unpacks to {info.file_size / 1e6:.0f} MB, and {largest / 1e6:.0f} MB are "
            f"allowed; {advice}"
        )
    try:
        with archive.open(info) as entry:
            # asked for no more than is declared, zipfile unpacks no more
            return entry.read(info.file_size + 1)
    except Exception as error:  # zipfile and zlib raise almost anything on damaged data
        raise InputError(f"cannot read {where} ({error}); {advice}") from None


LARGEST_TENSORS = 2**33
"""Bytes of a file of tensors at most."""


class DamagedError(Exception):
    """A file holds no tensors with the text that is asked for; its reader says what to do."""


def read_tensors(
    path: str | os.PathLike[str], key: str, advice: str, wanted: Container[str] | None = None
) -> tuple[str, dict[str, np.ndarray]]:
    """Text of a key in a file's header and its tensors, all or those wanted."""
    with open_regular(path, LARGEST_TENSORS, advice):
        try:
            with safe_open(Path(path), framework="numpy") as file:
                text = (file.metadata() or {})[key]
                names = [name for name in file.keys() if wanted is None or name in wanted]  # noqa: SIM118
                return text, {name: file.get_tensor(name) for name in names}
        except Exception as error:  # it raises almost anything on a damaged file
            raise DamagedError(path) from error


def free_memory() -> float:
    """Bytes that programs may still take on this machine without swapping."""
    return float(psutil.virtual_memory().available)


def check_memory(needed: float, free: float, what: str, advice: str) -> None:
    """Raise `InputError` where something would not fit."""
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

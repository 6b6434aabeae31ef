"""Files of data sets, in ``$DEEPFSI_DATA`` or the user's cache: find, check, download, keep."""

import hashlib
import io
import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import numpy.typing as npt

from deepfsi.base.errors import InputError
from deepfsi.base.files import write_atomically
from deepfsi.base.numeric.arrays import read_npy
from deepfsi.base.progress import Progress, terminal_bar


def cache_folder(name: str) -> Path:
    """Folder of this user's cache for the files of a data set."""
    import pooch

    return Path(pooch.os_cache("deepfsi")) / name


def data_folders(name: str) -> list[Path]:
    """Folders where the files of a data set may be, the first before the second."""
    root = os.environ.get("DEEPFSI_DATA")
    if not root:
        return [cache_folder(name)]
    if not Path(root).is_dir():
        raise InputError(f"DEEPFSI_DATA is '{root}', which is no folder; correct or unset it")
    return [Path(root) / name, cache_folder(name)]


def find_folder(name: str, files: Iterable[str]) -> Path | None:
    """First of the `data_folders` that has all the files."""
    files = tuple(files)
    folders = data_folders(name)
    return next((path for path in folders if all((path / f).is_file() for f in files)), None)


def download_files(name: str, hashes: Mapping[str, str], mirrors: tuple[str, ...]) -> Path:
    """Folder of the files of a data set, downloaded where they are missing, all undamaged."""
    folder = find_folder(name, hashes)
    if folder is not None and folder != cache_folder(name):
        for file, expected in hashes.items():
            if fault := _fault_of(folder / file, expected):
                raise InputError(f"{folder / file}: {fault}; replace it with the original")
        return folder
    for file, expected in hashes.items():
        failures = []
        for mirror in mirrors:
            if not (reason := fetch(mirror + file, expected, cache_folder(name) / file)):
                break
            failures.append(f"{urlsplit(mirror).netloc} ({reason})")
        else:
            raise InputError(
                f"{name}: cannot download {file} from {' or '.join(failures)}; try again, or put "
                f"the original files into a folder {name} and set DEEPFSI_DATA to the folder that "
                "holds it"
            )
    return cache_folder(name)


def _fault_of(path: Path, expected: str) -> str:
    """Fault of a file whose hash is given, "algorithm:hex"; none if it agrees."""
    algorithm, _, digest = expected.partition(":")
    try:
        with path.open("rb") as file:
            actual = hashlib.file_digest(file, algorithm).hexdigest()
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    return "" if actual == digest else f"{algorithm} is {actual}, not {digest}"


def fetch(url: str, expected: str | None, path: Path) -> str:
    """Bring the file of an address to a path, unless it is there undamaged, or say why not."""
    import pooch

    pooch.get_logger().setLevel("WARNING")
    try:
        with terminal_bar(path.name) as report:
            pooch.retrieve(url, expected, path.name, path.parent, progressbar=_Download(report))
    except (OSError, ValueError) as error:  # no connection, no such file; wrong hash
        return "wrong hash" if isinstance(error, ValueError) else type(error).__name__
    return ""


class _Download:
    """Progress of a download, as pooch tells it."""

    def __init__(self, report: Progress) -> None:
        self.report = report
        self.total = self.done = 0  # bytes; the total stays 0 where the server does not tell it

    def update(self, size: int) -> None:
        """Count that many bytes more."""
        self.done += size
        self.report(self.done / self.total if self.total else 0.0)

    def reset(self) -> None:
        """Count from 0 again."""
        self.done = 0

    def close(self) -> None:
        """The bar ends with its block."""


def hash_array(values: npt.NDArray[Any]) -> str:
    """SHA-256 in hex of an array's type, shape and values."""
    values = np.ascontiguousarray(values)
    header = f"{values.dtype.str} {values.shape}".encode()
    return hashlib.sha256(header + values.tobytes()).hexdigest()


def kept_array(path: Path, expected: str, make: Callable[[], npt.NDArray[Any]]) -> npt.NDArray[Any]:
    """Array that takes long to make, from a file if that holds it, else made and kept there."""
    with suppress(InputError):  # there is none, or it is damaged
        if hash_array(values := read_npy(path)) == expected:
            return values
    values = make()
    if hash_array(values) == expected:
        content = io.BytesIO()
        np.save(content, values)
        with suppress(OSError, InputError):  # the cache cannot be written: make it again next time
            write_atomically(path, content.getvalue())
    return values

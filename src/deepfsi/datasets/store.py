"""Files of named data sets, in ``$DEEPFSI_DATA`` and the cache, and their download."""

import hashlib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

from deepfsi.base import InputError, Progress, terminal_bar


class FileCheck(NamedTuple):
    """Result of the check of one file."""

    file: str
    ok: bool
    detail: str


def cache(name: str) -> Path:
    """Folder of this user's cache for the files of a data set."""
    import pooch

    return Path(pooch.os_cache("deepfsi")) / name


def candidates(name: str) -> list[Path]:
    """Folders where the files of a data set may be, the first before the second."""
    root = os.environ.get("DEEPFSI_DATA")
    if not root:
        return [cache(name)]
    if not Path(root).is_dir():
        raise InputError(f"DEEPFSI_DATA is '{root}', which is no folder; correct or unset it")
    return [Path(root) / name, cache(name)]


def find_folder(name: str, files: Iterable[str]) -> Path | None:
    """First of the `candidates` that has all the files."""
    whole = (each for each in candidates(name) if all((each / f).is_file() for f in files))
    return next(whole, None)


def check_files(name: str, hashes: Mapping[str, str]) -> list[FileCheck]:
    """Compare the files of a data set with their hashes, "algorithm:hex"."""
    folder = find_folder(name, hashes) or candidates(name)[0]
    return [_check_file(folder / file, known_hash) for file, known_hash in hashes.items()]


def whole_files(name: str, hashes: Mapping[str, str], mirrors: tuple[str, ...]) -> Path:
    """Folder of the files of a data set, downloaded where they are missing, all whole."""
    folder = find_folder(name, hashes)
    if folder is None or folder == cache(name):
        for file, known_hash in hashes.items():
            retrieve(name, file, known_hash, mirrors)
        return cache(name)
    for file, ok, detail in check_files(name, hashes):
        if not ok:
            raise InputError(f"{folder / file}: {detail}; replace it with the original")
    return folder


def _check_file(path: Path, known_hash: str) -> FileCheck:
    algorithm, _, expected = known_hash.partition(":")
    try:
        with path.open("rb") as file:
            found = hashlib.file_digest(file, algorithm).hexdigest()
    except OSError as error:
        return FileCheck(path.name, False, f"cannot be read from {path.parent} ({error.strerror})")
    if found != expected:
        return FileCheck(path.name, False, f"{algorithm} is {found}, not {expected}")
    return FileCheck(path.name, True, f"{algorithm} agrees")


def retrieve(name: str, file: str, known_hash: str, mirrors: tuple[str, ...]) -> None:
    """Bring one file into the cache, unless it is there whole, from the first mirror that can."""
    failures = []
    for mirror in mirrors:
        if not (reason := fetch(mirror + file, known_hash, cache(name) / file)):
            return
        failures.append(f"{urlsplit(mirror).netloc} ({reason})")
    raise InputError(
        f"{name}: cannot download {file} from {' or '.join(failures)}; try again, or put the "
        f"original files into a folder {name} and set DEEPFSI_DATA to the folder that holds it"
    )


def fetch(url: str, known_hash: str | None, path: Path) -> str:
    """Bring the file of an address to a path, unless it is there whole; say why it could not be."""
    # The hash is "algorithm:hex"; without one the file may not be there yet
    import pooch

    pooch.get_logger().setLevel("WARNING")
    try:
        with terminal_bar(path.name) as report:
            pooch.retrieve(url, known_hash, path.name, path.parent, progressbar=_Download(report))
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

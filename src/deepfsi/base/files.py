"""Reading what users give, and writing so that a stopped program leaves nothing half written.

Every reader opens files by `open_regular`: only regular files, up to its own limit.
`check_unpacked` refuses files that unpack to far more than their size.

A file is written as a draft beside its target, `.NAME.TOKEN.draft`, which replaces the target when
it is complete. A killed process leaves its draft behind.
"""

import codecs
import errno
import os
import re
import stat
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from io import BufferedReader, FileIO
from pathlib import Path
from typing import Any, BinaryIO

from deepfsi.base.errors import InputError

DESIGN_ENDINGS = (".safetensors",)
"""Ends of the names of design files."""

UNPACKED_RATIO = 32
"""Values, or bytes, that a file may unpack to for each of its bytes, beyond some millions."""


@contextmanager
def open_regular(
    path: str | os.PathLike[str],
    largest: int = sys.maxsize,
    advice: str = "give a file that can be read",
    buffering: int = -1,
) -> Iterator[BufferedReader]:
    """Open a regular file to read, up to a size; `InputError` for anything else."""
    try:
        file = open(path, "rb", buffering, opener=_open_at_once)  # noqa: SIM115 - errors of what follows are not ours
    except FileNotFoundError:
        raise InputError(f"{path} is missing: {advice}") from None
    except (OSError, ValueError) as error:  # a name with a null character is a ValueError
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path} cannot be read ({reason}): {advice}") from None
    with file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{path} cannot be read (it is no regular file): {advice}")
        if status.st_size > largest:
            raise InputError(f"{path} has more than {largest} bytes: {advice}")
        yield file  # type: ignore[misc]  # without a buffer a FileIO, which reads alike


def _open_at_once(path: str, flags: int) -> int:
    """Open a file without waiting for a writer, which a pipe may lack."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def read_regular(path: str | os.PathLike[str], largest: int, advice: str) -> bytes:
    """Content of a file, by the rules of `open_regular`."""
    with open_regular(path, largest, advice) as file:
        return file.read()


def read_text(path: str | os.PathLike[str], largest: int, advice: str) -> str:
    """Text of a file of any editor, in UTF-8 or UTF-16, its lines ended by line feeds alone."""
    content = read_regular(path, largest, advice)
    marked = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    text = "\0"  # stays if the bytes cannot be decoded
    with suppress(UnicodeDecodeError):
        text = content.decode("utf-16" if marked else "utf-8-sig")
    if "\0" in text:  # UTF-16 without its mark passes as UTF-8 with null characters
        raise InputError(f"{path} holds no text in UTF-8: {advice}")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Tables of a TOML file."""
    import tomllib

    content = read_text(path, 2**18, "give a TOML file")
    # to read a key takes time in the square of its parts
    if max(part.count(".") for part in re.split(r"[\n,={}\[\]]", content)) > 500:
        raise InputError(f"{path} has a key of more than 500 dots: break it up")
    try:
        return tomllib.loads(content)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is no TOML file: {error}") from None


def check_unpacked(unpacked: float, packed: int, what: str, advice: str) -> None:
    """Raise `InputError` for far more values, or bytes, than the packed bytes explain."""
    limit = 2**24 + UNPACKED_RATIO * packed
    if unpacked > limit:
        raise InputError(
            f"{what} would unpack {packed} bytes to {unpacked:.3g}, and {limit} are allowed: "
            f"{advice}"
        )


def write_atomically(path: str | os.PathLike[str], content: bytes) -> Path:
    """Write a file completely or not at all, and give its path."""
    with open_atomically(path) as file:
        file.write(content)
    return Path(path)


def check_ending(path: str | os.PathLike[str], ends: Sequence[str]) -> None:
    """Raise `InputError` unless a name ends as files of its kind do."""
    if Path(path).suffix.lower() not in ends:
        raise InputError(f"cannot write to {path}: end the name in {' or '.join(ends)}")


def readable_name(name: str) -> str:
    r"""A file's name as text: bytes of it that are no UTF-8 as `\xff`, which JSON cannot hold."""
    return os.fsencode(name).decode("utf-8", "backslashreplace")


def hash_file(path: Path) -> str:
    """SHA-256 of a file's content."""
    from hashlib import file_digest

    with open_regular(path) as file:
        return file_digest(file, "sha256").hexdigest()


@contextmanager
def open_atomically(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Open a file to write, which appears when the block ends, and not at all if it fails."""
    with _draft(Path(path)) as draft, open(draft, "xb") as file:
        yield file
        file.flush()
        os.fsync(file.fileno())  # content before name: a crash leaves no empty file


class GrowingFile(FileIO):
    """A new file that others read while it grows; each write is kept completely or not at all.

    A full disk may take the first bytes only. An unbuffered `write` then raises nothing: it
    returns how many it took.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        super().__init__(os.fspath(path), "x")

    def write(self, content: bytes, /) -> int:  # type: ignore[override]
        """Write content; `InputError` if the disk does not take all, and then none is kept."""
        size = os.fstat(self.fileno()).st_size
        rest = memoryview(content)
        try:
            while rest:
                taken = os.write(self.fileno(), rest)
                if not taken:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                rest = rest[taken:]
        except OSError as error:
            self.truncate(size)
            raise InputError(
                f"cannot write {self.name}: {error.strerror or error}; its first {size} bytes are "
                "kept: free the disk, or give a folder on another one"
            ) from error
        return len(content)


@contextmanager
def new_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Fill a new folder, which gets its name when the block ends; an empty one is replaced."""
    target = Path(path)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError(f"{target} exists already: give a new folder")
    with _draft(target) as draft:
        draft.mkdir()
        yield draft
        if target.exists():
            target.rmdir()  # Windows puts no folder in place of another


@contextmanager
def _draft(target: Path) -> Iterator[Path]:
    """Path of a draft that replaces the target when the block ends, and goes if it fails."""
    import shutil

    # 50 letters: file systems allow names of 255 bytes
    draft = target.parent / f".{target.name[:50]}.{os.urandom(4).hex()}.draft"
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield draft
        os.replace(draft, target)
    except BaseException as error:
        with suppress(OSError):
            shutil.rmtree(draft) if draft.is_dir() else draft.unlink()
        if not isinstance(error, OSError):
            raise
        name = Path(error.filename or draft)
        if target.parent not in name.parents and name not in target.parents:
            raise  # an error of another file, which the block read
        reason = error.strerror or error
        raise InputError(f"cannot write {target}: {reason}; nothing of it was kept") from error

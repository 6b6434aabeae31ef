"""Paths that a command reads or writes, checked before its work and before heavy imports."""

import tempfile
from pathlib import Path

from deepfsi.base import DESIGN_ENDINGS as DESIGN_ENDINGS
from deepfsi.base import InputError, check_ending, check_report

PICTURES = (".png", ".svg", ".pdf")
TABLES = (".csv", ".parquet")
"""Ends of the names of files."""

PROBE = 2**20
"""Bytes that must fit a disk before any work whose result goes there."""


def check_design(path: Path) -> Path:
    """Path of a design file, of a folder of patterns, or of a published design by its name."""
    from deepfsi.designfile import find_design

    found = find_design(path)
    if not found.exists():
        raise InputError(f"no design file at {path}: make one with `deepfsi design`")
    return found


def check_there(path: Path, what: str) -> None:
    """Raise `InputError` unless there is something at the path, which should be `what`."""
    if not path.exists():
        raise InputError(f"there is nothing at {path}: give {what}")


def check_file(path: Path, ends: tuple[str, ...], force: bool, made: Path | None = None) -> None:
    """Raise `InputError` unless a file can be written to a path; `force` lets it replace one."""
    if path.is_dir():
        raise InputError(f"{path} is a folder: give a file name ending in {' or '.join(ends)}")
    check_ending(path, ends)
    if ends == PICTURES:
        check_report()
    check_free(path, force)
    if (made is None or path.parent not in (made, *made.parents)) and not path.parent.is_dir():
        raise InputError(f"cannot write {path}: there is no folder {path.parent}; make it first")
    _check_writable(path, path.parent)


def check_free(path: Path, force: bool) -> None:
    """Raise `InputError` if there is something at the path that may not be replaced."""
    if path.exists() and not force:
        raise InputError(f"{path} exists already: give another name, or --force to replace it")


def check_folder(path: Path) -> None:
    """Raise `InputError` unless a command can write into a folder, which it makes if need be."""
    _check_writable(path, path)


def check_new_folder(path: Path) -> None:
    """Raise `InputError` unless a command can make a folder, or fill an empty one."""
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InputError(f"{path} exists already: give a new folder")
    _check_writable(path, path.parent)


def _check_writable(path: Path, folder: Path) -> None:
    """Write a file in the folder, or in the lowest one above that is there, and leave nothing."""
    there = next(each for each in (folder, *folder.parents) if each.exists())
    if not there.is_dir():
        raise InputError(f"cannot write to {path}: {there} is a file; give another place")
    try:
        with tempfile.TemporaryFile(dir=there) as file:
            file.write(bytes(PROBE))  # a file may be made where nothing can be written into it
    except OSError as error:
        raise InputError(f"cannot write to {path}: {error.strerror}; give another place") from None

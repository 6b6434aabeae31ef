"""Writing files so that a stopped program leaves none half written.

What is being written is a draft beside its target, `.NAME.OWNER.draft`, which takes the target's
place when it is whole. A killed process leaves its draft behind; the next one that writes to the
folder removes it.
"""

import os
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from hashlib import file_digest
from pathlib import Path
from typing import BinaryIO

from deepfsi.errors import InputError
from deepfsi.owners import PATTERN, owner_of, this_process

DRAFT_SECONDS = 86400.0
"""Age from which a draft of another host is left over: its process cannot be asked for."""


def write_atomically(path: str | os.PathLike[str], content: bytes) -> Path:
    """Write a file so that it is either whole or not there; parent folders are made."""
    with open_atomically(path) as file:
        file.write(content)
    return Path(path)


def hash_file(path: Path) -> str:
    """SHA-256 of a file's content."""
    with path.open("rb") as file:
        return file_digest(file, "sha256").hexdigest()


@contextmanager
def open_atomically(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Open a file to write that appears, whole, when the block ends; none if the block fails."""
    target = Path(path)
    with _named(target):
        draft = _draft(target)
        try:
            with open(draft, "xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.replace(draft, target)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise


@contextmanager
def new_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Make a folder that takes an empty one's place, or none's, when the block ends well."""
    target = Path(path)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError(f"{target} exists already: give a new folder")
    with _named(target):
        draft = _draft(target)
        try:
            draft.mkdir()
            yield draft
            os.replace(draft, target)
        except BaseException:
            shutil.rmtree(draft, ignore_errors=True)
            raise


@contextmanager
def _named(target: Path) -> Iterator[None]:
    """Name what the user asked for, and no draft of it, where it cannot be written."""
    try:
        yield
    except OSError as error:
        if error.filename is not None and not _beside(Path(error.filename), target):
            raise  # of something that was read
        reason = error.strerror or error
        raise InputError(f"cannot write {target}: {reason}; nothing of it was kept") from error


def _beside(path: Path, target: Path) -> bool:
    """True for a draft of the target, what is in it, and the folders above."""
    return target.parent in path.parents or path in target.parents


def remove_drafts(folder: Path) -> None:
    """Remove the drafts in a folder that processes left which are gone."""
    if not folder.is_dir():
        return
    with os.scandir(folder) as entries:
        drafts = [entry for entry in entries if entry.name.endswith(".draft")]
    for entry in drafts:
        found = re.fullmatch(rf"\..*\.({PATTERN})\.draft", entry.name)
        owner = owner_of(found[1]) if found else None
        if owner and (owner.gone if owner.here else _age(entry) > DRAFT_SECONDS):
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path, ignore_errors=True)
            else:
                Path(entry.path).unlink(missing_ok=True)


def _draft(target: Path) -> Path:
    """Place for what is to become `target`; its folder is made, and cleared of old drafts."""
    target.parent.mkdir(parents=True, exist_ok=True)
    _clear_once(target.parent.resolve())
    return target.parent / f".{target.name}.{this_process()}.draft"


@cache
def _clear_once(folder: Path) -> None:
    remove_drafts(folder)


def _age(entry: os.DirEntry[str]) -> float:
    """Seconds since a file was changed; 0 if it has just gone."""
    try:
        return time.time() - entry.stat(follow_symlinks=False).st_mtime
    except FileNotFoundError:
        return 0.0

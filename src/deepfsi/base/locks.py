"""Processes that own files, told from the files' names, and locks that end with their process.

A process is named by its host (with boot and process namespace, so that another container or a host
that was started anew is another one), its number there and the moment of its start. Whether one on
this host still runs can be asked; of one elsewhere only its files' changes tell.
"""

import contextlib
import os
import re
import threading
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

START_TOLERANCE = 60.0
"""Seconds by which the start of one process may seem to move, where the clock is set."""

PROCESS_PATTERN = r"[0-9a-f]{12}-\d+-\d+-[0-9a-f]{8}"
"""Regular expression of the name of a process."""


class _ProcessId(NamedTuple):
    """A process, and a number that tells apart what it owns; as text it is a file's name."""

    host: str
    """Hash of its host, as of `_host_id`."""
    number: int
    """Its number there."""
    start_s: int
    """Seconds from the host's start to its own."""
    token: str
    """Random."""

    def __str__(self) -> str:
        return f"{self.host}-{self.number}-{self.start_s}-{self.token}"

    @property
    def is_here(self) -> bool:
        """True if the process is or was on this host, so that it can be asked for."""
        return self.host == _host_id()

    @property
    def is_gone(self) -> bool:
        """True if the process was here and runs no more."""
        if not self.is_here:
            return False
        import psutil

        try:
            return abs(_start_of(self.number) - self.start_s) > START_TOLERANCE
        except psutil.NoSuchProcess:
            return True
        except psutil.AccessDenied:
            return False


def this_process() -> _ProcessId:
    """Name of this process for something new that it makes."""
    return _ProcessId(_host_id(), os.getpid(), _this_start(os.getpid()), os.urandom(4).hex())


def _parse_process(name: str) -> _ProcessId | None:
    """Process whose name this is, or None if it is none."""
    if not re.fullmatch(PROCESS_PATTERN, name):
        return None
    host, number, start, token = name.split("-")
    return _ProcessId(host, int(number), int(start), token)


@cache
def _host_id() -> str:
    """Name of this host, since it was started, as this process's namespace sees it."""
    import hashlib
    import platform

    facts = [platform.node()]
    for source in ("/proc/sys/kernel/random/boot_id", "/proc/self/ns/pid"):
        path = Path(source)
        if path.is_symlink():
            facts.append(os.readlink(path))
        elif path.is_file():
            facts.append(path.read_text("ascii"))
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()[:12]


@cache
def _this_start(number: int) -> int:
    return round(_start_of(number))


def _start_of(number: int) -> float:
    """Seconds from the host's start to a process's; psutil's error if it does not run."""
    import psutil

    process = psutil.Process(number)
    if process.status() == psutil.STATUS_ZOMBIE:
        raise psutil.ZombieProcess(number)
    return process.create_time() - psutil.boot_time()


BEAT_SECONDS = 20.0
"""Time between two changes of a lock's file."""

SILENT_SECONDS = 180.0
"""Time without a change after which a lock of another host is over; attributes of files on a
network may be a minute old."""


class Locks:
    """Locks of one process in a folder, `locks/` of it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "locks"
        self._owned: dict[str, Path] = {}
        self._end: threading.Event | None = None  # of the thread that shows that this one lives
        for key in list_folder(self.folder):  # of processes that are gone
            for lock in list_folder(key):
                _over(lock)
            _remove_empty(key)
        _remove_empty(self.folder)

    def take(self, key: str) -> bool:
        """Lock a key; False where it is locked, here or elsewhere, or wanted at this moment."""
        if key in self._owned:
            return False
        mine = self.folder / key / str(this_process())
        self._owned[key] = mine
        _make(mine)
        now = mine.stat().st_mtime  # by the clock of the folder, as that of other locks
        if any(other != mine and not _over(other, now) for other in list_folder(mine.parent)):
            self.give_up(key)
            return False
        if self._end is None:
            self._end = threading.Event()
            threading.Thread(target=self._show_life, args=(self._end,), daemon=True).start()
        return True

    def give_up(self, key: str) -> None:
        """Let others have a key."""
        mine = self._owned.pop(key)
        mine.unlink(missing_ok=True)
        _remove_empty(mine.parent)

    def give_up_all(self) -> None:
        """Let others have every key of this process."""
        for key in list(self._owned):
            self.give_up(key)
        if self._end is not None:
            self._end.set()
            self._end = None
        _remove_empty(self.folder)

    def _show_life(self, end: threading.Event) -> None:
        while not end.wait(BEAT_SECONDS):
            for mine in list(self._owned.values()):
                with contextlib.suppress(OSError):
                    os.utime(mine)


def _make(mine: Path) -> None:
    """Make the file of a lock; its folder may be taken away meanwhile, by one that ends."""
    while True:
        try:
            mine.parent.mkdir(parents=True, exist_ok=True)
            mine.touch()
            return
        except (FileNotFoundError, FileExistsError):
            if mine.parent.is_file():
                raise


def _over(lock: Path, now: float = 0.0) -> bool:
    """Take a lock's file away if its process is gone; True if nothing is left of it."""
    owner = _parse_process(lock.name)
    try:
        silent = now - lock.stat().st_mtime > SILENT_SECONDS
    except FileNotFoundError:
        return True
    if owner is None:
        return True
    if owner.is_gone if owner.is_here else silent:
        lock.unlink(missing_ok=True)
        return True
    return False


def list_folder(folder: Path) -> Iterator[Path]:
    """Give what a folder holds, nothing where another process took it away."""
    try:
        yield from list(folder.iterdir())
    except (FileNotFoundError, NotADirectoryError):
        return


def _remove_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):
        folder.rmdir()

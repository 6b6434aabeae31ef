"""Locks on trials that several processes share, without the file locks of a system.

Network folders are often mounted without locks, and those that have them lose them. A lock is a
file of its own, `locks/KEY/OWNER`, whose name says who owns it. A process that wants KEY first
makes its file, then looks for others: it has the lock if there is none, and else takes its own
file away. Two that want KEY at one moment may both miss it, and try again; both can never have it.

A lock ends with its process. One at this place is asked for; another host's has to change its
files again and again, and whoever sees no change for `SILENT_SECONDS`, by its own clock, takes the
lock. Should that process only have slept, a trial is trained twice, with the same result.
"""

import contextlib
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from deepfsi.owners import owner_of, this_process

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
        self._seen: dict[Path, tuple[int, float]] = {}
        self._end = threading.Event()
        self._beating: threading.Thread | None = None
        self._remove_old()

    def take(self, key: str) -> bool:
        """Lock a key; False where it is locked, here or elsewhere, or wanted at this moment."""
        if key in self._owned:
            return False
        mine = self.folder / key / str(this_process())
        self._owned[key] = mine
        self._make(mine)
        if any(other != mine and not self._over(other) for other in inside(mine.parent)):
            self.give_up(key)
            return False
        self._beat()
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
        self._end.set()
        self._beating = None
        _remove_empty(self.folder)

    def _make(self, mine: Path) -> None:
        """Make the file of a lock; its folder may be taken away meanwhile, by one that ends."""
        while True:
            try:
                mine.parent.mkdir(parents=True, exist_ok=True)
                mine.touch()
                return
            except (FileNotFoundError, FileExistsError):
                if mine.parent.is_file():
                    raise

    def _over(self, lock: Path) -> bool:
        """Take a lock's file away if its process is gone; True if nothing is left of it."""
        owner = owner_of(lock.name)
        if owner is None:
            return True
        if owner.gone if owner.here else self._silent(lock):
            lock.unlink(missing_ok=True)
            return True
        return False

    def _silent(self, lock: Path) -> bool:
        """True if a file has not changed for long since it was first seen so."""
        try:
            changed = lock.stat().st_mtime_ns
        except FileNotFoundError:
            return True
        before, since = self._seen.get(lock, (None, 0.0))
        if changed != before:
            self._seen[lock] = (changed, time.monotonic())
            return False
        return time.monotonic() - since > SILENT_SECONDS

    def _remove_old(self) -> None:
        """Take away what processes left that are gone."""
        for key in inside(self.folder):
            for lock in inside(key):
                self._over(lock)
            _remove_empty(key)
        _remove_empty(self.folder)

    def _beat(self) -> None:
        """Show that this process lives, from now until all locks are given up."""
        if self._beating is None:
            self._end = threading.Event()
            self._beating = threading.Thread(target=self._show_life, args=(self._end,), daemon=True)
            self._beating.start()

    def _show_life(self, end: threading.Event) -> None:
        while not end.wait(BEAT_SECONDS):
            for mine in list(self._owned.values()):
                with contextlib.suppress(OSError):
                    os.utime(mine)


def inside(folder: Path) -> Iterator[Path]:
    """Give what a folder holds, nothing where another process took it away."""
    try:
        yield from list(folder.iterdir())
    except (FileNotFoundError, NotADirectoryError):
        return


def _remove_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):
        folder.rmdir()

"""Processes that own a file, told from its name, and whether one of them is gone.

A process is named by its place (host, boot and process namespace, so that another container or a
host that was started anew is another place), its number there and the moment of its start. Whether
one at this place still runs can be asked; of one elsewhere only its files' changes tell.
"""

import hashlib
import os
import platform
import re
import uuid
from functools import cache
from pathlib import Path
from typing import NamedTuple

import psutil

START_TOLERANCE = 60.0
"""Seconds by which the start of one process may seem to move, where the clock is set."""

PATTERN = r"[0-9a-f]{12}-\d+-\d+-[0-9a-f]{8}"
"""Regular expression of an owner's name."""


class Owner(NamedTuple):
    """A process, and a number that tells apart what it owns."""

    place: str  # hash of its host
    process: int  # its number there
    started: int  # seconds from the host's start to its own
    own: str  # random

    def __str__(self) -> str:
        return f"{self.place}-{self.process}-{self.started}-{self.own}"

    @property
    def here(self) -> bool:
        """True if the process is or was at this place, so that it can be asked for."""
        return self.place == place()

    @property
    def gone(self) -> bool:
        """True if the process was here and runs no more."""
        if not self.here:
            return False
        try:
            return abs(_started(self.process) - self.started) > START_TOLERANCE
        except psutil.NoSuchProcess:
            return True
        except psutil.AccessDenied:
            return False


def this_process() -> Owner:
    """Owner of something new that this process makes."""
    return Owner(place(), os.getpid(), _own_start(os.getpid()), uuid.uuid4().hex[:8])


def owner_of(name: str) -> Owner | None:
    """Owner whose name this is, or None if it is none."""
    if not re.fullmatch(PATTERN, name):
        return None
    where, process, started, own = name.split("-")
    return Owner(where, int(process), int(started), own)


@cache
def place() -> str:
    """Name of this host, since it was started, as this process's namespace sees it."""
    facts = [platform.node()]
    for source in ("/proc/sys/kernel/random/boot_id", "/proc/self/ns/pid"):
        path = Path(source)
        if path.is_symlink():
            facts.append(os.readlink(path))
        elif path.is_file():
            facts.append(path.read_text("ascii"))
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()[:12]


@cache
def _own_start(process: int) -> int:
    return round(_started(process))


def _started(process: int) -> float:
    """Seconds from the host's start to a process's; psutil's error if it does not run."""
    found = psutil.Process(process)
    if found.status() == psutil.STATUS_ZOMBIE:
        raise psutil.ZombieProcess(process)
    return found.create_time() - psutil.boot_time()

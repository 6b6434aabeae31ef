"""A computer of a laboratory, in a process of its own: Windows, and no torch.

Reads command lines of `deepfsi` from standard input, runs each, and prints their exit codes. What
only POSIX has is hidden, files behave as on Windows (none is removed or replaced while it is open,
and no folder takes the place of another), text is that of a console there, and a file that is
opened as text without its encoding is an error.
"""

import os
import shutil
import signal
import sys
import warnings
from importlib import import_module
from pathlib import Path

MODULES = ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "posix", "syslog")
CALLS = """
    fork forkpty vfork posix_spawn getuid geteuid getgid getppgid getpgid setsid killpg uname nice
    sched_getaffinity sched_setaffinity getloadavg sysconf statvfs mkfifo chown chroot wait3 wait4
    WNOHANG O_NONBLOCK O_CLOEXEC O_NOFOLLOW O_DIRECTORY openpty ttyname sync pread pwrite
"""
SIGNALS = """
    SIGINT SIGTERM SIGABRT SIGFPE SIGILL SIGSEGV SIG_DFL SIG_IGN signal Signals
"""
USUAL = """
    multiprocessing.spawn subprocess click matplotlib.pyplot polars psutil rich.progress scipy.io
    skimage.measure skimage.transform sklearn.datasets
"""
"""Modules that are others there: of the standard library, and compiled packages."""


class Hidden:
    """Finder that has no such module."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        top = name.partition(".")[0]
        if top in self.names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=top)


def as_windows() -> None:
    """Hide what Windows has not, in this process, from what is imported from now on."""
    for name in USUAL.split():
        import_module(name)
    usage = shutil.disk_usage(".")
    shutil.disk_usage = lambda path: usage  # there without statvfs
    for name in MODULES:
        sys.modules.pop(name, None)
    sys.meta_path.insert(0, Hidden(MODULES))
    for name in CALLS.split():
        vars(os).pop(name, None)
    gone = ("SIG", "pthread", "sig", "alarm", "setitimer", "pause")
    for name in {each for each in vars(signal) if each.startswith(gone)} - {*SIGNALS.split()}:
        delattr(signal, name)
    sys.platform = "win32"
    for name in ("replace", "rename", "unlink", "remove", "rmdir"):
        setattr(os, name, _checked(name, getattr(os, name)))


def _checked(name: str, usual):
    def change(path, *others, **words):
        for each in (path, *others):
            if Path(each).resolve() in _opened():
                raise PermissionError(13, f"{name}: the file is open", str(each))
        if name in ("replace", "rename") and Path(others[0]).is_dir():
            raise PermissionError(13, f"{name}: the folder is there", str(others[0]))
        return usual(path, *others, **words)

    return change


def _opened() -> set[Path]:
    """Files that this process holds open, or in its memory."""
    open_now = {Path(os.path.realpath(f"/proc/self/fd/{n}")) for n in os.listdir("/proc/self/fd")}
    maps = Path("/proc/self/maps").read_text("utf-8").splitlines()
    return open_now | {Path(line.split()[-1]) for line in maps if "/" in line}


def run(lines: list[str]) -> None:
    """Run commands, one after another."""
    from deepfsi.cli import run_command_line

    for line in lines:
        sys.argv = ["deepfsi", *line.split()]
        try:
            run_command_line()
        except SystemExit as stop:
            print(f"exit {stop.code or 0}: {line}", flush=True)


if __name__ == "__main__":
    sys.meta_path.insert(0, Hidden(("torch",)))
    as_windows()
    warnings.filterwarnings("error", category=EncodingWarning, module=r"deepfsi\.")
    run(sys.stdin.read().splitlines())

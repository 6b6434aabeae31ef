"""Ctrl-C and SIGTERM on a command line: one line, and the end; a second signal ends at once.

The exit code is 130 after Ctrl-C and 143 after SIGTERM, as shells have them. Python turns Ctrl-C
into `KeyboardInterrupt`, which does harm within the import of a compiled module (a fatal error of
Python) and in a worker process that just starts (a traceback). So it is raised only where no import
runs, and workers are started with it blocked. SIGTERM goes the same way: a worker whose parent ends
while it starts prints a traceback. Files are drafts until they are whole, and locks end with their
process, so that a stop at any moment leaves nothing half done.
"""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any, NoReturn

STOPPED_EXIT_CODE = 130
"""Exit code of a command that was stopped by Ctrl-C."""

STOP_SIGNALS = signal.SIGINT, signal.SIGTERM
"""Signals that stop a command."""

_reported = threading.Event()
_received: signal.Signals | None = None
_saved_work = ""


def install_handler() -> None:
    """Handle Ctrl-C for the rest of this process, a command line."""
    if sys.platform == "win32":  # has no such signals
        return
    for number in STOP_SIGNALS:
        signal.signal(number, _stop)
    sys.warnoptions.append("ignore:resource_tracker")  # it cleans up after us, and says so


def note_saved_work(words: str) -> None:
    """Note what is kept from now on if the command is stopped, such as "finished scenes"."""
    global _saved_work
    _saved_work = words


def saved_work_text() -> str:
    """End of a line that says what work is kept; empty if none is."""
    return f"; {_saved_work}" if _saved_work else ""


def say_stopped() -> None:
    """Say once on standard error that the command was stopped, and what is kept."""
    if not _reported.is_set():
        _reported.set()
        print(f"deepfsi: stopped{saved_work_text()}", file=sys.stderr)


def end_process() -> NoReturn:
    """End this process and its workers now."""
    _end_workers()
    with contextlib.suppress(OSError, ValueError, RuntimeError):  # it may interrupt a print
        if sys.stderr.isatty():
            sys.stderr.write("\x1b[?25h")  # a bar hides the cursor
        say_stopped()
        sys.stderr.flush()
        sys.stdout.flush()
    os._exit(128 + (_received or signal.SIGINT))


@contextlib.contextmanager
def block_ctrl_c() -> Iterator[None]:
    """Hold back `STOP_SIGNALS` until the block ends; processes started in it never see Ctrl-C."""
    usual = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    handlers: dict[int, Any] = {number: call for number, call in usual.items() if callable(call)}
    # Python sets handlers in the main thread alone
    off_main = threading.current_thread() is not threading.main_thread()
    if sys.platform == "win32" or off_main or not handlers:
        yield
        return
    received: list[int] = []
    for number in handlers:
        signal.signal(number, lambda number, frame: received.append(number))
    # Processes that are started inherit the mask
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if received:
            handlers[received[0]](received[0], sys._getframe())


def _end_workers() -> None:
    """Kill worker processes, also one that starts; imports nothing, as an import may be running."""
    psutil: Any = sys.modules.get("psutil")
    if "multiprocessing.spawn" not in sys.modules or not hasattr(psutil, "Process"):
        return
    for child in psutil.Process().children():
        with contextlib.suppress(psutil.Error):
            if any("multiprocessing.spawn" in word for word in child.cmdline()):
                child.kill()


def _stop(number: int, frame: FrameType | None) -> None:
    """Raise `KeyboardInterrupt`, but end the process where an import runs or no command does."""
    global _received
    _received = signal.Signals(number)
    for stop in STOP_SIGNALS:
        signal.signal(stop, signal.SIG_DFL)  # a second one ends the process, whatever it does
    if "deepfsi.cli" not in sys.modules:  # nobody would catch it
        end_process()
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            end_process()
        frame = frame.f_back
    raise KeyboardInterrupt

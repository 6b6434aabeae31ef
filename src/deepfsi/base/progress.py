"""Progress of a long task."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple


def _nothing(share: float, what: str) -> None:
    """Show nothing."""


class Progress(NamedTuple):
    """Where a task says how far it is."""

    show: Callable[[float, str], None] = _nothing
    begin: float = 0.0
    end: float = 1.0

    def __call__(self, share: float, what: str = "") -> None:
        """Say that a share of this task is done, 0 to 1, and what is being done."""
        self.show(self.begin + share * (self.end - self.begin), what)

    def between(self, begin: float, end: float) -> "Progress":
        """Progress of a part of this task, from one share of it to another."""
        span = self.end - self.begin
        return Progress(self.show, self.begin + begin * span, self.begin + end * span)

    def split(self, count: int) -> list["Progress"]:
        """Progress of equal parts of this task, one after another."""
        return [self.between(i / count, (i + 1) / count) for i in range(count)]


SILENT = Progress()
"""Shows nothing."""


FIRST_LINE_SECONDS = 2.0
"""Time after which a task says how far it is, where no terminal shows a bar."""

MOST_LINE_SECONDS = 300.0
"""Longest time between two lines; each time is twice the one before."""

LEAST_PROGRESS = 0.05
"""Share of a task after which the time left is estimated, at the pace of what was done of it."""

WHOLE_TASK = 1e7
"""Seconds that the time left is estimated over: all that have passed, as batches end rarely."""


@contextmanager
def terminal_bar(what: str, hidden: bool = False) -> Iterator[Progress]:
    """Progress with the time left on standard error: a bar on a terminal, else a line at times."""
    from rich.console import Console
    from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar
    from rich.progress import TimeRemainingColumn as TimeLeft

    console = Console(stderr=True)
    if hidden:
        yield SILENT
        return
    if not console.is_terminal:
        with _lines(what) as report:
            yield report
        return
    words = TextColumn("{task.description}", markup=False)
    columns = (SpinnerColumn(), words, BarColumn(), TimeElapsedColumn(), TimeLeft())
    with Bar(*columns, console=console, transient=True, speed_estimate_period=WHOLE_TASK) as bar:
        task = bar.add_task(what, total=1.0)
        yield Progress(
            lambda share, now: bar.update(task, completed=share, description=now or what)
        )


@contextmanager
def _lines(what: str) -> Iterator[Progress]:
    """Say at times how far a task is, from the second second on."""
    # The pace is that since the first share above 0: what starts a task is not of it
    began = time.monotonic()
    ended = threading.Event()
    share = 0.0
    first = (0.0, began)

    def note(now: float, _: str) -> None:
        nonlocal share, first
        if share <= 0 < now:
            first = now, time.monotonic()
        share = now

    def say() -> None:
        pause = FIRST_LINE_SECONDS
        while not ended.wait(pause):
            now = time.monotonic()
            before, since = first
            pace = (share - before) / max(now - since, 1e-9)
            left = (1 - share) / pace if share - before >= LEAST_PROGRESS else None
            rest = "" if left is None else f", about {_duration_text(left)} left"
            done = f"{what}: {share:.0%} after {_duration_text(now - began)}{rest}"
            print(done, file=sys.stderr)
            pause = min(time.monotonic() - began, MOST_LINE_SECONDS)

    threading.Thread(target=say, daemon=True).start()
    try:
        yield Progress(note)
    finally:
        ended.set()


def _duration_text(seconds: float) -> str:
    """Write a time as people do: 40 s, 12 min, 3.5 h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


@contextmanager
def progress_bar(report: Progress | None, what: str) -> Iterator[Progress]:
    """The report of a task that was given one, else a bar where a terminal is attached."""
    if report is not None:
        yield report
        return
    with terminal_bar(what) as bar:
        yield bar

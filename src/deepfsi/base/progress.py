"""Progress of a long task."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple


def _nothing(share: float, what: str) -> None:
    """Show nothing."""


class Progress(NamedTuple):
    """A task reports the share that is done."""

    show: Callable[[float, str], None] = _nothing
    begin: float = 0.0
    end: float = 1.0

    def __call__(self, share: float, what: str = "") -> None:
        """Say that a share of this task is done, 0 to 1, and what is being done."""
        self.show(self.begin + share * (self.end - self.begin), what)

    def between(self, begin: float, end: float) -> "Progress":
        """Progress of this task from one share to another."""
        span = self.end - self.begin
        return Progress(self.show, self.begin + begin * span, self.begin + end * span)

    def split(self, count: int) -> list["Progress"]:
        """Progress of equal parts of this task, one after another."""
        return [self.between(i / count, (i + 1) / count) for i in range(count)]


SILENT = Progress()
"""Shows nothing."""


FIRST_LINE_SECONDS = 2.0
"""Time after which a task says what share is done, where no terminal shows a bar."""


@contextmanager
def progress_bar(report: Progress | None, what: str) -> Iterator[Progress]:
    """The report of a task that was given one, else progress with the time left on standard error.

    That is a bar on a terminal, else a line at times.
    """
    if report is not None:
        yield report
        return
    from rich.console import Console
    from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar
    from rich.progress import TimeRemainingColumn as TimeLeft

    console = Console(stderr=True)
    if not console.is_terminal:
        yield Progress(_Lines(what))
        return
    words = TextColumn("{task.description}", markup=False)
    columns = (SpinnerColumn(), words, BarColumn(), TimeElapsedColumn(), TimeLeft())
    # The time left is estimated over all that has passed, as batches end rarely
    with Bar(*columns, console=console, transient=True, speed_estimate_period=1e7) as bar:
        task = bar.add_task(what, total=1.0)
        # without words the last ones stay
        yield Progress(
            lambda share, now: bar.update(task, completed=share, description=now or None)
        )


class _Lines:
    """Says at times what share of a task is done, from the second second on."""

    def __init__(self, what: str) -> None:
        self.what = what
        self.began = time.monotonic()
        self.due = self.began + FIRST_LINE_SECONDS

    def __call__(self, share: float, _: str) -> None:
        now = time.monotonic()
        if now < self.due:
            return
        passed = now - self.began
        self.due = now + min(passed, 300)  # twice the time before
        left = ""
        if share >= 0.05:
            left = f", about {_duration_text(passed / share * (1 - share))} left"
        print(f"{self.what}: {share:.0%} after {_duration_text(passed)}{left}", file=sys.stderr)


def _duration_text(seconds: float) -> str:
    """Write a time as people do: 40 s, 12 min, 3.5 h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"

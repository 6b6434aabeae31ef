"""Progress of a long task."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple


class Progress(NamedTuple):
    """A task reports the share that is done."""

    show: Callable[[float, str], None] = lambda share, what: None
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
"""Time after which a task without a bar prints the share that is done; then every minute."""


@contextmanager
def progress_bar(report: Progress | None, what: str) -> Iterator[Progress]:
    """Yield the given report, or else one that writes to standard error.

    On a terminal it is a bar with the time left, elsewhere a line at most once a minute.
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
        due = time.monotonic() + FIRST_LINE_SECONDS

        def say(share: float, now: str) -> None:
            nonlocal due
            if time.monotonic() >= due:
                due = time.monotonic() + 60
                print(f"{what}: {share:.0%}", file=sys.stderr)

        yield Progress(say)
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

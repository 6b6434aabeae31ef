"""Progress of a long task."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass


def _nothing(share: float, what: str) -> None:
    """Show nothing."""


@dataclass(frozen=True)
class Report:
    """Where a task says how far it is.

    Parameters
    ----------
    show : callable
        Called with the share of the whole work that is done, 0 to 1, and what is being done; the
        words are empty where the task has none.
    begin, end : float
        Part of the whole work that this task is.

    Examples
    --------
    >>> report = Report(lambda share, what: print(f"{share:.2f}", what))
    >>> report(0.5, "halfway")
    0.50 halfway
    >>> report.part(0.5, 1.0)(0.5, "the second half")
    0.75 the second half
    """

    show: Callable[[float, str], None] = _nothing
    begin: float = 0.0
    end: float = 1.0

    def __call__(self, share: float, what: str = "") -> None:
        """Say that a share of this task is done, 0 to 1, and what is being done."""
        self.show(self.begin + share * (self.end - self.begin), what)

    def part(self, begin: float, end: float) -> "Report":
        """Report of a part of this task, from one share of it to another."""
        span = self.end - self.begin
        return Report(self.show, self.begin + begin * span, self.begin + end * span)


SILENT = Report()
"""Shows nothing."""


@contextmanager
def terminal_bar(what: str, hidden: bool = False) -> Iterator[Report]:
    """Progress bar with the time left on standard error, where that is a terminal.

    Parameters
    ----------
    what : str
        Words before the bar, where the task has none.
    hidden : bool
        Show no bar on a terminal either.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.progress import TimeRemainingColumn as TimeLeft

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeLeft())
    console = Console(stderr=True)
    hidden = hidden or not console.is_terminal
    with Progress(*columns, console=console, disable=hidden, transient=True) as bar:
        task = bar.add_task(what, total=1.0)
        yield Report(lambda share, now: bar.update(task, completed=share, description=now or what))


@contextmanager
def shown(report: Report | None, what: str) -> Iterator[Report]:
    """The report of a task that was given one, else a bar where a terminal is attached.

    Parameters as for `terminal_bar`.
    """
    if report is not None:
        yield report
        return
    with terminal_bar(what) as bar:
        yield bar

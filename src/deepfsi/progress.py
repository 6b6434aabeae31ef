"""Progress of a long task."""

from collections.abc import Callable
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

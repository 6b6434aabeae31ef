"""When a task that a benchmark times reached its shares."""

import time
from itertools import pairwise

from deepfsi.base.progress import Progress


class Moments:
    """Moments at which a task reached its shares, as its `report` told."""

    def __init__(self) -> None:
        self._seen: list[tuple[float, float]] = []
        self.report = Progress(lambda share, what: self._seen.append((share, time.perf_counter())))

    def reached(self, share: float) -> float:
        """Moment, s, at which the task first was that far."""
        return next(when for done, when in self._seen if done >= share - 1e-9)

    def epochs(self, count: int) -> list[float]:
        """Seconds of each of the epochs that the task had."""
        ends = [self.reached(epoch / count) for epoch in range(count + 1)]
        return [stop - start for start, stop in pairwise(ends)]

"""Waiting for something that must happen, at any load."""

import time
from collections.abc import Callable

PATIENCE = 120
"""Seconds after which something that must happen, at any load, has not."""


def until(happened: Callable[[], object]) -> None:
    """Wait for a condition."""
    deadline = time.monotonic() + PATIENCE
    while not happened():
        assert time.monotonic() < deadline
        time.sleep(0.005)

"""A disk that is nearly full, as a plain user has one: no file grows beyond a limit."""

import contextlib
import resource


@contextlib.contextmanager
def nearly_full(largest):
    """Let files of this process grow to so many bytes; a write beyond takes a part, then fails."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)

"""Worker processes: one that is killed is told, and none runs the caller's script again."""

import multiprocessing
import os
import signal
import subprocess
import sys

import pytest

from deepfsi.base.errors import InputError
from deepfsi.sweeps.workers import processes
from shared.waiting import PATIENCE


def end(_: None, number: int) -> None:
    os.kill(os.getpid(), number)


@pytest.mark.slow
def test_a_worker_that_is_killed_is_told():
    with pytest.raises(InputError, match="one of 2 worker processes was killed"):
        list(processes(end, None, [signal.SIGKILL], 2))
    assert not multiprocessing.active_children()


SCRIPT = """
from operator import add
from deepfsi.sweeps.workers import processes
print("once", sorted(processes(add, 10, [1, 2, 3], 1)), flush=True)
"""


def test_workers_do_not_run_a_script_again_that_has_no_main_guard():
    """From standard input, where there is not even a file to run."""
    words = {"input": SCRIPT, "capture_output": True, "text": True, "timeout": PATIENCE}
    done = subprocess.run([sys.executable, "-"], check=False, **words)
    assert (done.stdout, done.stderr) == ("once [11, 12, 13]\n", "")

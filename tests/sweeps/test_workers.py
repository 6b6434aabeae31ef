"""Worker processes say how far they are."""

import multiprocessing
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from deepfsi.base.errors import InputError
from deepfsi.sweeps.workers import processes, report_of_task
from shared.waiting import PATIENCE, until


def halfway(folder: Path, task: int) -> int:
    """Say that half is done, and wait until it was heard; a negative task ends its process."""
    if task < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    report_of_task()(0.5)
    until((folder / str(task)).exists)
    return task


@pytest.mark.slow
def test_shares_of_running_tasks_are_seen_before_one_ends(tmp_path):
    seen = []

    def watch(shares: dict[int, float]) -> None:
        seen.append(dict(shares))
        for place, share in shares.items():
            if share == 0.5:
                (tmp_path / str(10 + place)).touch()

    found = list(processes(halfway, tmp_path, [10, 11, 12], 2, watch))
    assert sorted(found) == [10, 11, 12]
    assert {place for shares in seen for place in shares} == {0, 1, 2}
    assert all(len(shares) <= 2 for shares in seen)


@pytest.mark.slow
def test_a_worker_that_is_killed_is_told(tmp_path):
    with pytest.raises(InputError, match="one of 2 worker processes was killed"):
        list(processes(halfway, tmp_path, [-1], 2))
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

"""A sweep that is killed at random moments, again and again, loses no record and repeats none.

DEEPFSI_KILLS=50 pytest tests/sweeps/test_kills.py kills it more often.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

PATIENCE = 120
"""Seconds after which something that must happen, at any load, has not."""

KILLS = int(os.environ.get("DEEPFSI_KILLS", "3"))
RECIPE = """
designs = ["pca", "deepfsi"]
photons = [1e2, 1e3]
masks = [{masks}]
trials = {trials}
draws = 1
training = {{ epochs = 2, batch = 32 }}
"""


def written(folder: Path) -> dict[Path, tuple[int, int]]:
    """Records with the moment and the inode of their writing."""
    found = {}
    for path in folder.glob("trials/*.json"):
        state = path.stat()
        found[path] = (state.st_mtime_ns, state.st_ino)
    return found


def start(tmp_path: Path, masks: str, trials: int, workers: int = 2) -> subprocess.Popen:
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(RECIPE.format(masks=masks, trials=trials))
    command = [sys.executable, "-m", "deepfsi", "sweep", str(recipe), "--json"]
    command += ["-o", str(tmp_path / "out"), "--workers", str(workers)]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


@pytest.mark.slow
def test_random_kills_lose_no_record_and_repeat_none(tmp_path):
    """Two workers in the process group that is killed; a record is never written twice."""
    masks, trials = ", ".join(map(str, range(1, 9))), max(4, KILLS)
    chance = random.Random(1)
    done: dict[Path, tuple[int, int]] = {}
    for kill in range(KILLS):
        process = start(tmp_path, masks, trials)
        while kill % 5 and written(tmp_path / "out") == done:  # else it may be killed at its start
            assert process.poll() is None, "the sweep ended before it was killed"
            time.sleep(0.005)
        time.sleep(chance.uniform(0, 1.5))
        assert process.poll() is None, "the sweep ended before it was killed: give it more trials"
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        now = written(tmp_path / "out")
        assert {path: now.get(path) for path in done} == done
        for path in now.keys() - done.keys():
            assert json.loads(path.read_text())["test"]
        done = now
    process = start(tmp_path, masks, trials)
    text, errors = process.communicate()
    assert process.returncode == 0, errors.decode()
    now = written(tmp_path / "out")
    assert {path: now.get(path) for path in done} == done
    assert len(now) == 2 * 2 * 8 * trials
    assert sum(point["trials"] for point in json.loads(text)["points"]) == len(now)


def descendants(process: subprocess.Popen) -> list[psutil.Process]:
    return psutil.Process(process.pid).children(recursive=True)


def working(process: subprocess.Popen, folder: Path) -> list[psutil.Process]:
    """Worker processes, once a first record is there."""
    deadline = time.monotonic() + PATIENCE
    while not written(folder):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return descendants(process)


def gone(processes: list[psutil.Process]) -> bool:
    return not psutil.wait_procs(processes, timeout=PATIENCE)[1]


@pytest.mark.slow
def test_workers_die_with_their_parent(tmp_path):
    process = start(tmp_path, "1, 2, 3", 200)
    workers = working(process, tmp_path / "out")
    assert workers
    process.kill()
    process.communicate()
    assert gone(workers)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_stops_at_once_and_keeps_finished_work(tmp_path, workers):
    process = start(tmp_path, "1, 2, 3", 200, workers)
    children = working(process, tmp_path / "out")
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    (line,) = errors.decode().strip().splitlines()
    assert "finished trials are kept" in line
    assert gone(children)
    assert written(tmp_path / "out")


@pytest.mark.slow
def test_a_worker_that_is_killed_is_told(tmp_path):
    process = start(tmp_path, "1, 2, 3", 200)
    children = working(process, tmp_path / "out")
    busiest = max(children, key=lambda child: sum(child.cpu_times()[:2]))
    busiest.kill()
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2
    assert "killed" in errors.decode()
    assert gone(children)

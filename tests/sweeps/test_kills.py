"""A sweep that is killed at random moments, again and again, loses no record and repeats none.

DEEPFSI_KILLS=50 pytest tests/sweeps/test_kills.py kills it more often.
"""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import psutil
import pytest

from shared.trials import left_over, tensors
from shared.waiting import PATIENCE

KILLS = int(os.environ.get("DEEPFSI_KILLS", "2"))
RECIPE = """
designs = ["pca", "deepfsi"]
photons = [1e2, 1e3]
masks = {masks}
trials = {trials}
draws = 1
training = {{ epochs = 2, batch = {batch} }}
"""
MASKS = (1, 2, 3, 4)


def written(folder: Path) -> dict[Path, tuple[int, int]]:
    """Records with the moment and the inode of their writing."""
    states = {path: path.stat() for path in folder.glob("trials/*.json")}
    return {path: (state.st_mtime_ns, state.st_ino) for path, state in states.items()}


def records(folder: Path) -> dict[str, Any]:
    """Content of each record by the name of its file, but for the time that its training took."""
    contents = {path.name: json.loads(path.read_text()) for path in folder.glob("trials/*")}
    for record in contents.values():
        record["info"]["seconds"] = 0.0
    return contents


def sweep(
    tmp_path: Path, trials: int, workers: int, masks: tuple[int, ...] = MASKS, batch: int = 32
) -> list[str]:
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(RECIPE.format(trials=trials, masks=list(masks), batch=batch))
    return ["sweep", str(recipe), "--json", "-o", str(tmp_path / "out"), "--workers", str(workers)]


def start(tmp_path: Path, trials: int, workers: int) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "deepfsi", *sweep(tmp_path, trials, workers)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


@pytest.mark.slow
def test_random_kills_lose_no_record_and_repeat_none(done, tmp_path):
    """One process, or one with two workers, which die with it; a record is never written twice."""
    trials = max(2, KILLS)
    chance = random.Random(1)
    kept: dict[Path, tuple[int, int]] = {}
    for kill in range(KILLS):
        process = start(tmp_path, trials, workers=1 + kill % 2)
        while kill % 5 and written(tmp_path / "out") == kept:  # else it may be killed at its start
            assert process.poll() is None, "the sweep ended before it was killed"
            time.sleep(0.005)
        time.sleep(chance.uniform(0, 0.5))
        assert process.poll() is None, "the sweep ended before it was killed: give it more trials"
        workers = psutil.Process(process.pid).children(recursive=True)
        assert workers or not (kill % 2 and kill % 5)
        process.kill()
        process.communicate()
        assert not psutil.wait_procs(workers, timeout=PATIENCE)[1]
        now = written(tmp_path / "out")
        assert {path: now.get(path) for path in kept} == kept
        for path in now.keys() - kept.keys():
            assert json.loads(path.read_text())["test"]
        kept = now
    text = done(*sweep(tmp_path, trials, workers=1))
    now = written(tmp_path / "out")
    assert {path: now.get(path) for path in kept} == kept
    assert len(now) == 2 * 2 * len(MASKS) * trials
    assert sum(point["trials"] for point in json.loads(text)["points"]) == len(now)
    # a later run removes drafts of a killed process after a day
    assert not [path for path in left_over(tmp_path / "out") if ".draft" not in str(path)]


@pytest.mark.slow
def test_a_kill_while_files_are_written_leaves_nothing_and_changes_no_bit(done, tmp_path):
    """Before the seventh file is moved into its place; the first ones are in theirs.

    Trials that were trained together are kept together: alone one of them rounds otherwise.
    """
    settings = {"trials": 1, "workers": 1, "masks": (1, 2), "batch": 500}
    recipe = sweep(tmp_path, **settings)
    kill = (
        "import os, sys; from deepfsi.cli import run_command_line\n"
        f"real, calls = os.replace, []; sys.argv = ['deepfsi', *{recipe!r}]\n"
        "def replace(*paths):\n"
        "    calls.append(paths); os.kill(os.getpid(), 9) if len(calls) == 7 else None\n"
        "    real(*paths)\n"
        "os.replace = replace; run_command_line()"
    )
    killed = subprocess.run([sys.executable, "-c", kill], capture_output=True)
    assert killed.returncode == -signal.SIGKILL
    assert left_over(tmp_path / "out")
    done(*recipe)
    assert not left_over(tmp_path / "out")
    assert len(written(tmp_path / "out")) == 2 * 2 * 2
    whole = tmp_path / "whole"
    whole.mkdir()
    done(*sweep(whole, **settings))
    for content in (tensors, records):
        assert content(tmp_path / "out") == content(whole / "out")

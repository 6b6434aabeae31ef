"""Ctrl-C and SIGTERM at any moment: one line, exit code 130 or 143, nothing left over.

DEEPFSI_STOPS=100 pytest tests/base/test_interrupts.py tries random ones.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from deepfsi.base import interrupts
from shared.waiting import PATIENCE, until

STOPS = int(os.environ.get("DEEPFSI_STOPS") or 0)

RECIPE = """
designs = ["pca", "deepfsi"]
photons = 1e2
masks = [1, 2, 3, 4]
trials = 200
draws = 1
training = { epochs = 2, batch = 32 }
"""
START = "interrupts.install_handler(); print('armed', flush=True)"
ARMED = f"""
from deepfsi import __main__
from deepfsi.base import interrupts
{START}
interrupts.install_handler = lambda: None
__main__.main()
"""
"""The command line, once Ctrl-C is handled; before, Python itself starts."""
STUBBORN = f"""
import sys, time
from deepfsi.base import interrupts
sys.modules["deepfsi.cli"] = sys  # a command runs
try:
    {START}
    time.sleep(600)
except KeyboardInterrupt:
    print("armed", flush=True)
time.sleep(600)
"""
"""A command that swallows what Ctrl-C raises, once, and goes on."""


def start(code: str, *words: object) -> subprocess.Popen:
    process = subprocess.Popen(
        [sys.executable, "-c", code, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
    )
    assert process.stdout.readline() == "armed\n"
    return process


def sweep(folder: Path) -> subprocess.Popen:
    (folder / "recipe.toml").write_text(RECIPE)
    return start(ARMED, "sweep", folder / "recipe.toml", "-o", folder / "out", "--workers", "2")


def stopped(process: subprocess.Popen, number: int = signal.SIGINT, alone: bool = False) -> None:
    """Send a signal, to the whole group or to the command alone, and wait for its end.

    With one line said, which names finished trials where there are some, and only there.
    """
    folder = Path(process.args[-3])
    before = any(folder.glob("trials/*.json"))
    children = psutil.Process(process.pid).children(recursive=True)
    (os.kill if alone else os.killpg)(process.pid, number)
    _, errors = process.communicate(timeout=PATIENCE)
    assert not psutil.wait_procs(children, timeout=PATIENCE)[1]
    assert process.returncode == 128 + number, errors
    lines = [line for line in errors.splitlines() if line and line[:8] != "trials: "]  # progress
    said = "deepfsi: stopped", "deepfsi: stopped; finished trials are kept, run again to go on"
    assert lines in [[said[1]]] if before else [[each] for each in said], errors
    assert lines == [said[0]] or any(folder.glob("trials/*.json"))


@pytest.mark.slow
def test_a_signal_at_any_moment_says_one_line_and_leaves_at_once(tmp_path):
    """While workers train, as the command begins, and, if asked for, at moments in between."""
    process, began = sweep(tmp_path), time.monotonic()
    until(lambda: list(tmp_path.glob("out/trials/*.json")) or process.poll() is not None)
    span, chance = time.monotonic() - began, random.Random(5)
    moments = [chance.uniform(0, 1.2 * span) for _ in range(STOPS)]
    stopped(process)
    for place, moment in enumerate([0.0, *moments]):
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        process = sweep(tmp_path)
        time.sleep(moment)
        number = (signal.SIGTERM, signal.SIGINT)[place % 2]
        stopped(process, number, alone=number == signal.SIGTERM)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_second_signal_ends_a_command_that_swallows_the_first(number):
    process = start(STUBBORN)
    process.send_signal(number)
    assert process.stdout.readline() == "armed\n"
    process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE)
    assert (process.returncode, errors) == (-number, "")


def test_a_worker_sees_no_signal_while_it_is_started(monkeypatch):
    """What comes meanwhile comes after: a worker whose parent ends then prints a traceback."""
    came, usual = [], {each: signal.getsignal(each) for each in interrupts.STOP_SIGNALS}
    try:
        for number in interrupts.STOP_SIGNALS:
            signal.signal(number, lambda number, frame: came.append(number))
        with interrupts.block_ctrl_c():
            os.kill(os.getpid(), signal.SIGTERM)
            assert not came
        assert came == [signal.SIGTERM]
    finally:
        for number, handler in usual.items():
            signal.signal(number, handler)

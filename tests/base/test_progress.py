"""Progress of long tasks is said within seconds, on a terminal and in a log."""

import os
import pty
import re
import subprocess
import sys

import pytest

from deepfsi.base import progress
from deepfsi.base.progress import terminal_bar
from shared.waiting import until


@pytest.fixture
def until_said(capsys, monkeypatch):
    """Wait until words are written to the log; gives all of it."""
    monkeypatch.setattr(progress, "FIRST_LINE_SECONDS", 0.01)
    said = []

    def wait(words):
        until(lambda: said.append(capsys.readouterr().err) or words in "".join(said))
        return "".join(said)

    return wait


def test_a_log_says_how_far_a_task_is_and_what_is_left(until_said):
    with terminal_bar("plan") as report:
        until_said("plan: 0% after 0 s\n")
        report(0.2, "pca, 3 masks")
        until_said("plan: 20% after 0 s\n")  # of a pace nothing is known yet
        report(0.7)
        said = until_said(" left\n")
    assert re.search(r"^plan: 70% after \d+ s, about \d+ s left\n", said, re.MULTILINE)


def test_the_time_left_is_that_of_the_work_without_its_start(until_said, monkeypatch):
    """A start of 10 s, then 1 % a second: 60 s are left at 40 %, not 75."""
    clock = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    with terminal_bar("plan") as report:
        for clock[0], share in ((10.0, 0.0), (11.0, 0.01), (50.0, 0.4)):
            report(share)
        assert "40% after 50 s, about 60 s left\n" in until_said("left\n")


def test_a_bar_on_a_terminal_shows_the_time_left_however_rarely_work_ends(tmp_path):
    """Two reports, an hour apart by the clock that the bar sees."""
    code = (
        "import time; real, gone = time.monotonic, [0]\n"
        "time.monotonic = lambda: real() + gone[0]\n"
        "from deepfsi.base.progress import terminal_bar\n"
        "with terminal_bar('plan') as report:\n"
        "    report(0.1); gone[0] = 3600; report(0.2, '[a class]'); time.sleep(0.5)\n"
    )
    screen, line = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    subprocess.run([sys.executable, "-c", code], stderr=line, env=environment, check=True)
    os.close(line)
    shown = os.read(screen, 65536).decode()
    os.close(screen)
    assert "[a class]" in shown
    assert re.search(r"\d:\d\d:\d\d \S*\s*\S*\d:\d\d:\d\d", re.sub(r"\x1b\[[\d;?]*\w", "", shown))

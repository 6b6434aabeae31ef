"""Progress of long tasks is said within seconds, on a terminal and in a log."""

import os
import pty
import re
import subprocess
import sys

from deepfsi.base import progress
from deepfsi.base.progress import progress_bar


def test_a_log_says_at_times_how_far_a_task_is(capsys, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    with progress_bar(None, "plan") as report:
        for clock[0], share in ((1.0, 0.01), (2.5, 0.02), (4.0, 0.2), (62.6, 0.5)):
            report(share, "pca, 3 masks")
    said = "plan: 2%\nplan: 50%\n"
    assert capsys.readouterr().err == said


def test_a_bar_on_a_terminal_shows_the_time_left_however_rarely_work_ends(tmp_path):
    """Two reports, an hour apart by the clock that the bar sees."""
    code = (
        "import time; real, gone = time.monotonic, [0]\n"
        "time.monotonic = lambda: real() + gone[0]\n"
        "from deepfsi.base.progress import progress_bar\n"
        "with progress_bar(None, 'plan') as report:\n"
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

"""What a shell, a notebook and a disk put around a command changes nothing that it does."""

import json
import os
import subprocess
import sys

import pytest

from deepfsi.base.errors import InputError
from deepfsi.cli import fields, terminal
from golden.facts import file_of
from shared.disks import nearly_full


def run(words, folder, **streams):
    command = [sys.executable, "-m", "deepfsi", *map(str, words)]
    return subprocess.run(command, cwd=folder, check=False, text=True, **streams)


def test_figures_are_drawn_whatever_matplotlib_is_told(tmp_path):
    """A backend and a LaTeX that are not there, a console of letters alone."""
    (tmp_path / "rc").mkdir()
    (tmp_path / "rc" / "matplotlibrc").write_text("text.usetex: True\nbackend: Qt4Agg\n")
    around = {"MPLBACKEND": "module://no_such_backend", "MATPLOTLIBRC": str(tmp_path / "rc")}
    around |= {"PYTHONIOENCODING": "ascii", "COLUMNS": "nonsense"}
    words = ("show", file_of("single"), "-o", "s.png")
    done = run(words, tmp_path, env=os.environ | around, capture_output=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "s.png").read_bytes().startswith(b"\x89PNG")


def test_a_full_disk_is_said_before_the_work(tmp_path):
    with nearly_full(1000), pytest.raises(InputError, match=r"cannot write to .*: File"):
        fields.Output(new=True).check(tmp_path / "run", False)
    fields.Output(new=True).check(tmp_path / "run", False)
    assert not [*tmp_path.iterdir()]


def test_json_of_a_path_that_is_not_utf_8_can_be_read(capsys):
    content = {"picture": os.fsdecode(b"s\xff.png"), "size": 0.1, "é": "𝄞"}
    terminal.Terminal(True).write(terminal.Outcome(content), "show")
    found = json.loads(capsys.readouterr().out.encode("ascii"))
    assert found == {"schema": "deepfsi.show/1", **content}


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_full_disk_takes_no_output_and_the_exit_code_says_so(tmp_path):
    with open("/dev/full", "w") as full:
        done = run(["--version"], tmp_path, stdout=full, stderr=subprocess.PIPE)
        said = "deepfsi: cannot write the output: No space left on device\n"
        assert (done.returncode, done.stderr) == (2, said)
        assert run(["show", "none"], tmp_path, stdout=subprocess.PIPE, stderr=full).returncode == 2

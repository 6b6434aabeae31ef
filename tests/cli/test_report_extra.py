"""Designs are learned, saved and tested without matplotlib and jinja2; what draws asks for them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from deepfsi.base.plugins import REPORT_MISSING
from shared import lab_pc

HIDE = f"""
import sys
sys.path.insert(0, {str(Path(lab_pc.__file__).parents[1])!r})
from shared.lab_pc import Hidden, run
sys.meta_path.insert(0, Hidden(("matplotlib", "jinja2", "markupsafe")))
"""
LEARN = """
import deepfsi
data = deepfsi.load_dataset("digits")
design = deepfsi.learn(data, photons=1e3, masks=2, training={"epochs": 1, "hidden": (4,)})
design.save("a.safetensors")
[result] = deepfsi.evaluate(deepfsi.Design.load("a.safetensors"), data, 1e3, draws=1)
print("accuracy", result.accuracy)
"""
FEW = "--photons 1e3 --masks 2 --epochs 1 --hidden 4"
COMMANDS = f"""
design {FEW} -o b.safetensors
evaluate b.safetensors --photons 1e3 --draws 1
dmd export b.safetensors --exposure 10ms -o frames
""".strip().splitlines()
DRAWING = f"""
compare {FEW} -o compared
sweep baseline -o swept
report .
page b.safetensors -o page.html
show b.safetensors -o b.png
camera image frames
camera picture counts.npy --masks hadamard-natural -o picture
reproduce list
""".strip().splitlines()


def alone(code: str, folder: Path, stdin: str = "") -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-c", HIDE + code],
        input=stdin, cwd=folder, capture_output=True, text=True, env=dict(os.environ),
    )  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("no-report")


def test_learning_saving_and_testing_draw_nothing(folder):
    done = alone(LEARN, folder)
    assert done.stdout.startswith("accuracy 0."), done.stderr


def test_commands_that_draw_say_what_to_install_before_any_work(folder):
    done = alone("run(sys.stdin.read().splitlines())", folder, "\n".join([*COMMANDS, *DRAWING]))
    exits = [line for line in done.stdout.splitlines() if line.startswith("exit ")]
    codes = {**dict.fromkeys(COMMANDS, 0), **dict.fromkeys(DRAWING, 2)}
    assert exits == [f"exit {code}: {line}" for line, code in codes.items()], done.stderr
    said = [line for line in done.stderr.splitlines() if line.startswith("deepfsi: ")]
    assert said == [f"deepfsi: {REPORT_MISSING}"] * len(DRAWING)
    made = {path.name for path in folder.iterdir()}
    assert made <= {"a.safetensors", "b.safetensors", "frames"}

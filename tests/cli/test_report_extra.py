"""Designs are learned, saved and tested without matplotlib and jinja2; what draws asks for them."""

import subprocess
import sys
from pathlib import Path

from deepfsi.base import registry
from shared import lab_pc

HIDE = f"""
import sys
sys.path.insert(0, {str(Path(lab_pc.__file__).parents[1])!r})
from shared.lab_pc import Hidden, run
sys.meta_path.insert(0, Hidden(("matplotlib", "jinja2", "markupsafe")))
run(sys.stdin.read().splitlines())
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
page b.safetensors -o page.html
show b.safetensors -o b.png
reproduce mnist -o paper
""".strip().splitlines()


def test_learning_and_testing_draw_nothing_and_what_draws_says_what_to_install(tmp_path):
    lines = "\n".join([*COMMANDS, *DRAWING])
    words = [sys.executable, "-c", HIDE]
    done = subprocess.run(words, input=lines, cwd=tmp_path, capture_output=True, text=True)
    exits = [line for line in done.stdout.splitlines() if line.startswith("exit ")]
    codes = {**dict.fromkeys(COMMANDS, 0), **dict.fromkeys(DRAWING, 2)}
    assert exits == [f"exit {code}: {line}" for line, code in codes.items()], done.stderr
    said = [line for line in done.stderr.splitlines() if line.startswith("deepfsi: ")]
    assert said == [f"deepfsi: {registry.REPORT_MISSING}"] * len(DRAWING)
    assert {path.name for path in tmp_path.iterdir()} == {"b.safetensors", "frames"}

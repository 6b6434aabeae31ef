"""What the README shows is run: every block of Python, and every command with all its options."""

import os
import re
import shlex
from pathlib import Path

import pytest

README = (Path(__file__).parent.parent / "README.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
LINES = re.findall(
    r"^(deepfsi (?:sweep|reproduce|report) .*?)(?: +#.*)?$", README, flags=re.MULTILINE
)
CAMERA = re.search(r"## A camera\n.*?```\n(.*?)```", README, flags=re.DOTALL).group(1).splitlines()
COMMANDS = sorted(
    set(re.findall(r"`(deepfsi (?:compare|design|evaluate|show|export) -?[^`]+)`", README))
)
BRIEFLY = {"compare": "--epochs 1 --trials 1 --workers 1", "design": "--epochs 1"}
"""Options that make a command of the README take a moment."""


@pytest.mark.parametrize("block", BLOCKS, ids=range(len(BLOCKS)))
def test_python(block, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(block.replace('"mnist"', '"digits"').replace("masks=10\n", "masks=10, epochs=2\n"), names)
    if "loss" in names:
        assert names["loss"].item() < 1.0


def test_commands(tmp_path, monkeypatch, done):
    monkeypatch.chdir(tmp_path)
    assert len(COMMANDS) == 7
    for command in sorted(COMMANDS, key=lambda line: "design" not in line):
        words = shlex.split(command.replace("mnist", "digits"))[1:]
        done(*words, *shlex.split(BRIEFLY.get(words[0], "")))
    assert (tmp_path / "runs/digits/report.html").stat().st_size > 10_000
    assert (tmp_path / "masks.png").stat().st_size > 1000


def test_a_camera_by_files_alone(tmp_path, monkeypatch, done):
    """The README's lines, word for word: at 1e5 photons all ten digits but one or two are right."""
    monkeypatch.chdir(tmp_path)
    printed = {line.split()[2]: done(*shlex.split(line)[1:]) for line in CAMERA}
    right = re.search(r"right: (\d+) of 10 exposures", printed["classify"])
    assert int(right.group(1)) >= 8
    assert "Generic T2" in printed["inspect"]


@pytest.mark.slow
def test_lines_of_sweeps_and_experiments(tmp_path, monkeypatch, done):
    """On digits, small, in one process; the cluster's line is for `test_cluster`."""
    from deepfsi.experiments import experiment
    from shared.experiments import EVERY, tiny

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    recipes = {each.name: tiny(each, 1) for each in EVERY}
    monkeypatch.setattr(experiment.Experiment, "recipes", lambda self, *_: recipes[self.name])
    monkeypatch.setattr("deepfsi.cli.recipes.SHIPPED", tmp_path / "recipes")
    (tmp_path / "recipes").mkdir()
    (tmp_path / "recipes/mnist.toml").write_text(
        'designs = ["pca"]\nphotons = [1e2, 1e4]\nmasks = 3\n[quick]\ntraining.epochs = 1\n'
    )
    lines = [line for line in LINES if "--ray" not in line]
    assert len(lines) == len(LINES) - 1 == 5
    for line in lines:
        done(*shlex.split(line)[1:])
    for made in ("runs/quick/report.html", "runs/quick.csv", "runs/paper/report.html"):
        assert (tmp_path / made).stat().st_size > 100

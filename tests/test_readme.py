"""What the README shows is run: every block of Python, and every command with all its options."""

import os
import re
import shlex
from dataclasses import replace
from pathlib import Path

import pytest

from deepfsi.datasets import idx

README = (Path(__file__).parent.parent / "README.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
COMMANDS = [
    table or line.split("  #")[0].strip()
    for table, line in re.findall(
        r"^\| `(deepfsi [^`]+)` \||^(deepfsi .+)$", README, flags=re.MULTILINE
    )
]
"""Every command line that is shown, in order."""

BRIEFLY = {
    "compare": "--epochs 1 --trials 1 --designs pca,deepfsi",
    "design": "--epochs 1",
    "plan": "--epochs 1 --trials 1 --masks 3 --designs pca,deepfsi",
}
"""Options that make a command on MNIST take a moment."""


@pytest.mark.parametrize("block", BLOCKS, ids=range(len(BLOCKS)))
def test_python(block, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(block.replace('"mnist"', '"digits"').replace("masks=10\n", "masks=10, epochs=2\n"), names)
    if "loss" in names:
        assert names["loss"].item() < 1.0


def test_no_line_is_left_out():
    words = {line.split()[1] for line in COMMANDS}
    assert len(COMMANDS) == 13 + 9 + 5 + 3 + 3
    assert words == {
        *("compare", "design", "evaluate", "show", "stop", "plan", "export", "sweep"),
        *("reproduce", "report", "dmd", "camera", "data"),
    }


@pytest.mark.slow
def test_all_lines_in_order_in_one_folder(tmp_path, monkeypatch, done, digits):
    """Word for word; MNIST is small here, what trains on it is told to be brief, and its study
    is the shortest experiment of it.

    The camera's own lines are on digits and whole: all ten but one or two are right at 1e5 photons.
    The cluster's line is for `test_cluster`.
    """
    from deepfsi import experiments
    from deepfsi.experiments import experiment
    from deepfsi.experiments.mnist import starts
    from shared.experiments import tiny

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    monkeypatch.setattr(idx, "load_idx", lambda name, _: replace(digits, name=name))
    recipes = tiny(starts.EXPERIMENT, 1)
    monkeypatch.setitem(experiments.STUDIES, "mnist", (starts.EXPERIMENT,))
    monkeypatch.setattr(experiment.Experiment, "recipes", lambda *_: recipes)
    monkeypatch.setattr("deepfsi.cli.recipes.SHIPPED", tmp_path / "recipes")
    (tmp_path / "recipes").mkdir()
    (tmp_path / "recipes/mnist.toml").write_text(
        'designs = ["pca"]\nphotons = [1e2, 1e4]\nmasks = 3\n[quick]\ntraining.epochs = 1\n'
    )
    printed = {}
    for line in COMMANDS:
        if "--ray" in line:
            continue
        words = shlex.split(line)[1:]
        brief = BRIEFLY.get(words[0], "") if "mnist" in words else ""
        small = [word.replace("10000", "300") for word in words]
        name = " ".join(words[:2]) + " of a live run" * (words[-1] == "run_0002/")
        printed[name] = done(*small, *brief.split())
    right = re.search(r"right: (\d+) of 10 exposures", printed["camera classify"])
    assert int(right.group(1)) >= 8
    live = printed["camera live of a live run"].splitlines()
    assert len([line for line in live if "confidence" in line]) == 200
    assert "bit for bit: 200 of 200 scenes" in printed["camera classify of a live run"]
    assert "Generic T2" in printed["camera inspect"]
    assert "cost in light" not in printed["dmd export"]
    for made in ("mnist/report.html", "quick.csv", "paper/report.html", "plan/plan.json"):
        assert (tmp_path / "runs" / made).stat().st_size > 100
    assert (tmp_path / "masks.png").stat().st_size > 1000

"""Every command reports as JSON, with a schema that names the command."""

import json
import shlex
from pathlib import Path

import pytest
import typer

from deepfsi.cli import app
from deepfsi.cli.common import JSON_SCHEMA
from shared.experiments import EVERY, tiny

pytestmark = pytest.mark.usefixtures("undrawn")

TINY = "--designs pca --photons 1e3 --masks 3 --epochs 1 --trials 1 --workers 1"
STEPS = {
    "design": "--photons 1e4 --masks 4 --light free-dwell --rails single --epochs 1 "
    "-o one.safetensors",
    "evaluate": "one.safetensors --photons 1e3",
    "show": "one.safetensors -o masks.png",
    "page": "one.safetensors -o page.html",
    "export": "one.safetensors",
    "stop": "looks.safetensors --photons 1e4 --hold-out 300 --draws 1",
    "compare": f"{TINY} -o runs/compare",
    "sweep": "own.toml --workers 1 -o runs/sweep",
    "report": "runs/sweep",
    "plan": "--target 0.3 --designs pca --masks 3 --epochs 1 --trials 1 --workers 1 "
    "--photons 1e2,1e3,1e4 -o runs/plan",
    "reproduce": "mlgauss --workers 1 -o runs/paper",
    "data list": "",
    "data download": "mnist",
    "data check": "digits",
    "data export": "digits -o images",
    "predict": "one.safetensors images --photons 1e4",
    "dmd export": "one.safetensors --device 64x64 -o patterns",
    "dmd check": "patterns",
    "dmd devices": "",
    "camera describe": "one.safetensors",
    "camera prepare": "patterns --scenes images -o lab",
    "camera simulate": "patterns --scene images --flux 1e7 --exposure 2ms --virtual ideal -o run",
    "camera record": "patterns --scene images --flux 1e7 --exposure 2ms --virtual ideal -o shown",
    "camera count": "run",
    "camera classify": "one.safetensors run",
    "camera image": "run",
    "camera live": "looks --scene images --flux 1e7 --exposure 2ms --virtual ideal -o live",
    "camera inspect": "run/photons.ptu",
}
"""Words after each command, in an order in which each finds what it needs."""

ELSEWHERE = {
    *("camera spots", "camera calibrate", "camera check", "camera import"),
    *("camera transits", "camera picture", "camera scan", "mask", "designs make"),
    *("designs list", "readouts"),
}
"""Commands whose JSON is tested with calibrations, the reference target, other counters, scenes
that pass and published designs."""


def commands(group: typer.core.TyperGroup, before: str = "") -> dict[str, typer.core.TyperCommand]:
    found = {}
    for name, command in group.commands.items():
        path = f"{before} {name}".strip()
        found |= commands(command, path) if hasattr(command, "commands") else {path: command}
    return found


EVERY_COMMAND = commands(typer.main.get_command(app))


@pytest.mark.parametrize("path", EVERY_COMMAND)
def test_every_command_takes_json(path):
    assert "--json" in {name for option in EVERY_COMMAND[path].params for name in option.opts}


@pytest.mark.slow
def test_every_command_reports_with_its_schema(done, tmp_path, monkeypatch):
    from deepfsi_paper import experiment

    assert set(STEPS) | ELSEWHERE == set(EVERY_COMMAND)
    monkeypatch.chdir(tmp_path)
    recipes = {each.name: tiny(each, 1) for each in EVERY}
    monkeypatch.setattr(experiment.Experiment, "recipes", lambda self, *_: recipes[self.name])
    monkeypatch.setattr("deepfsi.datasets.download", lambda name: Path("there") / name)
    Path("own.toml").write_text('designs = "pca"\nphotons = 1e3\nmasks = 3\ntraining.epochs = 1')
    one_dmd = "--light free-dwell --rails single --levels 2 --looks 2 --hold-out 300"
    looks = f"design --photons 1e4 --masks 6 {one_dmd} --epochs 1 -o looks.safetensors"
    done(*shlex.split(looks))
    done(*shlex.split("dmd export looks.safetensors --device 64x64 -o looks"))
    for path, words in STEPS.items():
        told = json.loads(done(*path.split(), *shlex.split(words), "--json"))
        assert next(iter(told)) == "schema"
        assert told["schema"] == f"deepfsi.{path.replace(' ', '.')}/{JSON_SCHEMA}"
        assert len(told) > 1
    for words, schema in (
        ("reproduce list", "reproduce.list"),
        ("sweep own.toml --dry-run", "sweep.forecast"),
    ):
        told = json.loads(done(*words.split(), "--json"))
        assert told["schema"] == f"deepfsi.{schema}/{JSON_SCHEMA}"


def test_figures_of_classes_stand_beside_their_names(done, made, tmp_path):
    file = made("deepfsi", "column", "dual").save(tmp_path / "one.safetensors")
    for result in json.loads(done("evaluate", file, "--photons", "1e2,1e4", "--json"))["results"]:
        assert result["classes"] == [str(digit) for digit in range(10)]
        assert len(result["rates"]) == len(result["confusion"]) == 10

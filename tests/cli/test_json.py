"""Every command reports as JSON, with a schema that names the command."""

import json

import pytest
import typer

from deepfsi.cli import app

pytestmark = pytest.mark.usefixtures("undrawn")


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


def test_figures_of_classes_stand_beside_their_names(done, made, tmp_path):
    file = made("deepfsi", "column", "dual").save(tmp_path / "one.safetensors")
    for result in json.loads(done("evaluate", file, "--photons", "1e2,1e4", "--json"))["results"]:
        assert result["classes"] == [str(digit) for digit in range(10)]
        assert len(result["rates"]) == len(result["confusion"]) == 10

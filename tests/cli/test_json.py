"""Every command reports as JSON, with a schema that names the command."""

import json

import pytest

from shared.commands import OPTIONS

pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.mark.parametrize("path", OPTIONS)
def test_every_command_takes_json(path):
    assert "--json" in OPTIONS[path]


def test_figures_of_classes_stand_beside_their_names(done, made, tmp_path):
    file = made("deepfsi", "column", "dual").save(tmp_path / "one.safetensors")
    for result in json.loads(done("evaluate", file, "--photons", "1e2,1e4", "--json"))["results"]:
        assert result["classes"] == [str(digit) for digit in range(10)]
        assert len(result["rates"]) == len(result["confusion"]) == 10

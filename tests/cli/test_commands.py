"""The command line: what it prints, and one clear line with exit code 2 for bad input."""

import json
import subprocess
import sys

import numpy as np
import pytest

from deepfsi import Design
from deepfsi.cli import studies
from shared.commands import COMMANDS, OPTIONS


@pytest.mark.parametrize("path", COMMANDS)
def test_every_command_reports_as_json_and_has_help_with_an_example(done, path):
    out = " ".join(done(*path.split(), "--help").split())
    assert "--json" in OPTIONS[path]
    assert f"Example: deepfsi {path}" in out


def test_help_imports_nothing_heavy():
    script = (
        "import sys; sys.argv = ['deepfsi', '--help']\n"
        "from deepfsi.cli import run_command_line\n"
        "try:\n    run_command_line()\nexcept SystemExit:\n    pass\n"
        "heavy = {'torch', 'numpy', 'scipy', 'sklearn', 'matplotlib', 'pydantic', 'PIL'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)


@pytest.mark.parametrize("words", [[], ["camera"], ["dmd"], ["data"]])
def test_without_a_command_its_help_is_printed(done, words):
    assert f"Usage: deepfsi {' '.join(words)}".strip() in " ".join(done(*words).split())


def test_own_masks_are_a_matrix(done, tmp_path):
    masks = np.random.default_rng(0).random((4, 64)) / 4
    source, file = tmp_path / "m.npy", tmp_path / "own.safetensors"
    np.save(source, masks)
    words = ["--matrix", source, "--epochs", 1, "--light", "free-dwell", "-o", file]
    done("design", "--photons", "1e3", *words)
    assert np.allclose(Design.load(file).matrix, masks)


def test_a_recipe_of_the_package_goes_by_its_name_and_a_file_by_its_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mnist").write_text("trials = 7")
    assert studies.read_recipe("mnist")["data"] == "mnist"
    assert studies.read_recipe("./mnist") == {"trials": 7}


@pytest.mark.parametrize("path", COMMANDS)
def test_no_two_options_have_one_name(path):
    names = [name for each in COMMANDS[path].params for name in (each.name, *each.opts[1:])]
    assert len(set(names)) == len(names)


COMPARE = ("compare", "--photons", "1e3", "--trials", 1, "--epochs", 1, "--designs", "pca")


def test_other_settings_in_a_folder_lose_no_training(done, tmp_path):
    """The results are those of the last command; records and designs of others stay."""
    out = tmp_path / "out"
    done(*COMPARE, "--masks", 3, "-o", out)
    before = json.loads((out / "results.json").read_bytes())
    done(*COMPARE, "--masks", 4, "-o", out)
    assert len([*(out / "trials").iterdir()]) == 2
    done(*COMPARE, "--masks", 3, "-o", out)
    again = json.loads((out / "results.json").read_bytes())
    assert again["points"] == before["points"]

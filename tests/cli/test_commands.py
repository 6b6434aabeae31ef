"""The command line: what it prints, and one clear line with exit code 2 for bad input."""

import json
import subprocess
import sys

import numpy as np
import pytest

from deepfsi import Design
from deepfsi.camera.camera import Camera
from deepfsi.cli import studies
from deepfsi.jobs.exposures import exposure_kinds
from deepfsi.jobs.job import SETTING_ALIASES, Job, find_table
from deepfsi.jobs.training import Training
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


def test_a_design_for_a_budget_of_counts(done, tmp_path):
    file = tmp_path / "one.safetensors"
    words = ["design", "--masks", 4, "--epochs", 1, "-o", file]
    made = json.loads(done(*words, "--counts", 30, "--design", "pca", "--json"))
    [test] = made["tests"]
    assert test["photons"] * test["throughput"] == pytest.approx(30, rel=1e-4)
    assert test["counts"] == pytest.approx(30, rel=0.05), "test scenes are no brighter"
    assert f"{test['throughput']:.3f}" in done(*words, "--counts", 30, "--design", "pca", "--force")


@pytest.fixture
def recipe(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text('designs = "pca"\nphotons = [1e2, 1e4]\nmasks = 3\n[training]\nepochs = 1\n')
    return path


def test_a_sweep_writes_its_table(done, recipe, tmp_path):
    words, table = ["sweep", recipe, "-o", tmp_path / "out"], tmp_path / "all.parquet"
    text = done(*words, "--workers", 1, "--table", table)
    assert table.is_file()
    assert str(table) in text.replace("\n", "")


def test_a_recipe_of_the_package_goes_by_its_name_and_a_file_by_its_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mnist").write_text("trials = 7")
    assert studies.read_recipe("mnist")["data"] == "mnist"
    assert studies.read_recipe("./mnist") == {"trials": 7}


def test_a_sweep_by_name(done, tmp_path, monkeypatch):
    """The recipe is found from any folder; what it says is shrunk to a moment."""
    tiny = {"data": "digits", "designs": "pca", "masks": 3, "photons": 1e3, "draws": 1}
    monkeypatch.setattr(studies, "read_toml", lambda file: {**tiny, "training": {"epochs": 1}})
    monkeypatch.chdir(tmp_path)
    done("sweep", "baseline", "--workers", 1)
    assert len(list((tmp_path / "runs" / "sweep" / "trials").iterdir())) == 1


@pytest.mark.parametrize("command", ["design", "compare"])
def test_an_option_of_a_job_has_the_text_of_its_field(command):
    params = COMMANDS[command].params
    names = [option for each in params for option in each.opts]
    assert len(set(names)) == len(names)
    tables = {"": Job, "camera": Camera, "training": Training}
    found = set()
    for each in params:
        table, name = find_table(each.name)
        model = exposure_kinds().get(name) if table == "exposure" else tables[table]
        if name in model.model_fields and each.name != "device":  # which is torch's
            assert each.help.startswith(model.model_fields[name].description)
            found.add(each.name)
    assert {"masks", "camera", "light", "epochs", "cap", *SETTING_ALIASES} <= found

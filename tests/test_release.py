"""The package as a user has it: sdist, wheel of that, installed in an environment of its own."""

import importlib.util
import os
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src"
LIBRARIES = Path(importlib.util.find_spec("torch").origin).parents[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """Environment that holds the wheel of the sdist; libraries are those of the tests."""
    folder = tmp_path_factory.mktemp("package")

    def run(*words: object) -> None:
        subprocess.run([sys.executable, "-m", *words], check=True, capture_output=True)

    run("build", "--no-isolation", "--outdir", folder, ROOT)  # the wheel is made of the sdist
    run("twine", "check", "--strict", *folder.glob("deepfsi-*"))
    [wheel] = folder.glob("*.whl")
    venv.create(folder / "environment")
    python = folder / "environment/bin/python"
    run("pip", "--python", python, "install", "--no-deps", "--no-index", "--quiet", wheel)
    [own] = python.parents[1].glob("lib/*/site-packages")
    (own / "libraries.pth").write_text(f"{LIBRARIES}\n")
    return python.parents[1]


@pytest.mark.slow
def test_a_wheel_of_the_sdist_compares_and_writes_pages(installed, tmp_path):
    def run(*words: str) -> None:
        workers = [] if words[0] == "page" else ["--workers", "1"]
        command = [installed / "bin/deepfsi", *words, *workers, "--json"]
        clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        done = subprocess.run(command, cwd=tmp_path, env=clean, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr

    [own] = installed.glob("lib/*/site-packages")
    files = {each.relative_to(SOURCE) for each in SOURCE.rglob("*.*") if each.suffix != ".pyc"}
    assert {each.relative_to(own) for each in own.rglob("*.*")} >= files
    assert {path.parts[0] for path in files} == {
        "deepfsi",
        "deepfsi_clicks",
        "deepfsi_drivers",
        "deepfsi_flow",
        "deepfsi_paper",
    }
    assert (own / "deepfsi/py.typed").is_file()
    run("compare", "--designs", "pca", "--photons", "1e3", "--masks", "3", "--epochs", "1")
    assert (tmp_path / "runs/compare/report.html").is_file()
    [design] = (tmp_path / "runs/compare/designs").glob("*.safetensors")
    run("page", str(design), "-o", "page.html")
    assert "</script>" in (tmp_path / "page.html").read_text(encoding="utf-8")

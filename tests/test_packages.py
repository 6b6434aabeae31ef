"""Packages beside the core: they can be removed, and the core works without them."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src"
LIGHT = "--exposure 10ms --flux 1e7 --virtual ideal"
CORE = f"""
design --data digits --masks 4 --photons 1e4 --light free-dwell --epochs 1 -o a.safetensors
evaluate a.safetensors --photons 1e4
dmd export a.safetensors --dmd dlp7000 --exposure 10ms -o frames
data export digits --per-class 1 -o images
camera record frames --scene images {LIGHT} -o run
camera classify frames run
"""
LACKS = {
    "design --data digits --design adaptive --masks 8 --photons 600 --light free-dwell"
    " --rails single --noise click -o clicks.safetensors": "install deepfsi again",
    "camera record frames --scene images --projector vialux --counter swabian -o lab": (
        "unknown projector 'vialux'"
    ),
    "mask a.safetensors --pixel 5 -o mask.svg": "No such command 'mask'",
    "reproduce mnist -o paper": "No such command 'reproduce'",
}
"""Commands for which a package is needed, and what is said without it."""

PROGRAM = """
import pkgutil, sys
from importlib import import_module

import click

for package in sys.argv[1:]:
    sys.modules[package] = None  # an editable installation has it on a path of its own
import deepfsi
from deepfsi.base.errors import InputError
from deepfsi.cli.app import app

for module in pkgutil.walk_packages(deepfsi.__path__, "deepfsi."):
    if module.name != "deepfsi.__main__":
        import_module(module.name)
for line in sys.stdin.read().strip().splitlines():
    try:
        app(line.split(), standalone_mode=False)
    except (InputError, click.ClickException) as error:
        print("refused:", error)
"""


@pytest.mark.slow
def test_the_core_works_without_the_packages_beside_it(tmp_path):
    packages = [path.name for path in SOURCE.glob("deepfsi_*")]
    assert len(packages) == len(LACKS)
    shutil.copytree(SOURCE / "deepfsi", tmp_path / "src/deepfsi")
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *packages],
        input=CORE + "\n".join(LACKS),
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path / "src")},
        capture_output=True,
        text=True,
    )
    refusals = [line for line in done.stdout.splitlines() if line.startswith("refused:")]
    assert len(refusals) == len(LACKS), done.stderr
    assert all(words in said for words, said in zip(LACKS.values(), refusals, strict=True))

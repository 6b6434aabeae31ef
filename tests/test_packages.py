"""Packages beside the core: each can be removed, and the core works without it."""

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
dmd export a.safetensors --device dlp7000 --exposure 10ms -o frames
data export digits --per-class 1 -o images
camera record frames --scene images {LIGHT} -o run
camera classify frames run
"""
PROGRAM = """
import pkgutil, sys
from importlib import import_module

import click

sys.modules[sys.argv[1]] = None  # an editable installation has it on a path of its own
import deepfsi
from deepfsi.base.errors import InputError
from deepfsi.cli.app import app

for module in pkgutil.walk_packages(deepfsi.__path__, "deepfsi."):
    if module.name != "deepfsi.__main__":
        import_module(module.name)
*core, lacking = sys.stdin.read().strip().splitlines()
for line in core:
    app(line.split(), standalone_mode=False)
try:
    app(lacking.split(), standalone_mode=False)
except (InputError, click.ClickException) as error:
    print(error)
"""
LACKS = {
    "deepfsi_clicks": (
        "design --data digits --design adaptive --masks 8 --photons 600 --light free-dwell"
        " --rails single --noise click -o clicks.safetensors",
        "install deepfsi again",
    ),
    "deepfsi_drivers": (
        "camera record frames --scene images --projector vialux --counter swabian -o lab",
        "unknown projector 'vialux'",
    ),
    "deepfsi_flow": ("mask a.safetensors --pixel 5 -o mask.svg", "No such command 'mask'"),
    "deepfsi_paper": ("reproduce mnist -o paper", "install deepfsi again"),
}
"""A command for which a package is needed, and what is said without it."""


@pytest.mark.slow
@pytest.mark.parametrize("package", LACKS)
def test_the_core_works_without(package, tmp_path):
    command, refusal = LACKS[package]
    shutil.copytree(SOURCE, tmp_path / "src", ignore=shutil.ignore_patterns(package, "__pycache__"))
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, package],
        input=CORE + command,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path / "src")},
        capture_output=True,
        text=True,
    )
    assert refusal in done.stdout, done.stderr

"""Commands at the camera on a computer that has no torch, and a console of Windows."""

import os
import shutil
import subprocess
import sys

import pytest

import deepfsi
from deepfsi.base import registry
from golden.facts import file_of
from shared import lab_pc

LIGHT = "--flux 1e7 --exposure 3ms --virtual ideal"
COMMANDS = f"""
dmd export raster --size 8x8 -o scan
dmd check scan
data export digits --per-class 1 -o images
camera describe single.safetensors
dmd export single.safetensors --dmd dlp7000 --dwell 1ms -o frames
camera simulate frames --scene images {LIGHT} -o run
camera inspect run/photons.ptu
camera count run
camera count run --json
camera import run/photons.ptu --patterns frames --scenes images --input 1 -o lab
""".strip().splitlines()
DECIDED = "camera classify single.safetensors run"


def test_a_lab_s_computer_shows_and_counts_without_torch(tmp_path):
    shutil.copy(file_of("single"), tmp_path)
    done = subprocess.run(
        [sys.executable, "-X", "warn_default_encoding", lab_pc.__file__],
        input="\n".join([*COMMANDS, DECIDED]),
        cwd=tmp_path,
        capture_output=True,
        text=True,
        encoding="cp1252",
        env={**os.environ, "PYTHONIOENCODING": "cp1252"},
    )
    exits = [line for line in done.stdout.splitlines() if line.startswith("exit ")]
    assert exits == [*(f"exit 0: {line}" for line in COMMANDS), f"exit 2: {DECIDED}"], done.stderr
    assert f"deepfsi: {registry.TORCH_MISSING}" in done.stderr.splitlines()


def test_python_says_what_to_install_where_torch_is_missing(monkeypatch):
    for name in [each for each in sys.modules if each.startswith("deepfsi.training")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(deepfsi.InputError, match=r'pip install "deepfsi\[design\]"'):
        deepfsi.learn  # noqa: B018

"""Whatever is wrong with a command is said before its work, at once, and leaves nothing behind."""

import errno
import json
import os
import re
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

import deepfsi

TEN_MISTAKES = """
data = "digits"
split = "blocks"
designs = ["pca", "hadamrd", "lda"]
photons = [1e3, -1.0]
masks = [3, 100]
trials = 0
colour = "red"
validation = 5000
training.epochs = [1, 0]
exposure.nested = 9
training.lurch = 1
tuned.pac.lr = 1e-3
tuned.pca.lr = -1.0
"""
NAMED = (
    *("a split was given", "'hadamrd'", "photons.1 = -1.0", "100 masks are not allowed"),
    *("trials = 0", "colour", "epochs", "the first 9 of 3 masks", "lurch", "'pac'", "pca: lr"),
)


@pytest.fixture
def no_training(monkeypatch):
    """Fail a test in which anything is trained."""
    from deepfsi.training import learning  # by its path it is not found after it was left out

    def train(*_, **__):
        raise AssertionError("trained before all was checked")

    monkeypatch.setattr("deepfsi.sweeps.run.SweepRun.finish", train)
    monkeypatch.setattr(learning, "learn", train)


@pytest.fixture
def file(tmp_path_factory, made):
    return made("deepfsi", "column", "dual").save(tmp_path_factory.mktemp("d") / "a.safetensors")


@pytest.mark.usefixtures("no_training")
@pytest.mark.parametrize("matrix", [np.ones((4, 64)), np.ones((4, 63)), -np.eye(64)[:4]])
def test_a_matrix_that_cannot_be_is_refused_before_any_training(refuse, tmp_path, matrix):
    np.save(tmp_path / "m.npy", matrix)
    light = ["--rails", "single"] if (matrix < 0).any() else []
    words = ["--designs", "pca", "--masks", 2, "--matrix", tmp_path / "m.npy", *light]
    assert "matrix" in refuse("compare", *words, "-o", tmp_path / "out")


@pytest.mark.usefixtures("no_training")
def test_ten_mistakes_of_a_recipe_are_told_at_once(refuse, tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(TEN_MISTAKES)
    told = refuse("sweep", path, "-o", tmp_path / "out")
    assert [name for name in NAMED if name not in told] == []


@pytest.mark.usefixtures("no_training")
@pytest.mark.parametrize("design", ["pca", "deepfsi"])
def test_a_recipe_of_a_billion_trials_is_refused_with_its_size(refuse, tmp_path, design):
    """Two axes of the training and two of the recipe; none is walked through."""
    path = tmp_path / "vast.toml"
    rates = [1e-3 + 1e-6 * k for k in range(1000)]
    path.write_text(
        f'designs = "{design}"\nmasks = 3\nphotons = {[100.0 + k for k in range(1000)]}\n'
        f"trials = 1000\n[training]\nlr = {rates}\n"
    )
    assert "1000000000 trials" in refuse("sweep", path, "-o", tmp_path / "out")


@pytest.mark.usefixtures("no_training")
@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--noise poisson --dark 5", "poisson noise has no dark counts"),
        ("--train-noise camera --noise none --dark 5", "none noise has no dark counts"),
        ("--looks 2 --noise gaussian --train-noise poisson", "several looks are for photon noise"),
        ("--noise nowhere:noise --train-noise ml_gauss", "nowhere"),
    ],
)
def test_the_noise_of_the_test_is_checked_before_the_training(refuse, tmp_path, words, said):
    out = tmp_path / "d.safetensors"
    assert said in refuse("design", "--photons", "1e3", "--masks", 3, *words.split(), "-o", out)


OUTPUTS = [
    *("compare", "sweep baseline", "reproduce mnist", "plan --target 0.5"),
    *("data export digits", "camera spots", "dmd export FILE"),
    "camera simulate patterns --scene images --flux 1e7 --exposure 1ms",
    "camera calibrate run --spots spots",
    "camera prepare FILE --scenes images",
]
"""Commands that write a folder."""

FILES = {
    "design --photons 1e3 --masks 2": ".safetensors",
    "show FILE": ".png",
    "page FILE": ".html",
    "export FILE": ".onnx",
}
"""Commands that write a file, and the end of its name."""


@pytest.mark.usefixtures("no_training")
@pytest.mark.parametrize("command", OUTPUTS)
def test_a_file_where_a_folder_belongs_is_said_first(refuse, tmp_path, file, command):
    there = tmp_path / "there"
    there.write_text("in the way")
    words = command.replace("FILE", str(file)).split()
    for out in (there, there / "under"):
        assert str(out) in refuse(*words, "-o", out)


@pytest.mark.usefixtures("no_training")
@pytest.mark.parametrize("command", [*OUTPUTS, *FILES])
def test_a_folder_that_is_read_only_is_said_first(refuse, tmp_path, monkeypatch, file, command):
    def refused(*_, dir, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), f"{dir}/tmpw3x")

    monkeypatch.setattr(tempfile, "TemporaryFile", refused)
    out = tmp_path / f"out{FILES.get(command, '')}"
    told = refuse(*command.replace("FILE", str(file)).split(), "-o", out)
    assert f"cannot write to {out}: Read-only file system" in told


@pytest.mark.usefixtures("no_training")
@pytest.mark.parametrize(("command", "end"), FILES.items())
def test_names_of_files_are_not_guessed(refuse, tmp_path, file, command, end):
    words = command.replace("FILE", str(file)).split()
    assert f"end the name in {end}" in refuse(*words, "-o", tmp_path / "digits")
    missing = tmp_path / "missing"
    assert f"there is no folder {missing}" in refuse(*words, "-o", missing / f"digits{end}")
    assert "is a folder" in refuse(*words, "-o", tmp_path)


def test_a_design_without_the_end_of_its_name_is_named(refuse, file):
    assert f"did you mean {file}?" in refuse("evaluate", file.with_suffix(""), "--photons", "1e3")


MISSING = [
    "compare --data none.npz",
    "compare --recipe none.toml",
    "sweep none.toml",
    "report none",
    "plan --target 0.5 --data none.npz",
    "design --photons 1e3 -o d.safetensors --data none.npz",
    "evaluate none.safetensors --photons 1e3",
    "stop none.safetensors --photons 1e3",
    "show none.safetensors -o x.png",
    "page none.safetensors -o x.html",
    "export none.safetensors",
    "dmd export none.safetensors -o patterns",
    "dmd check none",
    "camera simulate none --scene none --flux 1e7 --exposure 1ms -o run",
    "camera count none",
    "camera classify none.safetensors run",
    "camera image none",
    "camera picture none.npy --masks hadamard-natural -o picture",
    "camera inspect none.ptu",
    "camera prepare none --scenes none -o run",
]
"""Commands whose input is not there."""

WITHOUT_TORCH = """
import sys
from deepfsi.cli import run_command_line
sys.modules["torch"] = None  # importing it is now an error
for line in sys.stdin:
    sys.argv = ["deepfsi", *line.split()]
    try:
        run_command_line()
    except SystemExit as stop:
        print(stop.code)
"""


def test_a_missing_file_is_found_before_torch_is_imported(tmp_path):
    lines = "\n".join(MISSING)
    words = [sys.executable, "-c", WITHOUT_TORCH]
    done = subprocess.run(words, cwd=tmp_path, input=lines, capture_output=True, text=True)
    told = done.stderr.splitlines()
    assert done.stdout.split() == ["2"] * len(MISSING), done.stderr
    assert [line for line in told if not line.startswith("deepfsi: ") or "none" not in line] == []
    assert len(told) == len(MISSING)
    assert not list(tmp_path.iterdir())


def test_a_full_disk_names_the_path_and_leaves_nothing(refuse, tmp_path, monkeypatch):
    whole, written = Path.write_bytes, []

    def write(path, content):
        if len(written) == 3:
            whole(path, content[:10])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written.append(path)
        return whole(path, content)

    monkeypatch.setattr(Path, "write_bytes", write)
    out = tmp_path / "images"
    told = refuse("data", "export", "digits", "-o", out)
    assert f"cannot write {out}: No space left on device" in told
    assert len(written) == 3


def test_a_design_whose_header_is_nested_deeply_is_damaged(refuse, file, tmp_path):
    words = json.dumps({"deepfsi": "[" * 100_000 + "]" * 100_000})
    header = f'{{"__metadata__":{words}}}'.encode()
    bad = tmp_path / "deep.safetensors"
    bad.write_bytes(struct.pack("<Q", len(header)) + header)
    assert "deep.safetensors is not a whole" in refuse("evaluate", bad, "--photons", "1e3")


@pytest.mark.parametrize(
    "words",
    [
        "evaluate FILE --photons 1e4 --draws 0",
        "evaluate FILE --photons 1e4 --sigma -1 --noise gaussian",
        "show FILE --count 0 -o m.png",
        "stop FILE --photons 1e4 --threshold 2",
        "compare --photons 1e4 --trials 0 -o OUT",
    ],
)
def test_numbers_beyond_their_bounds_name_the_option(refuse, tmp_path, file, words):
    told = refuse(*words.replace("OUT", str(tmp_path / "out")).replace("FILE", str(file)).split())
    option = re.findall("--[a-z]+ [-0-9]+", words)[-1]
    assert f"{option}: give " in told


@pytest.mark.parametrize(
    "words",
    [
        "camera simulate patterns --scene images --flux 1e6 --exposure 1ms -o OUT --seed=-1",
        "dmd export FILE -o OUT --selection random --seed=-1",
        "data export digits -o OUT --seed=-1",
        "camera spots -o OUT --size 99999999999",
        "camera spots -o OUT --size 8x8x8",
    ],
)
def test_absurd_numbers_are_one_line(refuse, tmp_path, file, words):
    refuse(*words.replace("OUT", str(tmp_path / "out")).replace("FILE", str(file)).split())


@pytest.mark.parametrize("words", [[], ["camera"], ["dmd"], ["data"]])
def test_without_a_command_its_help_is_printed(done, words):
    assert f"Usage: deepfsi {' '.join(words)}".strip() in " ".join(done(*words).split())


def test_the_version_is_printed(done):
    assert done("--version") == f"deepfsi {deepfsi.__version__}\n"


@pytest.mark.parametrize(
    "words",
    [
        "design --photons 1e3 --masks 2 -o OUT.safetensors --epochs",
        "compare -o OUT --epochs",
        "evaluate FILE --photons 1e3 --draws",
    ],
)
def test_work_without_an_end_is_refused(refuse, tmp_path, file, words):
    line = words.replace("OUT", str(tmp_path / "out")).replace("FILE", str(file))
    assert str(10**22) in refuse(*line.split(), 10**22)


@pytest.mark.usefixtures("no_training")
@pytest.mark.parametrize("numbers", ["", ",", "1e3,,1e4", "1e3,"])
def test_an_empty_place_in_a_list_is_not_passed_over(refuse, tmp_path, numbers):
    assert "empty place" in refuse("compare", f"--photons={numbers}", "-o", tmp_path / "out")


@pytest.mark.usefixtures("no_training")
@pytest.mark.parametrize("number", ["inf", "-inf", "nan"])
@pytest.mark.parametrize(
    "command",
    [
        "compare -o OUT --photons",
        "compare -o OUT --ratios",
        "plan -o OUT --target",
        "design --masks 2 -o OUT.safetensors --photons",
        "evaluate FILE --photons",
        "stop FILE --photons",
    ],
)
def test_numbers_are_finite(refuse, tmp_path, file, command, number):
    words = command.replace("OUT", str(tmp_path / "out")).replace("FILE", str(file)).split()
    assert "give a finite number" in refuse(*words[:-1], f"{words[-1]}={number}")

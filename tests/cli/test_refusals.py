"""Whatever is wrong with a command is said before its work, in one line, and leaves nothing."""

import contextlib
import errno
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from golden.facts import INPUTS, file_of, patterns_of, recording

FAST = "--flux 1e7 --exposure 10ms"
REAL = "camera live looks --scene few --exposure 10ms --projector vialux --counter picoquant"
REFUSED = {
    "design": """
        --masks 3 | photons
        --masks 3 --photons 1e4:x | LOW:HIGH
        --masks 3 --photons 1e4:1e3 | span = 0.1
        --masks 2 --photons 1e3 --design adaptive --clusters 400 | 400 clusters of each class are
    """,
    "design --photons 1e3 --masks 3 --design adaptive": """
        --epochs 3 | has no use for --epochs: leave it out
    """,
    "design --photons 1e3 --masks 3": """
        --camera key.toml | key.toml cannot be used at lihgt
        --camera unit.toml | unit.toml cannot be used at exposure
        --design adaptive --masks 2 --cap 3 | the first of 2 looks takes 1.5 of the budget
        --noise nowhere:noise | nowhere
    """,
    "compare": """
        --data mnits | mnist
        --designs pac | pca
        --masks 100 | 64
        --masks 3 --ratios 0.1 | not both
        --ratios nan | --ratios nan: give a finite number
        --photons 1e39 | photons
        --trials 0 | --trials 0: give
        --designs pca --masks 2 --matrix negative.npy --rails single | matrix
        --epochs 10000000000000000000000 | 10000000000000000000000
    """,
    "sweep": """
        nosuch | no recipe at nosuch
        split.toml | digits takes no
        digits.toml | a number of too many digits
        halves.toml | 'random' or 'blocks'
    """,
    "reproduce nosuch": "| unknown experiment 'nosuch'",
    "design --photons 1e4 --masks 3 --light free-dwell --rails single --detectors": """
        9x9 | do not divide scenes of 8x8: give ROWSxCOLUMNS up to 8x8
        99999999999999999999x1 | give ROWSxCOLUMNS such as 2x2
        four | give ROWSxCOLUMNS such as 2x2, a number of bands, or
        none.npy | none.npy
        bright.npy | the detector of each pixel as a whole number
        gap.npy | from 0 without a gap
        tens.npy | give 64 whole numbers
    """,
    "evaluate": """
        a --photons 1e3 | no design file at a: give one
        a.safetensors --photons 1e4 --draws 0 | --draws 0: give
        a.safetensors --photons 1e3 --data small.npz | (8, 8)
    """,
    "predict a.safetensors nosuch --photons 1e4": "| there is nothing at nosuch",
    "dmd nonsense": "| see `deepfsi dmd --help`",
    "dmd export": """
        a.safetensors --dmd nosuch | unknown device 'nosuch'
        a.safetensors --dmd 64x48 --rotate 45 | rotate = 45: give 0, 90, 180 or 270
        a.safetensors --dmd 64x48 --format jpg | unknown format 'jpg'
        a.safetensors --dmd 64x48 --size 8x8 | has its cells and detectors; leave them out
        hadamard --size 16x16 --dmd dlp6500 | 515 frames do not fit dlp6500
        hadamard --size 8x8 --dmd none.toml | is missing: give a TOML file
        hadamard --size 8x8 --dmd broken.toml | is no TOML file
    """,
    "data export": """
        digits --seed -1 | seed
        digits --per-class 5000 | give 1 to 36
    """,
    "camera count run": """
        --exposure 10s | give at most
        --dead-time 1us --dead-time-model nosuch | dead_time_model = 'nosuch'
    """,
    "camera import tags.csv --out out.ptu --unit": """
        0s | a tick of 0.0 s is not allowed
        1e9s | a tick of 1000000000.0 s is not allowed
        2e9s | up to 1e9
    """,
    "camera inspect a.safetensors": "| is not a PTU file",
    "camera calibrate run --spots nosuch": "| no picture at nosuch",
    f"camera live looks --scene few --virtual ideal {FAST}": """
        --projector dlp | unknown projector
        --projector vialux | do not go together
        --until 2 | --until between 0 and 1
        --exposure 1e9s | do not fit
        --flux 1e14 | flux
        --input 40 --input 41 | inputs
    """,
    REAL: """
        | ALP4lib
        --counter picoquant,config=levels.ini | levels.ini
        --projector vialux,trigger=8 | trigger = '8': unexpected keyword argument
        --flux 1e7 | --flux is for virtual devices
        --virtual pmt | --virtual is for virtual devices
        --projector dlpc900 | give one of virtual, vialux
    """,
    "camera live looks --scene few --exposure 10ms": "| --flux",
    f"camera live run/patterns --scene few {FAST}": "| masks are known before",
    "camera import run/photons.ptu": """
        --patterns looks --scenes few | use `deepfsi camera live`
        --patterns run/patterns | give --scenes
    """,
    f"camera simulate clicks --scene few {FAST}": """
        --dead-time 20ns | click noise has no dead time
    """,
    f"camera simulate run/patterns {FAST}": """
        --scene nosuch | no picture at nosuch
        --scene few --virtual eye | unknown camera 'eye'
        --scene few --dark 1e30 | dark = 1e+30: give 1e+12 or less
    """,
}
"""Command line, what follows it, and what the refusal names."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Stored designs, patterns, pictures, a run, and files that cannot be used, by their names."""
    folder = tmp_path_factory.mktemp("inputs")
    shutil.copy(file_of("single"), folder / "a.safetensors")
    shutil.copytree(INPUTS / "few", folder / "few")
    with contextlib.chdir(folder):
        recording("jump", "dual")
        for design, name in (("adaptive", "looks"), ("click", "clicks")):
            Path(patterns_of(design)).rename(name)
    np.savez(folder / "small.npz", x=np.eye(60, 9), y=np.arange(60) % 2)
    arrays = {
        "bright": np.ones((4, 64)),
        "negative": -np.eye(64)[:4],
        "gap": np.arange(64) // 32 * 2,
        "tens": np.zeros(10, int),
    }
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", array)
    (folder / "tags.csv").write_text("1,1\n2,1\n3,8\n")
    texts = {
        "key": 'lihgt = "column"\n',
        "unit": 'exposure = "10 parsec"\n',
        "broken": "columns = 40\nrows = ",
        "split": 'data = "digits"\nsplit = "blocks"\n',
        "halves": 'data = "digits"\nsplit = "halves"\n',
        "digits": f'data = "digits"\nphotons = [0x{"f" * 5000}]\n',
        "capped": 'designs = "deepfsi"\nmasks = 3\nphotons = 1e3\n[exposure]\ncap = 2\n',
    }
    for name, text in texts.items():
        (folder / f"{name}.toml").write_text(text)
    return folder


@pytest.fixture
def no_training(monkeypatch):
    """Fail a test in which anything is trained."""
    from deepfsi.training import learning  # by its path it is not found after it was left out

    def train(*_, **__):
        raise AssertionError("trained before all was checked")

    monkeypatch.setattr("deepfsi.sweeps.run.run_trials", train)
    monkeypatch.setattr(learning, "optimise", train)


pytestmark = pytest.mark.usefixtures("no_training")

OUT = {
    "design": "out.safetensors",
    "show": "out.png",
    "page": "out.html",
    "export": "out.onnx",
    **dict.fromkeys(("compare", "sweep", "reproduce", "dmd export", "data export"), "out"),
    **{f"camera {name}": "out" for name in ("simulate", "record", "live", "import")},
    "camera calibrate": "out",
}
"""What a command writes."""


def written(line):
    """Words of a command line, and the option that says where to."""
    words = line.split()
    if "--out" in words:
        return words
    out = OUT.get(words[0]) or OUT.get(" ".join(words[:2]))
    return [*words, "-o", out] if out else words


@pytest.mark.parametrize(
    ("line", "said"),
    [
        pytest.param(f"{start} {words}", said, id=f"{start} {words}")
        for start, block in REFUSED.items()
        for words, _, said in (row.partition("|") for row in block.strip().splitlines())
    ],
)
def test_what_cannot_be_is_one_line_that_names_it(refuse, monkeypatch, folder, line, said):
    monkeypatch.chdir(folder)
    before = sorted(folder.rglob("*"))
    assert said.strip() in refuse(*written(line))
    assert sorted(folder.rglob("*")) == before


MISTAKES = """
data = "digits"
designs = ["pca", "hadamrd", "lda"]
photons = [1e3, -1.0]
masks = 3
trials = 0
colour = "red"
training.epochs = [1, 0]
exposure.span = 0.5
"""
NAMED = (*("'hadamrd'", "photons.1 = -1.0", "trials = 0", "colour", "epochs", "span = 0.5"),)


def test_mistakes_of_a_recipe_are_told_at_once(refuse, tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(MISTAKES)
    told = refuse("sweep", path, "-o", tmp_path / "out")
    assert [name for name in NAMED if name not in told] == []


FOLDERS = [
    *("compare", "sweep baseline", "reproduce mnist"),
    *("data export digits", "dmd export a.safetensors"),
    "camera simulate looks --scene few --flux 1e7 --exposure 1ms",
    "camera calibrate run --spots spots",
    "camera import run/photons.ptu --patterns a.safetensors --scenes few",
]
"""Commands that write a folder."""

FILES = [
    "design --photons 1e3 --masks 2",
    *(f"{name} a.safetensors" for name in ("show", "page", "export")),
]


@pytest.mark.parametrize("command", FOLDERS)
def test_a_file_where_a_folder_belongs_is_said_first(
    refuse, tmp_path, monkeypatch, folder, command
):
    monkeypatch.chdir(folder)
    there = tmp_path / "there"
    there.write_text("in the way")
    for out in (there, there / "under"):
        assert str(out) in refuse(*command.split(), "-o", out)


@pytest.mark.parametrize("command", [*FOLDERS, *FILES])
def test_a_folder_that_is_read_only_is_said_first(refuse, tmp_path, monkeypatch, folder, command):
    def refused(*_, dir, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), f"{dir}/tmpw3x")

    monkeypatch.setattr(tempfile, "TemporaryFile", refused)
    monkeypatch.chdir(folder)
    out = tmp_path / written(command)[-1]
    told = refuse(*command.split(), "-o", out)
    assert f"cannot write to {out}: Read-only file system" in told


@pytest.mark.parametrize("command", FILES)
def test_names_of_files_are_not_guessed(refuse, tmp_path, monkeypatch, folder, command):
    monkeypatch.chdir(folder)
    out = written(command)[-1]
    end = Path(out).suffix
    assert f"end the name in {end}" in refuse(*command.split(), "-o", tmp_path / "digits")


@pytest.mark.parametrize("command", FILES)
def test_a_file_is_replaced_with_force_only(call, refuse, tmp_path, monkeypatch, folder, command):
    monkeypatch.chdir(folder)
    out = tmp_path / written(command)[-1]
    out.write_text("mine")
    told = refuse(*command.split(), "-o", out)
    assert f"{out} exists already: give another name, or --force" in told
    assert out.read_text() == "mine"
    if out.suffix == ".png":
        assert call(*command.split(), "-o", out, "--force")[0] == 0
        assert out.read_bytes().startswith(b"\x89PNG")


MISSING = """
compare --data none.npz
sweep none.toml
design --photons 1e3 -o d.safetensors --data none.npz
evaluate none.safetensors --photons 1e3
show none.safetensors -o x.png
page none.safetensors -o x.html
export none.safetensors
dmd export none.safetensors -o patterns
dmd check none
camera simulate none --scene none --flux 1e7 --exposure 1ms -o run
camera count none
camera classify none.safetensors run
camera inspect none.ptu
camera import none --patterns none --scenes none -o run
""".strip()
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
    words = [sys.executable, "-c", WITHOUT_TORCH]
    done = subprocess.run(words, cwd=tmp_path, input=MISSING, capture_output=True, text=True)
    told, count = done.stderr.splitlines(), len(MISSING.splitlines())
    assert done.stdout.split() == ["2"] * count, done.stderr
    assert [line for line in told if not line.startswith("deepfsi: ") or "none" not in line] == []
    assert len(told) == count
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

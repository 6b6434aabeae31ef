"""A camera is described once: a file drives every command as its single options do, bit for bit."""

import json

import numpy as np
import pytest
from safetensors.numpy import load_file

from deepfsi.datasets import write_pictures

FILE = """
light = "free-dwell"        # one DMD, one detector
rails = "single"
detectors = "1x1"
device = "dlp7000"          # levels, shortest picture, mirrors: from the device
exposure = "10ms"
flux = 1e6                  # counts/s, all mirrors ON, mean scene
dark = 200                  # counts/s of a detector
dead_time = "20ns"
"""
OPTICS = ["--light", "free-dwell", "--rails", "single", "--detectors", "1x1", "--dmd", "dlp7000"]
TIMES = ["--exposure", "10ms", "--flux", "1e6", "--dark", "200", "--dead-time", "20ns"]
TRAINED = ["--data", "digits", "--masks", "10", "--epochs", "3", "--hold-out", "0"]


@pytest.fixture(scope="module")
def lab(tmp_path_factory, digits):
    """A camera file, and three scenes."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "my-lab.toml").write_text(FILE)
    firsts = {label: digits.x_test[(digits.y_test == int(label)).argmax()] for label in "037"}
    pictures = {f"{label}/one.png": x.reshape(8, 8) for label, x in firsts.items()}
    write_pictures(pictures, folder / "images")
    return folder


def files_of(folder):
    """Content of the files of a folder that no time of day is in."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.suffix in (".ptu", ".npy", ".csv")
    }


def same_design(one, other):
    first, second = load_file(one), load_file(other)
    assert first.keys() == second.keys()
    assert all(np.array_equal(first[name], second[name]) for name in first)


def test_a_camera_file_drives_a_recorded_run_as_its_options_do(done, lab, tmp_path):
    by_file, by_words = tmp_path / "file.safetensors", tmp_path / "words.safetensors"
    done("design", "--camera", lab / "my-lab.toml", *TRAINED, "-o", by_file)
    done("design", *OPTICS, *TIMES, *TRAINED, "-o", by_words)
    same_design(by_file, by_words)
    found = []
    for design, told in ((by_file, ()), (by_words, TIMES)):
        patterns, run = tmp_path / f"{design.stem}-p", tmp_path / f"{design.stem}-r"
        exported = told and ("--device", "dlp7000", "--exposure", "10ms")
        done("dmd", "export", design, *exported, "-o", patterns)
        done("camera", "simulate", patterns, "--scene", lab / "images", *told, "-o", run)
        done("camera", "count", run, *told[-2:])
        words = ("camera", "classify", design, run, "--force", "--json")
        found.append((files_of(run), json.loads(done(*words))["scenes"]))
    assert found[0] == found[1]
    assert len(found[0][0]) >= 2
    assert [scene["photons"] for scene in found[0][1]] == pytest.approx([1e4] * 3, rel=0.2)


def test_a_camera_file_drives_a_live_run_as_its_options_do(done, lab, tmp_path):
    answers = []
    for name, words in (("file", ["--camera", lab / "my-lab.toml"]), ("words", OPTICS + TIMES)):
        design, run = tmp_path / f"{name}.safetensors", tmp_path / name
        done("design", *words, *TRAINED, "--looks", 2, "-o", design)
        told = [] if name == "file" else TIMES
        done("camera", "live", design, "--scene", lab / "images", *told, "-o", run)
        done("camera", "count", run)
        again = json.loads(done("camera", "classify", design, run, "--json"))
        answers.append((files_of(run), again))
    assert answers[0] == answers[1]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('exposre = "10ms"', "exposre"),
        ('exposure = "10 apples"', "exposure"),
        ('exposure = "20us"', "exposure"),
        ('light = "column"', "device"),
        ('light = "colum"', "light"),
        ("dark = -1", "dark"),
        ('dead_time = "1s"', "dead_time"),
        ('device = "dlp9"', "device"),
        ('detectors = "two"', "detectors"),
        ('noise = "poisson"', "noise"),
        ('rails = "triple"', "rails"),
        ("flux = 'many'", "flux"),
        ("levels = 1", "levels"),
        ("gates = 4", "gates"),
    ],
)
def test_nonsense_in_a_camera_file_is_one_line_with_its_key(refuse, tmp_path, line, said):
    key = line.partition(" ")[0]
    kept = [each for each in FILE.splitlines() if not each.startswith(f"{key} ")]
    file = tmp_path / "my-lab.toml"
    file.write_text("\n".join([*kept, line]))
    words = ["--camera", file, *TRAINED, "-o", tmp_path / "d.safetensors"]
    message = refuse("design", *words)
    assert said in message
    assert not (tmp_path / "d.safetensors").exists()

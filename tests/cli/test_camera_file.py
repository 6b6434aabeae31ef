"""A camera is described once: a file drives every command as its single options do, bit for bit."""

import json

import pytest
from safetensors.numpy import load_file

from deepfsi.datasets.display import write_pictures

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
TRAINED = ["--data", "digits", "--masks", "10", "--epochs", "3"]


@pytest.fixture(scope="module")
def lab(tmp_path_factory, digits):
    """A camera file, and three scenes."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "my-lab.toml").write_text(FILE)
    firsts = {label: digits.x_test[(digits.y_test == int(label)).argmax()] for label in "037"}
    pictures = {f"{label}/one.png": x.reshape(8, 8) for label, x in firsts.items()}
    write_pictures(pictures, folder / "images")
    return folder


def test_a_camera_file_drives_a_run_as_its_options_do(done, lab, tmp_path):
    """The design, its patterns, the photons and the classes."""
    found = []
    for name, camera, told in (
        ("file", ("--camera", lab / "my-lab.toml"), ()),
        ("words", (*OPTICS, *TIMES[:-2]), TIMES),
    ):
        design, patterns, run = tmp_path / f"{name}.safetensors", tmp_path / name, tmp_path / "run"
        done("design", *camera, *TRAINED, "-o", design)
        exported = told and ("--dmd", "dlp7000", "--exposure", "10ms")
        done("dmd", "export", design, *exported, "-o", patterns)
        done("camera", "simulate", patterns, "--scene", lab / "images", *told, "-o", run)
        done("camera", "count", run, *told[-2:])
        classes = json.loads(done("camera", "classify", design, run, "--force", "--json"))
        tensors = {key: one.tobytes() for key, one in load_file(design).items()}
        files = {
            path.relative_to(run).as_posix(): path.read_bytes()
            for path in run.rglob("*")
            if path.suffix in (".ptu", ".npy", ".csv")  # no time of day is in
        }
        found.append((tensors, classes["scenes"], files))
        run.rename(tmp_path / f"{name} run")
    assert found[0] == found[1]
    _, scenes, files = found[0]
    assert len(files) >= 2
    assert [scene["photons"] for scene in scenes] == pytest.approx([1e4] * 3, rel=0.2)

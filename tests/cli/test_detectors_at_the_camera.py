"""A design of several detectors at the virtual camera, from its file to classes."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from conftest import quick
from deepfsi import Design, evaluate
from deepfsi.cli import app
from deepfsi.datasets import write_pictures
from deepfsi.hardware.patterns import read_patterns

PHOTONS = 1e4
SCENES = 120
TRAINING = {"photons": PHOTONS, "epochs": 8, "hidden": (32,), "detectors": "2x2"}


@pytest.fixture(scope="module")
def lab(tmp_path_factory, digits):
    """Patterns of two designs of 2 x 2 detectors, and scenes of the test set."""
    folder = tmp_path_factory.mktemp("several")
    made = {
        "one": quick(digits, masks=4, light="free-dwell", rails="single", **TRAINING),
        "two": quick(digits, masks=4, light="two-arm", rails="dual", **TRAINING),
    }
    shown = zip(digits.x_test[:SCENES], digits.y_test, strict=False)
    pictures = {f"{y}/{k:03}.png": x.reshape(8, 8) for k, (x, y) in enumerate(shown)}
    write_pictures(pictures, folder / "images")
    for name, design in made.items():
        path = design.save(folder / f"{name}.safetensors")
        words = ["dmd", "export", path, "--device", "64x48", "-o", folder / name]
        assert CliRunner().invoke(app, [str(word) for word in words]).exit_code == 0
    return folder


def simulated(done, lab, name, out, *words):
    """Acquisition of all scenes, counted; what `count` said."""
    given = ["--scene", lab / "images", "--flux", 1e7, "--exposure", "1ms", "--repeats", 1]
    done("camera", "simulate", lab / name, *given, "--virtual", "ideal", "-o", out, "--yes", *words)
    return json.loads(done("camera", "count", out, "--json"))


@pytest.mark.parametrize("name", ["one", "two"])
def test_an_acquisition_is_classified_as_the_design_was_tested(done, lab, digits, tmp_path, name):
    said = simulated(done, lab, name, tmp_path / "run")
    rails = 1 if name == "one" else 2
    assert said["inputs"] == list(range(1, 4 * rails + 1))
    assert np.shape(said["counts"]) == (SCENES, 1, rails, 4, 4)
    assert said["faults"] == []
    out = done("camera", "classify", lab / f"{name}.safetensors", tmp_path / "run", "--json")
    told = json.loads(out)
    assert told["consistency"]["whole"] > told["consistency"]["false_alarms"]
    right = np.mean([each["class"] == each["label"] for each in told["scenes"]])
    design = Design.load(lab / f"{name}.safetensors")
    design = design.as_shown(*read_patterns(lab / name).realised)
    same = replace(digits, x_test=digits.x_test[:SCENES], y_test=digits.y_test[:SCENES])
    [tested] = evaluate(design, same, PHOTONS)
    assert tested.low <= right <= tested.high
    assert tested.accuracy > 0.5


def test_swapped_inputs_are_not_what_the_design_was_trained_for(done, refuse, lab, tmp_path):
    """Of detectors whose parts are unlike each other."""
    simulated(done, lab, "one", tmp_path / "run")
    swapped = [word for each in (2, 3, 4, 1) for word in ("--input", each)]
    done("camera", "count", tmp_path / "run", *swapped)
    words = ["camera", "classify", lab / "one.safetensors", tmp_path / "run"]
    assert "not look like what this design was trained for" in refuse(*words)


def test_inputs_are_one_for_each_detector(done, refuse, lab, tmp_path):
    inputs = [word for each in (5, 3, 4, 2) for word in ("--input", each)]
    said = simulated(done, lab, "one", tmp_path / "run", *inputs)
    assert said["inputs"] == [5, 3, 4, 2]
    done("camera", "image", tmp_path / "run")
    with Image.open(tmp_path / "run" / "picture.png") as picture:
        assert picture.width > 200
    one = ["camera", "prepare", lab / "two", "--scenes", lab / "images", "-o", tmp_path / "lab"]
    assert "3 inputs, and its patterns need 8" in refuse(*one, *inputs[:6])
    assert "input 1 to 8" in done(*one)


def test_a_calibration_tells_a_design_which_detector_sees_what(done, refuse, tmp_path):
    """Spots to a map of cells, a design for it, and its patterns on the same camera."""
    camera = tmp_path / "camera.toml"
    camera.write_text("detectors = [[3, 0], [1, 2]]\ndark = 100.0\n")
    scan, spots, run = (tmp_path / name for name in ("scan", "spots", "run"))
    words = ["--size", "8x8", "--device", "64x48", "--detectors", 4, "-o", scan]
    done("dmd", "export", "hadamard", *words)
    done("camera", "spots", "--size", "16x16", "-o", spots)
    given = ["--scene", spots, "--flux", 6e6, "--exposure", "100ms", "--virtual", camera, "-o", run]
    done("camera", "simulate", scan, *given)
    done("camera", "count", run)
    out = tmp_path / "calibration"
    told = json.loads(done("camera", "calibrate", run, "--spots", spots, "-o", out, "--json"))
    found = out / "detectors.npy"
    assert told["detectors"] == str(found)
    tiles = np.kron([[3, 0], [1, 2]], np.ones((4, 4), int))
    assert np.array_equal(np.load(found), tiles)

    path = tmp_path / "design.safetensors"
    words = ["--masks", 2, "--light", "free-dwell", "--rails", "single", "--epochs", 1]
    done("design", "--data", "digits", *words, "--photons", 1e4, "--detectors", found, "-o", path)
    done("dmd", "export", path, "--device", "64x48", "-o", tmp_path / "frames")
    manifest = read_patterns(tmp_path / "frames").manifest
    assert manifest.detectors.cells == tuple(tiles.ravel().tolist())
    three = tmp_path / "three.toml"
    three.write_text("detectors = [[0, 1, 2]]")
    given = ["--scene", spots, "--flux", 1e6, "--exposure", "1ms", "--virtual", three]
    said = refuse("camera", "simulate", tmp_path / "frames", *given, "-o", tmp_path / "other")
    assert "the camera has 3 detectors, and the patterns are for 4" in said


def test_a_design_has_detectors_of_its_own(refuse, lab, tmp_path):
    words = ["dmd", "export", lab / "one.safetensors", "--detectors", 4, "-o", tmp_path / "p"]
    assert "has the detectors of its design; leave it out" in refuse(*words)

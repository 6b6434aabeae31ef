"""A design of several detectors at the virtual camera, from its file to classes."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from conftest import quick
from deepfsi import Design, evaluate
from deepfsi.cli import app
from deepfsi.datasets.display import write_pictures
from deepfsi.patterns.folder import Patterns

SCENES = 120
TRAINING = {"masks": 4, "photons": 1e4, "epochs": 8, "hidden": (32,), "detectors": "2x2"}
RAILS = {"one": 1, "two": 2}
"""Of two designs: of one arm, and of two."""


@pytest.fixture(scope="module")
def lab(tmp_path_factory, digits):
    """Patterns of two designs of 2 x 2 detectors, and scenes of the test set."""
    folder = tmp_path_factory.mktemp("several")
    made = {
        "one": quick(digits, light="free-dwell", rails="single", **TRAINING),
        "two": quick(digits, light="two-arm", rails="dual", **TRAINING),
    }
    shown = zip(digits.x_test[:SCENES], digits.y_test, strict=False)
    pictures = {f"{y}/{k:03}.png": x.reshape(8, 8) for k, (x, y) in enumerate(shown)}
    write_pictures(pictures, folder / "images")
    for name, design in made.items():
        path = design.save(folder / f"{name}.safetensors")
        words = ["dmd", "export", path, "--dmd", "64x48", "-o", folder / name]
        assert CliRunner().invoke(app, [str(word) for word in words]).exit_code == 0
    return folder


@pytest.mark.parametrize("name", RAILS)
def test_an_acquisition_is_classified_as_the_design_was_tested(
    done, refuse, lab, digits, tmp_path, name
):
    """Inputs that are swapped are not what the design of unlike detectors was trained for."""
    rails, run = RAILS[name], tmp_path / "run"
    given = ["--scene", lab / "images", "--flux", 1e7, "--exposure", "1ms", "--repeats", 1]
    done("camera", "simulate", lab / name, *given, "--virtual", "ideal", "-o", run)
    said = json.loads(done("camera", "count", run, "--json"))
    assert said["inputs"] == list(range(1, 4 * rails + 1))
    assert np.shape(said["counts"]) == (SCENES, 1, rails, 4, 4)
    assert said["faults"] == []
    words = ["camera", "classify", lab / f"{name}.safetensors", run]
    told = json.loads(done(*words, "--json"))
    assert sum(each["unlike"] for each in told["scenes"]) <= 1
    right = np.mean([each["class"] == each["label"] for each in told["scenes"]])
    design = Design.load(lab / f"{name}.safetensors")
    design = design.as_shown(*Patterns.read(lab / name).realised)
    same = replace(digits, x_test=digits.x_test[:SCENES], y_test=digits.y_test[:SCENES])
    [tested] = evaluate(design, same, TRAINING["photons"])
    assert tested.low <= right <= tested.high
    assert tested.accuracy > 0.5
    if rails == 1:
        settings = json.loads((run / "acquisition.json").read_text())
        (run / "acquisition.json").write_text(json.dumps(settings | {"inputs": [1, 2, 3, 0]}))
        done("camera", "count", run)
        assert "do not look like those of the training" in refuse(*words)

"""The way of clicks on the command line: from a design to classes, and what photons alone allow."""

import json

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from deepfsi.cli import app
from deepfsi.counting.recording import Recording
from deepfsi.patterns.folder import Patterns

SCENES = 200
PHOTONS = 1500.0
GATES = 4
EXPOSURES = 2
"""Of 25 ms in the frames of a pass."""

CAMERA = """
light = "free-dwell"
rails = "single"
noise = "click"
gates = 4
"""


def say(*words) -> str:
    made = CliRunner().invoke(app, [str(word) for word in words])
    assert made.exit_code == 0, made.output
    return made.stdout


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A design of detectors that click, its patterns and pictures, and a run."""
    folder = tmp_path_factory.mktemp("lab")
    words = ("--photons", PHOTONS, "--masks", 60, "--epochs", 10, "--mask-lr", 0.05)
    (folder / "clicks.toml").write_text(CAMERA)
    words = ("--data", "digits", "--camera", folder / "clicks.toml", *words)
    say("design", *words, "-o", folder / "d.safetensors")
    device = ("--dmd", "64x48", "--dwell", "1ms")
    say("dmd", "export", folder / "d.safetensors", *device, "-o", folder / "p")
    say("data", "export", "digits", "--per-class", SCENES // 10, "-o", folder / "images")
    light = ["--exposure", "25ms", "--flux", PHOTONS / 25e-3]
    words = ["--scene", folder / "images", *light, "-o", folder / "run"]
    say("camera", "simulate", folder / "p", *words)
    say("camera", "count", folder / "run")
    return folder


def test_clicks_are_classified_as_well_as_they_are_evaluated(done, lab):
    """Within five standard errors of both, of one exposure of each scene."""
    scenes = json.loads(done("camera", "classify", lab / "p", lab / "run", "--json"))
    known = [(scene["guesses"][0], scene["label"]) for scene in scenes["scenes"]]
    assert len(known) == SCENES
    right = np.mean([guess == label for guess, label in known])
    [wanted] = json.loads(done("evaluate", lab / "p", "--photons", PHOTONS, "--json"))["results"]
    assert wanted["noise"] == "click"
    p = wanted["accuracy"]
    assert p > 0.4
    assert abs(right - p) < 5 * np.sqrt(p * (1 - p) * (1 / SCENES + 1 / wanted["images"]))
    assert "They are read for the stated budget" in scenes["remarks"][0]


def test_what_is_of_photons_is_refused_for_a_design_of_clicks(done, refuse, lab, tmp_path):
    words = ["camera", "count", lab / "run"]
    assert "no dead time" in refuse(*words, "--dead-time", "20ns")
    Recording.read(lab / "run").count()
    classify = ["camera", "classify", lab / "p"]
    assert f"in photons, and this design reads clicks of {GATES}" in refuse(*classify, lab / "run")
    done(*words)
    frames = len(Patterns.read(lab / "p").manifest.frames)
    np.savetxt(tmp_path / "clicks.csv", np.ones((EXPOSURES, frames)), delimiter=",", fmt="%d")
    classify += [tmp_path / "clicks.csv", "--photons", PHOTONS]
    done(*classify, "--force")
    assert "are of photon counts" in refuse(*classify, "--background", 3)


def test_a_table_of_clicks_is_classified(done, refuse, lab, tmp_path):
    """As the run whose clicks they are."""
    said = json.loads(done("camera", "count", lab / "run", "--json"))
    clicks = np.array(said["counts"])[:, :, 0].reshape(SCENES * EXPOSURES, -1)
    columns = [f"mask{mask}" for mask in range(clicks.shape[1])]
    table = pl.DataFrame(clicks, schema=columns, orient="row")
    table = table.with_columns(scene=np.repeat(np.arange(SCENES), EXPOSURES))
    table.write_csv(tmp_path / "clicks.csv")
    words = ["camera", "classify", lab / "p", tmp_path / "clicks.csv"]
    assert "does not tell its budget" in refuse(*words)
    budget = ["--photons", PHOTONS]
    words += budget
    run = json.loads(done("camera", "classify", lab / "p", lab / "run", *budget, "--json"))
    table = json.loads(done(*words, "--json"))
    assert [each["class"] for each in table["scenes"]] == [each["class"] for each in run["scenes"]]
    for option in (["--background", 3], ["--gain", 2]):
        assert "are of photon counts, and clicks" in refuse(*words, *option)

"""The way of clicks on the command line: from a design to classes, and what photons alone allow."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from deepfsi.cli import app
from deepfsi.hardware.counting import count_run
from deepfsi.hardware.patterns import read_patterns

SCENES = 200
PHOTONS = 1500.0
GATES = 4
EXPOSURES = 2
"""Of 25 ms in the frames of a pass."""


def say(*words) -> str:
    made = CliRunner().invoke(app, [str(word) for word in words])
    assert made.exit_code == 0, made.output
    return made.stdout


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A design of detectors that click, its patterns and pictures; a gated run of them, counted."""
    folder = tmp_path_factory.mktemp("lab")
    say(
        "design", "--data", "digits", "--camera", "dmd", "--rails", "single", "--noise", "click",
        "--gates", GATES, "--photons", PHOTONS, "--masks", 60, "--epochs", 10, "--mask-lr", 0.05,
        "-o", folder / "design.safetensors",
    )  # fmt: skip
    say(
        "dmd", "export", folder / "design.safetensors", "--device", "64x48", "--dwell", "1ms",
        "-o", folder / "patterns",
    )  # fmt: skip
    say("data", "export", "digits", "--per-class", SCENES // 10, "-o", folder / "images")
    say(*simulate(folder), "-o", folder / "run")
    say("camera", "count", folder / "run")
    return folder


def simulate(lab, *words):
    light = ["--exposure", "25ms", "--flux", PHOTONS / 25e-3]
    return ["camera", "simulate", lab / "patterns", "--scene", lab / "images", *light, *words]


def test_clicks_are_classified_as_well_as_they_are_evaluated(done, lab):
    """Within five standard errors of both, of one exposure of each scene."""
    scenes = json.loads(done("camera", "classify", lab / "patterns", lab / "run", "--json"))
    known = [(scene["guesses"][0], scene["label"]) for scene in scenes["scenes"]]
    assert len(known) == SCENES
    right = np.mean([guess == label for guess, label in known])
    words = ["evaluate", lab / "patterns", "--photons", PHOTONS, "--json"]
    [wanted] = json.loads(done(*words))["results"]
    assert wanted["noise"] == "click"
    p = wanted["accuracy"]
    assert p > 0.4
    assert abs(right - p) < 5 * np.sqrt(p * (1 - p) * (1 / SCENES + 1 / wanted["images"]))
    assert "They are read for the stated budget" in scenes["remarks"][0]


def test_the_photon_file_holds_one_photon_of_a_gate_and_count_takes_it_as_it_is(done, lab):
    said = json.loads(done("camera", "count", lab / "run", "--json"))
    manifest = read_patterns(lab / "patterns").manifest
    counts = np.array(said["counts"])
    assert said["gates"] == counts.max() == GATES
    contents = json.loads(done("camera", "inspect", lab / "run" / "photons.ptu", "--json"))
    gates = GATES * (EXPOSURES * len(manifest.shown) + 4)
    held, most = contents["photons"]["1"], SCENES * gates
    assert counts.sum() <= held <= most
    text = done("camera", "count", lab / "run")
    assert f"{counts.sum()} clicks of up to {GATES} a frame counted" in text


def test_a_free_detector_gives_clicks_and_its_budget(done, refuse, lab, tmp_path):
    """The clicks of the gated one: the photons are of the same seed."""
    done(*simulate(lab, "--virtual", "ideal"), "-o", tmp_path / "free")
    free, gated = (
        json.loads(done("camera", "count", run, "--json"))
        for run in (tmp_path / "free", lab / "run")
    )
    assert free["counts"] == gated["counts"]
    assert gated["photons"] == [PHOTONS] * SCENES
    assert free["photons"] == pytest.approx([PHOTONS] * SCENES, rel=0.05)
    assert free["photons"] != gated["photons"]
    words = ["camera", "count", tmp_path / "free"]
    assert "clicks have no dead time" in refuse(*words, "--dead-time", "20ns")
    assert "a background is of photon counts" in refuse(*words, "--background", "0")
    done(*words, "--exposure", "12.5ms")
    said = json.loads(done("camera", "classify", lab / "patterns", tmp_path / "free", "--json"))
    assert said["scenes"][0]["exposures"] == 2 * EXPOSURES


def test_photon_counts_are_not_taken_for_clicks(done, refuse, lab, tmp_path):
    done(*simulate(lab, "--virtual", "ideal"), "-o", tmp_path / "free")
    count_run(tmp_path / "free")
    words = ["camera", "classify", lab / "patterns", tmp_path / "free"]
    assert f"counted in photons, and this design reads clicks of {GATES}" in refuse(*words)


def test_virtual_devices_of_a_run_have_no_gates(refuse, lab, tmp_path):
    (tmp_path / "gated.toml").write_text("gates = 2\n")
    words = ["--exposure", "25ms", "--flux", 1e4, "--virtual", tmp_path / "gated.toml"]
    words = [lab / "patterns", "--scene", lab / "images" / "0", *words]
    assert "leave gates out of its camera" in refuse(
        "camera", "record", *words, "-o", tmp_path / "run"
    )


def test_a_table_of_clicks_is_classified(done, refuse, lab, tmp_path):
    """As the run whose clicks they are."""
    said = json.loads(done("camera", "count", lab / "run", "--json"))
    clicks = np.array(said["counts"])[:, :, 0].reshape(SCENES * EXPOSURES, -1)
    np.savetxt(tmp_path / "clicks.csv", clicks, delimiter=",", fmt="%d")
    words = ["camera", "classify", lab / "patterns", tmp_path / "clicks.csv"]
    words += ["--repeats", EXPOSURES]
    assert "tell the budget: give --photons" in refuse(*words)
    words += ["--photons", PHOTONS]
    run = json.loads(done("camera", "classify", lab / "patterns", lab / "run", "--json"))
    table = json.loads(done(*words, "--json"))
    assert [each["class"] for each in table["scenes"]] == [each["class"] for each in run["scenes"]]
    for option in (["--background", 3], ["--gain", 2]):
        assert "is of photon counts, and this design reads clicks" in refuse(*words, *option)
    assert "clicks have no dead time" in refuse(*words, "--dead-time", "20ns")
    clicks[7, 2] = GATES + 1
    np.savetxt(tmp_path / "clicks.csv", clicks, delimiter=",", fmt="%d")
    assert f"{GATES + 1} counts in mask2 of exposure 8" in refuse(*words)


def test_what_is_of_photons_refuses_a_design_of_clicks(refuse, lab, tmp_path):
    assert "clicks have no dark counts" in refuse(
        *simulate(lab, "--dark", 20), "-o", tmp_path / "a"
    )
    assert "clicks have no dead time" in refuse(
        *simulate(lab, "--dead-time", "20ns"), "-o", tmp_path / "a"
    )
    words = ["--scene", lab / "images", "--exposure", "25ms", "--flux", 1e5, "-o", tmp_path / "a"]
    assert "fixed dwells" in refuse("camera", "live", lab / "patterns", *words)
    assert "counted in clicks" in refuse("camera", "image", lab / "run")
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(("photons", "full"), [(3000, True), (200, False)])
def test_full_gates_are_told_when_a_design_is_learned(done, tmp_path, photons, full):
    """Forty gates of a design for 3000 photons nearly all click, and those for 200 do not."""
    said = done(
        "design", "--data", "digits", "--camera", "dmd", "--rails", "single", "--noise", "click",
        "--gates", 4, "--photons", photons, "--masks", 10, "--epochs", 1,
        "-o", tmp_path / "clicks.safetensors",
    )  # fmt: skip
    assert ("of the gates click, which tells little of a scene" in said) == full

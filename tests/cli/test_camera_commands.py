"""The camera on the command line: what it prints, and one clear line for bad input."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from conftest import quick
from deepfsi import Design, evaluate
from deepfsi.base import InputError
from deepfsi.cli import app
from deepfsi.cli.terminal import Terminal
from deepfsi.datasets import read_display, write_pictures
from deepfsi.hardware.calibration import calibrate_run
from deepfsi.hardware.counting import acquisition, read_counts, read_run
from deepfsi.hardware.patterns import read_patterns
from deepfsi.hardware.pictures import reconstruct


@pytest.fixture(scope="module")
def lab(tmp_path_factory, made, digits):
    """A design and three scenes."""
    folder = tmp_path_factory.mktemp("lab")
    made("deepfsi", "equal-dwell", "dual").save(folder / "design.safetensors")
    firsts = {label: digits.x_test[(digits.y_test == int(label)).argmax()] for label in "037"}
    pictures = {f"{label}/one.png": x.reshape(8, 8) for label, x in firsts.items()}
    write_pictures(pictures, folder / "images")
    return folder


def export(lab, *words):
    return ["dmd", "export", lab / "design.safetensors", "--device", "64x48", *words]


@pytest.fixture(scope="module")
def patterns(lab):
    """Patterns of the design on a small device."""
    words = export(lab, "-o", lab / "patterns")
    assert CliRunner().invoke(app, [str(word) for word in words]).exit_code == 0
    return lab / "patterns"


@pytest.fixture
def run(done, lab, patterns, tmp_path):
    """Counted acquisition of the three scenes."""
    words = ["--scene", lab / "images", "--flux", 1e7, "--exposure", "5ms", "--virtual", "ideal"]
    done("camera", "simulate", patterns, *words, "-o", tmp_path / "run")
    done("camera", "count", tmp_path / "run")
    return tmp_path / "run"


def test_patterns_are_evaluated_as_they_are_realised(done, lab, patterns, digits):
    out = done("evaluate", patterns, "--photons", "1e4", "--json")
    design = Design.load(lab / "design.safetensors").as_shown(*read_patterns(patterns).realised)
    expected = evaluate(design, digits, 1e4)[0].accuracy
    assert json.loads(out)["results"][0]["accuracy"] == expected


def test_a_dimmed_design_reads_its_own_counts(made, tmp_path, done):
    """One device shows a column design with less light: as if at so much smaller a budget."""
    column = made("deepfsi", "column", "dual")
    column.save(tmp_path / "column.safetensors")
    out = done(
        "dmd", "export", tmp_path / "column.safetensors", "--device", "64x48", "-o", tmp_path / "p"
    )
    assert "cost" in out
    patterns = read_patterns(tmp_path / "p")
    dimmed = patterns.manifest.dimmed
    shown = column.as_shown(*patterns.realised)
    counts = np.full((1, 2, column.masks), 30.0)
    np.testing.assert_allclose(
        shown.classify(counts, 1e4), column.classify(counts, 1e4 * dimmed), rtol=1e-4, atol=1e-6
    )
    light = [each.rails.total.sum() for each in (shown, column)]
    np.testing.assert_allclose(light[0], dimmed * light[1], rtol=0.01)


@pytest.fixture
def other_run(done, made, lab, run, digits, tmp_path):
    """The acquisition with the photons of another design, shown on the same schedule."""
    other = quick(digits, "random", light="equal-dwell")
    other.save(tmp_path / "random.safetensors")
    words = ["--device", "64x48", "-o", tmp_path / "random"]
    done("dmd", "export", tmp_path / "random.safetensors", *words)
    words = ["--scene", lab / "images", "--flux", 1e7, "--exposure", "5ms", "--virtual", "ideal"]
    done("camera", "simulate", tmp_path / "random", *words, "-o", tmp_path / "theirs")
    shutil.copy(tmp_path / "theirs" / "photons.ptu", run / "photons.ptu")
    done("camera", "count", run)
    return run


def test_counts_of_another_design_are_refused_unless_forced(refuse, done, lab, other_run):
    words = ["camera", "classify", lab / "design.safetensors", other_run]
    assert "do not look like what this design was trained for" in refuse(*words)
    said = json.loads(done(*words, "--force", "--json"))
    assert said["consistency"]["whole"] < said["consistency"]["false_alarms"]
    assert any(scene["unsure"] for scene in said["scenes"])
    text = done(*words, "--force")
    assert "do not look like" in text
    assert "unsure" in text


def test_a_wrong_budget_is_refused(refuse, done, lab, run):
    words = ["camera", "classify", lab / "design.safetensors", run]
    budget = json.loads(done(*words, "--json"))["scenes"][0]["photons"]
    assert "0.25 times the counts" in refuse(*words, "--photons", 4 * budget)
    assert "photon budget 0.0 is not allowed" in refuse(*words, "--photons", 0)


def test_labels_that_the_design_does_not_know_are_left_out(done, lab, run):
    words = ["camera", "classify", lab / "design.safetensors", run]
    path = run / "acquisition.json"
    content = json.loads(path.read_text())
    content["scenes"][0]["label"] = "cat"
    path.write_text(json.dumps(content))
    done("camera", "count", run)
    scenes = json.loads(done(*words, "--json"))["scenes"]
    assert scenes[0]["label"] == "cat"
    known = [(g, s["label"]) for s in scenes[1:] for g in s["guesses"]]
    said = done(*words)
    right = sum(guess == label for guess, label in known)
    assert f"right: {right} of {len(known)} exposures, none of them trained on (" in said
    assert f"{scenes[0]['exposures']} exposures have labels that are none of" in said


def test_a_design_without_a_distribution_is_not_tested(done, lab, run):
    """The file is the one that was shown, as far as the manifest knows."""
    bare = replace(Design.load(lab / "design.safetensors"), distribution=None, scene_model=None)
    patterns = lab / "bare-patterns"
    bare.save(lab / "bare.safetensors")
    words = ["--device", "64x48", "-o", patterns]
    done("dmd", "export", lab / "bare.safetensors", *words)
    words = ["--scene", lab / "images", "--flux", 1e7, "--exposure", "5ms", "--virtual", "ideal"]
    done("camera", "simulate", patterns, *words, "-o", run.parent / "bare")
    done("camera", "count", run.parent / "bare")
    words = ["camera", "classify", lab / "bare.safetensors", run.parent / "bare"]
    said = done(*words)
    assert "were not compared with those of the training" in said
    assert "use `deepfsi camera check`" in said
    assert json.loads(done(*words, "--json"))["consistency"] is None


def test_patterns_are_read_once(done, lab, run, monkeypatch):
    read, times = acquisition.read_patterns, []
    monkeypatch.setattr(
        acquisition, "read_patterns", lambda *given: times.append(given) or read(*given)
    )
    done("camera", "classify", lab / "design.safetensors", run)
    assert len(times) == 1


def test_a_camera_is_calibrated_by_files_alone(done, tmp_path):
    """A tilted view is found to a twentieth of a cell with 8 x 8 of them, and trained on."""
    camera = tmp_path / "tilted.toml"
    camera.write_text(
        "view = [[0.9, 0.04, 0.03], [-0.03, 0.92, 0.05], [0.01, 0.02, 1.0]]\ndark = 1e3\n"
    )
    spots, run, out = tmp_path / "spots", tmp_path / "run", tmp_path / "calibration"
    device = ["--device", "64x64", "--dwell", "20ms"]
    done("dmd", "export", "hadamard", "--size", "8x8", *device, "-o", tmp_path / "p")
    done("camera", "spots", "--size", "32x32", "-o", spots)
    done(
        "camera", "simulate", tmp_path / "p", "--scene", spots, "--flux", 1e7, "--exposure", "2s",
        "--repeats", 1, "--virtual", camera, "-o", run,
    )  # fmt: skip
    done("camera", "count", run)
    text = done("camera", "calibrate", run, "--spots", spots, "-o", out, "--json")
    found = json.loads(text)
    assert found["spots"] == 25
    assert found["error"] < 0.05
    assert found["warnings"] == []
    assert found["dead_time"] is None
    truth = np.array([[0.9, 0.04, 0.03], [-0.03, 0.92, 0.05], [0.01, 0.02, 1.0]])
    for corner in ((0.2, 0.2, 1), (0.8, 0.2, 1), (0.5, 0.5, 1), (0.8, 0.8, 1)):
        ours, theirs = (np.array(h) @ corner for h in (found["homography"], truth))
        assert np.abs(ours[:2] / ours[2] - theirs[:2] / theirs[2]).max() < 1 / 20 / 8
    dark_s = 27 * 2 * 20e-3  # all-OFF frames of all scenes
    assert found["dark"] == pytest.approx(1e3, abs=5 * np.sqrt(1e3 / dark_s))
    gates_s = 2.0  # of the black scene, mirrors half ON
    assert found["ambient"] < 5 * np.sqrt(1e3 * (1 / gates_s + 1 / dark_s)) * 2
    words = ["--photons", "1e4", "--masks", 4, "--epochs", 1, "--view", out]
    done("design", *words, "-o", tmp_path / "seen.safetensors")
    design = Design.load(tmp_path / "seen.safetensors")
    assert "calibration" in design.info["preprocessing"]
    done("evaluate", tmp_path / "seen.safetensors", "--photons", "1e4", "--view", out)
    lose_passes(run, found, spots)


def lose_passes(run, found, spots):
    """Passes of spots that were not counted add noise only; the white one is needed."""
    recorded = read_run(run)
    patterns = recorded.patterns
    names = [scene.name for scene in recorded.acquisition.scenes]
    shown, counts, pictures = read_display(spots), read_counts(run), reconstruct(run)
    lost = [place for place, name in enumerate(names) if name.startswith("spot")][:7]
    counts.valid[lost], counts.dark_rate[lost], pictures[lost] = False, 0, np.nan
    displayed = dict(zip(shown.names, shown.x, strict=True))
    again = calibrate_run(displayed, names, pictures, counts, patterns)
    assert again.dark == pytest.approx(found["dark"], rel=0.05)
    assert again.spots == 18
    counts.valid[names.index("white.png")] = False
    with pytest.raises(InputError, match=r"no exposure of white\.png"):
        calibrate_run(displayed, names, pictures, counts, patterns)


def test_a_faint_calibration_says_that_it_is_not_to_be_trusted(done, call, tmp_path):
    device = ["--device", "64x64", "--dwell", "1ms"]
    done("dmd", "export", "hadamard", "--size", "16x16", *device, "-o", tmp_path / "p")
    done("camera", "spots", "--size", "16x16", "--side", 1, "-o", tmp_path / "spots")
    words = [
        "--scene",
        tmp_path / "spots",
        "--flux",
        3e5,
        "--exposure",
        "0.5s",
        "--virtual",
        "ideal",
    ]
    done("camera", "simulate", tmp_path / "p", *words, "-o", tmp_path / "run")
    done("camera", "count", tmp_path / "run", "--dead-time", "1ns")
    words = ["camera", "calibrate", tmp_path / "run", "--spots", tmp_path / "spots"]
    out = done(*words, "-o", tmp_path / "c", "--json")
    assert any("times the light" in doubt for doubt in json.loads(out)["warnings"])
    assert json.loads(out)["dead_time"] == {"seconds": 1e-9, "paralysable": False}
    code, out, errors = call(*words, "-o", tmp_path / "c", "--force")
    assert code == 0
    assert "of 25 spots" in out
    assert errors.startswith("deepfsi: warning: ")
    assert "times the light" in errors


def test_patterns_of_devices_by_size_have_times_of_their_own(done, refuse, lab, tmp_path):
    times = ["--shortest", "100us", "--settle", "5us"]
    out = done(*export(lab, *times, "--dwell", "50us", "-o", tmp_path / "p"))
    assert "the mean picture time was raised to 100 µs" in out
    device = read_patterns(tmp_path / "p").manifest.device
    assert (device.shortest_us, device.settle_us) == (100, 5.0)
    assert "raised" not in done(*export(lab, *times, "--dwell", "100us", "-o", tmp_path / "q"))
    assert "whole microseconds" in refuse(*export(lab, "--shortest", "1.5us", "-o", tmp_path / "r"))
    late = ["--settle", "60us", "--dwell", "50us"]
    assert "in which mirrors settle" in refuse(*export(lab, *late, "-o", tmp_path / "r"))
    assert "cells of its design" in refuse(*export(lab, "--size", "8x8", "-o", tmp_path / "r"))
    assert not (tmp_path / "r").exists()


def test_a_large_recording_is_asked_for(done, refuse, lab, patterns, tmp_path, monkeypatch):
    """All of a pass is written: its photons are forecast before the work."""
    words = ["camera", "simulate", patterns, "--scene", lab / "images", "--exposure", "5ms"]
    words += ["--virtual", "ideal", "-o", tmp_path / "run"]
    said = refuse(*words, "--flux", 1e12)
    assert "GB" in said
    assert "--yes" in said
    assert not (tmp_path / "run").exists()
    monkeypatch.setattr("deepfsi.cli.recording.MOST_EVENTS", 1e3)
    assert "--yes" in refuse(*words, "--flux", 1e6)
    answers = iter([False, True])
    monkeypatch.setattr(Terminal, "confirm", lambda terminal, question: next(answers))
    assert "--yes" in refuse(*words, "--flux", 1e6)
    done(*words, "--flux", 1e6)
    assert next(answers, "asked twice") == "asked twice"
    monkeypatch.undo()
    words[words.index("-o") + 1] = tmp_path / "other"
    done(*words, "--flux", 1e6, "--yes")


def test_a_run_of_other_pictures_does_not_calibrate(done, refuse, run, tmp_path):
    done("camera", "spots", "-o", tmp_path / "spots")
    words = ["--spots", tmp_path / "spots", "-o", tmp_path / "c"]
    assert "0/one.png" in refuse("camera", "calibrate", run, *words)


def deep(folder, pictures, bright):
    """Pictures (n, 8, 8) as 16-bit PNG files, half in each class; the brightest value is given."""
    for place, picture in enumerate(np.rint(pictures.reshape(-1, 8, 8) * bright)):
        path = folder / "ab"[2 * place // len(pictures)] / f"{place}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(picture.astype(np.uint16)).save(path)


def test_scenes_have_the_white_of_the_design(done, digits, tmp_path):
    """Dim pictures of 12 bits would pass for those of 10: four times as bright."""
    deep(tmp_path / "train", digits.x_train[:40], 4095)
    deep(tmp_path / "dim", digits.x_test[:4], 4095 / 5)
    words = ["--noise", "poisson", "--photons", 1e4, "--masks", 4, "--light", "equal-dwell"]
    design = tmp_path / "d.safetensors"
    done("design", "--design", "pca", "--data", tmp_path / "train", *words, "-o", design)
    done("dmd", "export", design, "--device", "64x48", "-o", tmp_path / "p")
    words = ["--flux", 1e6, "--exposure", "2ms", "--virtual", "ideal"]
    said = done("camera", "simulate", tmp_path / "p", "--scene", tmp_path / "dim", *words,
                "-o", tmp_path / "run")  # fmt: skip
    assert "4 images of 8x8 pixels" in said
    assert "divided by 4095 (12 bits)" in said


@pytest.fixture
def cut(run):
    """The acquisition with a photon file that ends in the last scene."""
    path = run / "photons.ptu"
    path.write_bytes(path.read_bytes()[:-4000])
    return run


def test_counting_says_that_the_file_is_cut(done, cut):
    said = done("camera", "count", cut)
    assert re.search(r"photons\.ptu: 1000 of \d+ records are missing: the file is cut", said)
    problems = json.loads(done("camera", "count", cut, "--json"))["problems"]
    assert "1000 of" in problems[0]


def test_faults_name_their_scene(done, lab, cut):
    assert "marker lost scene 2, 7/one.png: " in done("camera", "count", cut)
    faults = json.loads(done("camera", "count", cut, "--json"))["faults"]
    assert {fault["name"] for fault in faults} == {"7/one.png"}
    said = done("camera", "classify", lab / "design.safetensors", cut)
    assert "marker lost scene 2, 7/one.png: " in said


def test_clocks_that_agree_are_as_planned(done, run):
    assert "clocks: frames last as planned" in done("camera", "count", run)

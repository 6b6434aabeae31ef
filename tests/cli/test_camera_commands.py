"""The camera on the command line: what it prints, and one clear line for bad input."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from deepfsi import Design, InputError, evaluate
from deepfsi.cli import app
from deepfsi.counting.recording import Recording
from deepfsi.datasets.display import read_display, write_pictures
from deepfsi.lab.calibration import calibrate
from deepfsi.patterns.folder import Patterns

LIGHT = ["--flux", 1e7, "--exposure", "5ms", "--virtual", "ideal"]


@pytest.fixture(scope="module")
def lab(tmp_path_factory, made, digits):
    """A design, its patterns on a small device, and three scenes."""
    folder = tmp_path_factory.mktemp("lab")
    made("deepfsi", "equal-dwell", "dual").save(folder / "design.safetensors")
    firsts = {label: digits.x_test[(digits.y_test == int(label)).argmax()] for label in "037"}
    pictures = {f"{label}/one.png": x.reshape(8, 8) for label, x in firsts.items()}
    write_pictures(pictures, folder / "images")
    words = ["dmd", "export", folder / "design.safetensors", "--dmd", "64x48"]
    assert CliRunner().invoke(app, [*map(str, words), "-o", str(folder / "p")]).exit_code == 0
    return folder


@pytest.fixture
def acquire(done, lab):
    """Simulate and count an acquisition of the three scenes, perhaps with another design."""

    def run(folder, design=None):
        patterns = lab / "p"
        if design is not None:
            file, patterns = folder.with_suffix(".safetensors"), folder.with_suffix(".p")
            design.save(file)
            done("dmd", "export", file, "--dmd", "64x48", "-o", patterns)
        done("camera", "simulate", patterns, "--scene", lab / "images", *LIGHT, "-o", folder)
        done("camera", "count", folder)
        return folder

    return run


@pytest.fixture
def run(acquire, tmp_path):
    return acquire(tmp_path / "run")


def test_patterns_are_evaluated_as_they_are_realised(done, lab, digits):
    out = done("evaluate", lab / "p", "--photons", "1e4", "--json")
    design = Design.load(lab / "design.safetensors").as_shown(*Patterns.read(lab / "p").realised)
    assert json.loads(out)["results"][0]["accuracy"] == evaluate(design, digits, 1e4)[0].accuracy


def test_a_dimmed_design_reads_its_own_counts(made, tmp_path, done):
    """One device shows a column design with less light: as if at so much smaller a budget."""
    column, file = made("deepfsi", "column", "dual"), tmp_path / "column.safetensors"
    column.save(file)
    assert "cost" in done("dmd", "export", file, "--dmd", "64x48", "-o", tmp_path / "p")
    patterns = Patterns.read(tmp_path / "p")
    dimmed, shown = patterns.manifest.dimmed, column.as_shown(*patterns.realised)
    counts = np.full((1, 2, column.masks), 30.0)
    np.testing.assert_allclose(
        shown.classify(counts, 1e4), column.classify(counts, 1e4 * dimmed), rtol=1e-4, atol=1e-6
    )
    light = [each.rails.total.sum() for each in (shown, column)]
    np.testing.assert_allclose(light[0], dimmed * light[1], rtol=0.01)


def test_labels_that_the_design_does_not_know_are_left_out(done, lab, run):
    words = ["camera", "classify", lab / "design.safetensors", run]
    path = run / "acquisition.json"
    content = json.loads(path.read_text())
    content["scenes"][0]["label"] = "cat"
    path.write_text(json.dumps(content))
    done("camera", "count", run)
    scenes = json.loads(done(*words, "--json"))["scenes"]
    known = [(g, s["label"]) for s in scenes[1:] for g in s["guesses"]]
    right, said = sum(guess == label for guess, label in known), done(*words)
    assert scenes[0]["label"] == "cat"
    assert f"right: {right} of {len(known)} exposures, none recognised as trained on (" in said
    assert f"{len(scenes[0]['guesses'])} exposures with labels that are none of" in said


def test_a_design_without_a_usual_misfit_is_not_tested(done, lab, acquire, tmp_path):
    """The file is the one that was shown, as far as the manifest knows."""
    bare = replace(Design.load(lab / "design.safetensors"), usual_misfit=None, scene_model=None)
    words = ["camera", "classify", tmp_path / "bare.safetensors", acquire(tmp_path / "bare", bare)]
    said = done(*words)
    assert "were not compared with those of the training" in said
    assert "use `deepfsi camera check`" in said
    found = json.loads(done(*words, "--json"))
    assert "view" not in found
    assert all(scene["unlike"] is None for scene in found["scenes"])


TILTED = [[0.9, 0.04, 0.03], [-0.03, 0.92, 0.05], [0.01, 0.02, 1.0]]


def test_a_camera_is_calibrated_by_files_alone(done, tmp_path):
    """A tilted view is found to a twentieth of a cell with 8 x 8 of them, and trained on."""
    p, run, out = (tmp_path / name for name in ("p", "run", "calibration"))
    spots = p / "spots"
    (tmp_path / "tilted.toml").write_text(f"view = {TILTED}\ndark = 1e3\n")
    device = ["--size", "8x8", "--dmd", "64x64", "--dwell", "10ms"]
    done("dmd", "export", "hadamard", *device, "-o", p)
    light = ["--flux", 1e7, "--exposure", "1s", "--repeats", 1]
    camera = ["--virtual", tmp_path / "tilted.toml"]
    done("camera", "simulate", p, "--scene", spots, *light, *camera, "-o", run)
    done("camera", "count", run)
    words = ["camera", "calibrate", run, "--spots", spots, "-o", out]
    found = json.loads(done(*words, "--json"))
    assert (found["spots"], found["warnings"], found["dead_time"]) == (25, [], None)
    assert found["error"] < 0.05
    for corner in ((0.2, 0.2, 1), (0.8, 0.2, 1), (0.5, 0.5, 1), (0.8, 0.8, 1)):
        ours, theirs = (np.array(h) @ corner for h in (found["homography"], TILTED))
        assert np.abs(ours[:2] / ours[2] - theirs[:2] / theirs[2]).max() < 1 / 20 / 8
    dark_s = 27 * 2 * 10e-3  # all-OFF frames of all scenes
    assert found["dark"] == pytest.approx(1e3, abs=5 * np.sqrt(1e3 / dark_s))
    file, view = tmp_path / "seen.safetensors", ("--view", out)
    done("design", "--photons", "1e4", "--masks", 4, "--epochs", 1, *view, "-o", file)
    assert "calibration" in Design.load(file).info["preprocessing"]
    done("evaluate", file, "--photons", "1e4", *view)
    lose_passes(run, found, spots)


def lose_passes(run, found, spots):
    """Passes of spots that were not counted add noise only; the white one is needed."""
    recorded = Recording.read(run)
    names = [scene.name for scene in recorded.acquisition.scenes]
    shown, counts = read_display(spots), recorded.read_counts()
    lost = [place for place, name in enumerate(names) if name.startswith("spot")][:7]
    counts.valid[lost], counts.dark_rate[lost] = False, 0
    again = calibrate(shown, recorded, counts)
    assert again.dark == pytest.approx(found["dark"], rel=0.05)
    assert again.spots == 18
    counts.valid[names.index("white.png")] = False
    with pytest.raises(InputError, match=r"no exposure of white\.png"):
        calibrate(shown, recorded, counts)


def deep(folder, pictures, bright):
    """Pictures (n, 8, 8) as 16-bit PNG files, half in each class; the brightest value is given."""
    for place, picture in enumerate(np.rint(pictures.reshape(-1, 8, 8) * bright)):
        path = folder / "ab"[2 * place // len(pictures)] / f"{place}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(picture.astype(np.uint16)).save(path)


def test_scenes_have_the_white_of_the_design(done, digits, tmp_path, trained_once):
    """Dim pictures of 12 bits would pass for those of 10: four times as bright."""
    deep(tmp_path / "train", digits.x_train[:40], 4095)
    deep(tmp_path / "dim", digits.x_test[:4], 4095 / 5)
    words = ["--noise", "poisson", "--photons", 1e4, "--masks", 4, "--light", "equal-dwell"]
    design, p = tmp_path / "d.safetensors", tmp_path / "p"
    done("design", "--design", "pca", "--data", tmp_path / "train", *words, "-o", design)
    done("dmd", "export", design, "--dmd", "64x48", "-o", p)
    words = ["--flux", 1e6, "--exposure", "2ms", "--virtual", "ideal", "-o", tmp_path / "run"]
    said = done("camera", "simulate", p, "--scene", tmp_path / "dim", *words)
    assert "4 images of 8x8 pixels" in said
    assert "divided by 4095 (12 bits)" in said

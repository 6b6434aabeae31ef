"""Tables of counts on the command line: classes of any counter's values."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import ptufile
import pytest
from scipy.io import savemat

from conftest import quick
from deepfsi.camera.device import find_device
from deepfsi.datasets.display import write_pictures
from deepfsi.lab.design_data import design_rails
from deepfsi.lab.virtual_optics import VirtualCamera, arrival_rates
from deepfsi.patterns.folder import Patterns

FLUX, SCENES, DWELL = 1e6, 60, 1e-3


@pytest.fixture(scope="module")
def lab(tmp_path_factory, digits):
    """A design that reads digits and its patterns."""
    folder = tmp_path_factory.mktemp("lab")
    made = quick(digits, masks=8, epochs=15, hidden=(40, 128), light="free-dwell", rails="single")
    made.save(folder / "d.safetensors")
    Patterns.from_rails(design_rails(folder / "d.safetensors"), find_device("64x48"), DWELL).write(
        folder / "patterns"
    )
    return folder


@pytest.fixture(scope="module")
def values(lab, digits):
    """Counts between markers of test scenes, in the order of the frames."""
    images = digits.x_test[:SCENES].reshape(-1, 8, 8)
    rates = arrival_rates(Patterns.read(lab / "patterns"), images, VirtualCamera(dark=1e3), FLUX)[
        ..., 0
    ]
    return np.random.default_rng(1).poisson(
        rates * Patterns.read(lab / "patterns").manifest.picture_s
    )


@pytest.fixture
def classify(lab, tmp_path):
    """Words that classify a table of these values."""

    def words(values, *more):
        np.save(tmp_path / "counts.npy", values)
        return ["camera", "classify", lab / "patterns", tmp_path / "counts.npy", *more]

    return words


def test_counts_in_a_wrong_order_are_refused(refuse, done, classify, values):
    backwards = values.copy()
    backwards[:, 2:-2] = backwards[:, -3:1:-1]
    words = classify(backwards)
    assert "do not look like" in refuse(*words)
    done(*words, "--force")


def test_what_is_no_table_of_these_patterns_is_one_line(refuse, lab, classify, values, tmp_path):
    (tmp_path / "run").mkdir()
    shutil.copy(lab / "d.safetensors", tmp_path / "d.safetensors")
    patterns = ["camera", "classify", lab / "patterns"]
    short = "an exposure is a row of 8 values (8 frames of masks), or 12"
    assert short in refuse(*classify(values[:, :-1]))
    assert "give --photons" in refuse(*classify(values[:, 2:-2]))
    table = classify(values)
    assert "none.csv is missing" in refuse(*patterns, tmp_path / "none.csv")
    assert "--background is for tables" in refuse(*patterns, tmp_path / "run", "--background", 2)
    table[2] = lab / "d.safetensors"
    assert "the folder of its patterns" in refuse(*table, "--settle", "1us")
    table[2] = tmp_path / "run"
    assert "manifest.json is missing: make patterns" in refuse(*table)


def test_the_lines_for_matlab_read_classes(done, lab, classify, values, tmp_path, monkeypatch):
    """Those of the page: what they save, the command, and the fields that they read."""
    page = (Path(__file__).parents[2] / "docs/do/counts.md").read_text()
    block = re.search(r"```matlab\n(.*?)```", page, re.S)[1]
    name, variable = re.search(r"save\('(\S+)', '(\w+)'\)", block).groups()
    command = re.search(r"system\('deepfsi (.*)'\)", block)[1]
    fields = re.findall(r"found\.scenes\.(\w+)", block)
    savemat(tmp_path / name, {variable: values.astype(float)})
    shutil.copytree(lab / "patterns", tmp_path / "patterns")
    monkeypatch.chdir(tmp_path)
    scenes = json.loads(done(*command.split()))["scenes"]
    assert len({tuple(scene) for scene in scenes}) == 1  # so that jsondecode makes one array
    assert fields == ["class", "probability", "unlike"]
    assert all(scene[field] is not None for scene in scenes for field in fields)
    usual = json.loads(done(*classify(values), "--json"))["scenes"]
    assert [scene["class"] for scene in scenes] == [scene["class"] for scene in usual]


def test_read_noise_is_told_to_the_test_of_consistency(refuse, done, classify, values):
    """The same volts: sound with the noise that they have, and unlike the training without."""
    noise, gain = 150.0, 2e4
    volts = (values + noise * np.random.default_rng(3).standard_normal(values.shape)) / gain
    words = classify(volts, "--gain", gain)
    said = json.loads(done(*words, "--read-noise", noise, "--json"))
    assert sum(scene["unlike"] for scene in said["scenes"]) <= 1
    assert "do not look like" in refuse(*words, "--read-noise", 0)
    bare = json.loads(done(*words, "--read-noise", 0, "--force", "--json"))
    assert [s["guesses"] for s in bare["scenes"]] == [s["guesses"] for s in said["scenes"]]


def test_events_of_another_counter_are_counted_as_a_photon_file(done, refuse, lab, tmp_path):
    """Events of a recording, the trigger on channel 8 and the detector on 3, as text in ps."""
    run, imported = tmp_path / "run", tmp_path / "lab"
    write_pictures({"a.png": np.full((8, 8), 0.5)}, tmp_path / "images")
    words = ["--scene", tmp_path / "images", "--flux", FLUX, "--exposure", "5ms", "--virtual"]
    done("camera", "simulate", lab / "patterns", *words, "ideal", "-o", run)
    wanted = json.loads(done("camera", "count", run, "--json"))
    with ptufile.PtuFile(run / "photons.ptu") as file:
        found = file.decode_records()
    found = found[(found["marker"] == 1) | (found["channel"] >= 0)]
    events = np.stack([found["time"], np.where(found["marker"] == 1, 8, 3)], axis=1)
    np.savetxt(tmp_path / "tags.csv", events.astype(np.int64), "%d", ",")
    words = ["--patterns", lab / "patterns", "--scenes", tmp_path / "images", "--exposure", "5ms"]
    words = ["camera", "import", tmp_path / "tags.csv", *words, "-o", imported]
    assert "give their --unit" in refuse(*words)
    words += ["--unit", "1ps"]
    assert "channel 9 has no events" in refuse(*words, "--marker-channel", 9)
    done(*words, "--marker-channel", 8)
    found = json.loads(done("camera", "count", imported, "--json"))
    assert found["photons_counted"] == wanted["photons_counted"] > 0


def test_dead_time_of_a_table_is_corrected(done, refuse, lab, classify, values):
    """The budget by the all-ON frames is what it was without losses."""
    slow = np.rint(
        values / (1 + values / Patterns.read(lab / "patterns").manifest.picture_s * 1e-7)
    )

    def photons(*words):
        return json.loads(done(*words, "--json"))["scenes"][0]["photons"]

    true, words = photons(*classify(values)), classify(slow)
    assert photons(*words) < 0.93 * true
    assert photons(*words, "--dead-time", "100ns") == pytest.approx(true, rel=1e-3)
    assert "dim the light" in refuse(*words, "--dead-time", "1us")
    assert "give --dead-time" in refuse(*words, "--dead-time-model", "paralysable")

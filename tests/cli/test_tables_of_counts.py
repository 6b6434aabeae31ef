"""Tables of counts on the command line: classes of any counter's values."""

import json
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import polars as pl
import ptufile
import pytest
from scipy.io import savemat

from conftest import quick
from deepfsi.camera import find_device
from deepfsi.datasets import write_pictures
from deepfsi.hardware.counting.tables import column_names
from deepfsi.hardware.patterns import FrameSettings, export_patterns, read_patterns
from deepfsi.hardware.virtual import VirtualCamera, arrival_rates
from deepfsi.lab import design_rails

FLUX, SCENES, DWELL = 1e6, 60, 1e-3


@dataclass
class Lab:
    """A design that reads digits, its patterns, and counts between markers of test scenes."""

    folder: Path
    design: Path
    patterns: Path
    names: list[str]
    values: np.ndarray
    labels: list[str]

    def csv(self, name: str, values: np.ndarray) -> Path:
        """Table with named scenes, in the order of the frames."""
        words = {"scene": [f"s{k}" for k in range(len(values))], "label": self.labels}
        numbers = pl.DataFrame(values, schema=self.names, orient="row")
        pl.DataFrame(words).hstack(numbers).write_csv(self.folder / name)
        return self.folder / name


@pytest.fixture(scope="module")
def lab(tmp_path_factory, digits) -> Lab:
    folder = tmp_path_factory.mktemp("lab")
    made = quick(digits, masks=8, epochs=15, hidden=(40, 128), light="free-dwell", rails="single")
    design, patterns = folder / "one.safetensors", folder / "patterns"
    made.save(design)
    export_patterns(design_rails(design), FrameSettings(find_device("64x48"), DWELL), patterns)
    manifest = read_patterns(patterns).manifest
    images = digits.x_test[:SCENES].reshape(-1, 8, 8)
    rates = arrival_rates(patterns, images, VirtualCamera(dark=1e3), FLUX)[..., 0]
    values = np.random.default_rng(1).poisson(rates * manifest.picture_s)
    labels = [digits.classes[k] for k in digits.y_test[:SCENES]]
    found = Lab(folder, design, patterns, column_names(manifest), values, labels)
    found.csv("counts.csv", values)
    np.save(folder / "counts.npy", values)
    savemat(folder / "counts.mat", {"counts": values.T.astype(float)})
    return found


def guesses(said: str) -> list[str]:
    return [scene["class"] for scene in json.loads(said)["scenes"]]


def test_counts_in_a_wrong_order_are_refused(refuse, done, lab):
    backwards = lab.values.copy()
    backwards[:, 2:-2] = backwards[:, -3:1:-1]
    table = lab.csv("backwards.csv", backwards)
    assert "do not look like" in refuse("camera", "classify", lab.patterns, table)
    done("camera", "classify", lab.patterns, table, "--force")


def test_what_is_no_table_of_these_patterns_is_one_line(refuse, lab, tmp_path):
    words = ["camera", "classify", lab.patterns]
    np.save(tmp_path / "short.npy", lab.values[:, :-1])
    np.save(tmp_path / "bare.npy", lab.values[:, 2:-2])
    (tmp_path / "run").mkdir()
    shutil.copy(lab.design, tmp_path / "d.safetensors")
    table = lab.folder / "counts.npy"
    for given, said in (
        ([*words, tmp_path / "short.npy"], "an exposure has 8 values (8 frames of masks), or 12"),
        ([*words, tmp_path / "bare.npy"], "give --photons"),
        ([*words, tmp_path / "none.csv"], "there is no file"),
        ([*words, tmp_path / "none.ptu"], "nothing that was counted"),
        ([*words, table, "--exposures", "up"], "--exposures"),
        ([*words, tmp_path / "run", "--gain", 2], "--gain is for tables"),
        (
            ["camera", "classify", lab.design, table, "--settle", "1us"],
            "the folder of its patterns",
        ),
        ([*words[:2], tmp_path / "run", table], "manifest.json is missing: make patterns"),
    ):
        assert said in refuse(*given)


def matlab_lines() -> dict[str, str]:
    """Command and variables of the page's lines for MATLAB."""
    page = (Path(__file__).parents[2] / "docs/do/counts.md").read_text()
    block = re.search(r"```matlab\n(.*?)```", page, re.S)[1]
    return {
        "save": re.search(r"save\('(\S+)', '(\w+)'\)", block).groups(),
        "command": re.search(r"system\('deepfsi (.*)'\)", block)[1],
        "fields": re.findall(r"found\.scenes\.(\w+)", block),
    }


@pytest.mark.parametrize("version", ["7", "7.3"])
def test_the_lines_for_matlab_read_classes(done, lab, tmp_path, monkeypatch, version):
    lines = matlab_lines()
    name, variable = lines["save"]
    counts = lab.values.astype(float)
    if version == "7":
        savemat(tmp_path / name, {variable: counts})
    else:
        with h5py.File(tmp_path / name, "w", userblock_size=512) as file:
            file[variable] = counts.T
            file[variable].attrs["MATLAB_class"] = np.bytes_("double")
        with (tmp_path / name).open("r+b") as file:
            file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    shutil.copytree(lab.patterns, tmp_path / "patterns")
    monkeypatch.chdir(tmp_path)
    scenes = json.loads(done(*lines["command"].split()))["scenes"]
    assert len({tuple(scene) for scene in scenes}) == 1  # so that jsondecode makes one array
    assert lines["fields"] == ["class", "probability", "unsure"]
    assert all(scene[field] is not None for scene in scenes for field in lines["fields"])
    text = done("camera", "classify", lab.patterns, lab.folder / "counts.csv", "--json")
    assert [scene["class"] for scene in scenes] == guesses(text)


def test_events_of_another_counter_are_counted_as_a_photon_file(done, refuse, lab, tmp_path):
    """Events of a recording, the trigger on channel 8 and the detector on 3, as text in ps."""
    write_pictures({"a.png": np.full((8, 8), 0.5)}, tmp_path / "images")
    words = ["--scene", tmp_path / "images", "--flux", FLUX, "--exposure", "5ms", "--virtual"]
    done("camera", "simulate", lab.patterns, *words, "ideal", "-o", tmp_path / "run")
    wanted = json.loads(done("camera", "count", tmp_path / "run", "--json"))
    with ptufile.PtuFile(tmp_path / "run" / "photons.ptu") as file:
        found = file.decode_records()
    found = found[(found["marker"] == 1) | (found["channel"] >= 0)]
    events = np.stack([found["time"], np.where(found["marker"] == 1, 8, 3)], axis=1)
    np.savetxt(tmp_path / "tags.txt", events.astype(np.int64), "%d")
    (tmp_path / "run" / "photons.ptu").unlink()
    words = ["camera", "import", tmp_path / "tags.txt", "--unit", "1ps", "-o"]
    photons = tmp_path / "run" / "photons.ptu"
    assert "channel 9 has no events" in refuse(*words, photons, "--marker-channel", 9)
    said = json.loads(done(*words, photons, "--marker-channel", 8, "--json"))
    assert (said["channels"], said["left_out"]) == ([3], 0)
    assert said["schema"] == "deepfsi.camera.import/1"
    counted = json.loads(done("camera", "count", tmp_path / "run", "--json"))
    assert counted == wanted
    assert "exists already" in refuse(*words, photons, "--marker-channel", 8)
    said = done(*words, tmp_path / "more.ptu", "--marker-channel", 8, "--channel", 3)
    assert "channel 3: " in said


def test_read_noise_is_told_to_the_test_of_consistency(refuse, done, lab):
    """The same volts: sound with the noise that they have, and unlike the training without."""
    rng = np.random.default_rng(3)
    noise, gain = 150.0, 2e4
    volts = (lab.values + noise * rng.standard_normal(lab.values.shape)) / gain
    words = ["camera", "classify", lab.patterns, lab.csv("volts.csv", volts), "--gain", gain]
    said = json.loads(done(*words, "--read-noise", noise, "--json"))
    assert said["consistency"]["whole"] > said["consistency"]["false_alarms"]
    assert "do not look like" in refuse(*words, "--read-noise", 0)
    bare = json.loads(done(*words, "--read-noise", 0, "--force", "--json"))
    assert [s["guesses"] for s in bare["scenes"]] == [s["guesses"] for s in said["scenes"]]


def test_dead_time_of_a_table_is_corrected(done, refuse, lab):
    """The budget by the all-ON frames is what it was without losses."""
    times = read_patterns(lab.patterns).manifest.picture_s
    slow = 1e-7
    seen = np.rint(lab.values / (1 + lab.values / times * slow))
    words = ["camera", "classify", lab.patterns, lab.csv("slow.csv", seen), "--json"]
    whole = ["camera", "classify", lab.patterns, lab.folder / "counts.csv", "--json"]
    true, bare, corrected = (
        json.loads(done(*each))["scenes"][0]["photons"]
        for each in (whole, words, [*words, "--dead-time", "100ns"])
    )
    assert bare < 0.93 * true
    assert corrected == pytest.approx(true, rel=1e-3)
    assert "paralysable" in refuse(*words, "--dead-time", "1ns", "--dead-time-model", "some")
    assert "give 1e-05 or less" in refuse(*words, "--dead-time", "1ms")
    assert "dim the light" in refuse(*words, "--dead-time", "1us")

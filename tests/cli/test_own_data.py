"""A user's own pictures on the command line: what was done to them is said."""

import json
import shutil

import numpy as np
import pytest
from PIL import Image

from deepfsi import Design, from_arrays, learn
from shared.pictures import save_images


def save_pictures(folder, counts, side=8, seed=0):
    """Write 12-bit pictures in 16-bit PNG files: each class a bright quarter and noise."""
    rng = np.random.default_rng(seed)
    for label, count in counts.items():
        (folder / label).mkdir(parents=True)
        row, column = divmod(list(counts).index(label), 2)
        for number in range(count):
            levels = rng.integers(100, 1200, (side, side))
            half = side // 2
            levels[half * row : half * (row + 1), half * column : half * (column + 1)] += 2500
            Image.fromarray(levels.astype(np.uint16)).save(folder / label / f"{number:03}.png")
    return folder


@pytest.fixture
def pictures(tmp_path, trained_once):
    return save_pictures(tmp_path / "leaves", {"ash": 30, "oak": 30, "yew": 30})


@pytest.fixture
def file(tmp_path):
    return tmp_path / "leaves.safetensors"


LIT = ("--photons", "1e4", "--masks", 4)

TRAINED = (*LIT, "--epochs", 1)
OPTICS = ("--light", "free-dwell", "--rails", "single", "--levels", 2)
SHOWN = ("--flux", "1e7", "--exposure", "5ms", "--virtual", "ideal")


@pytest.fixture
def patterns(done, pictures, file, tmp_path):
    """Patterns of a design of the pictures, on a small device."""
    done("design", "--data", pictures, *TRAINED, *OPTICS, "-o", file)
    words = ("--dmd", "64x48", "--dwell", "4ms", "-o", tmp_path / "patterns")
    done("dmd", "export", file, *words)
    return tmp_path / "patterns"


def test_pictures_that_were_trained_on_are_told_apart_in_a_recorded_run(
    done, pictures, file, patterns, tmp_path
):
    """Of a whole folder of one's own a fifth is new, and the test scenes of `data export` are."""
    done("data", "export", pictures, "--per-class", 6, "-o", tmp_path / "new")
    for source, trained in ((pictures, 72), (tmp_path / "new", 0)):
        run = tmp_path / f"run_{source.name}"
        done("camera", "simulate", patterns, "--scene", source, *SHOWN, "--repeats", 1, "-o", run)
        done("camera", "count", run)
        said = json.loads(done("camera", "classify", file, run, "--json"))
        score = {name: each["scenes"] for name, each in said["score"].items()}
        assert score == {"new": 18, "trained_on": trained, "unknown": 0}
        assert [scene["trained_on"] for scene in said["scenes"]].count(True) == trained
        new, old = (said["score"][name]["right"] for name in ("new", "trained_on"))
        printed = done("camera", "classify", file, run)
        assert f"right: {new} of 18 exposures, none recognised as trained on (" in printed
        assert (f"right: {old} of 72 exposures that were trained on" in printed) == bool(trained)
    words = ("--patterns", patterns, "--scenes", pictures, "-o", tmp_path / "lab")
    done("camera", "import", run / "photons.ptu", *words)
    imported, simulated = (
        json.loads((tmp_path / run / "acquisition.json").read_text())["scenes"]
        for run in ("lab", "run_leaves")
    )
    assert imported == simulated
    assert all(len(scene["hash"]) == 8 for scene in imported)


def test_of_scenes_by_name_it_is_not_known(done, pictures, file, patterns, tmp_path):
    """Their acquisition is as it was before scenes had hashes, and so are its counts."""
    run, lab, names = tmp_path / "run", tmp_path / "lab", tmp_path / "scenes.csv"
    done("camera", "simulate", patterns, "--scene", pictures / "ash", *SHOWN, "-o", run)
    names.write_text("".join(f"{k:03}.png,ash\n" for k in range(30)))
    words = ("--patterns", patterns, "--scenes", names, "--exposure", "5ms", "-o", lab)
    done("camera", "import", run / "photons.ptu", *words)
    done("camera", "count", lab)
    assert set(json.loads((lab / "acquisition.json").read_text())["scenes"][0]) == {"name", "label"}
    printed = done("camera", "classify", file, lab)
    assert "exposures that may have been trained on (" in printed


def test_a_design_remembers_its_data_size_and_camera(done, pictures, file, tmp_path, monkeypatch):
    """Every later command takes them from the design, and the light of the camera."""
    lab, run = tmp_path / "lab.toml", tmp_path / "run"
    lab.write_text('device = "dlp7000"\nexposure = "10ms"\nflux = 1e6\ndark = 200\n')
    trained = ["--size", "4x4", "--camera", lab, "--masks", 4, "--epochs", 1]
    monkeypatch.chdir(pictures.parent)  # told by a relative path
    made = json.loads(done("design", "--data", "leaves", *trained, "-o", file, "--json"))
    monkeypatch.chdir(tmp_path.parent)
    words = ("evaluate", file, "--photons", "1e4")
    found = json.loads(done(*words, "--json"))
    assert found["notes"] == []
    assert found["results"] == made["tests"]
    assert json.loads(done(*words, "--data", pictures, "--size", 4, "--json")) == found
    origin = Design.load(file).info["data"]["origin"]
    assert origin == origin | {"data": str(pictures), "size": [4, 4], "white": 4095}
    for told in ((), ("--data", pictures)):
        assert "averaged to 4x4 pixels;" in done(*words, *told)
    out = done("predict", file, pictures)
    assert "averaged to 4x4" in out
    assert "1e4 photons" in out
    assert "were trained on" in out.splitlines()[-1]  # the sum, below 90 rows
    picture = shutil.copy(next(pictures.rglob("*.png")), tmp_path / "=1+1.png")
    done("predict", file, picture, "-o", tmp_path / "classes.csv")
    assert (tmp_path / "classes.csv").read_text().splitlines()[1].startswith("'=1+1.png,")
    done("dmd", "export", file, "-o", tmp_path / "frames")
    done("camera", "simulate", tmp_path / "frames", "--scene", pictures, "-o", run)
    counted = done("camera", "count", run)
    assert "90 scenes, 90 exposures of 10 ms" in counted
    assert "e+" not in counted
    assert "were trained on" in done("camera", "classify", file, run).splitlines()[-1]


def test_a_design_says_when_it_is_told_otherwise(done, refuse, pictures, file, tmp_path):
    """Other data, and data that changed, which keep their white."""
    done("design", "--data", pictures, *TRAINED, "-o", file)
    other = save_pictures(tmp_path / "more", {"ash": 20, "oak": 20, "yew": 20}, side=12, seed=9)
    words = ("evaluate", file, "--photons", "1e4")
    elsewhere = (*words, "--data", other, "--size", 8)
    out = done(*elsewhere)
    [note] = [line for line in out.splitlines() if line.startswith("note: ")]
    assert note == f"note: the design was trained on {pictures}; this is {other} at 8x8"
    assert "12 bits" in out
    assert len(json.loads(done(*elsewhere, "--json"))["notes"]) == 1
    for path in (pictures / "ash").glob("00*.png"):
        with Image.open(path) as image:
            dim = (np.asarray(image) // 8).astype(np.uint16)
        Image.fromarray(dim).save(path)
    out = done(*words)
    assert "note: " in out
    assert "has changed since the design was trained" in out
    assert "divided by 4095 (12 bits)" in out
    Image.fromarray(np.full((8, 8), 60_000, np.uint16)).save(pictures / "ash" / "000.png")
    assert "to 60000; values are allowed from 0 to 4095" in refuse(*words)
    pictures.rename(tmp_path / "moved")
    assert "give the data to test it on" in refuse(*words)


def test_a_design_of_arrays_asks_for_data(refuse, done, file, tmp_path, trained_once):
    x, npz = np.random.default_rng(0).random((60, 9)), tmp_path / "scenes.npz"
    data = from_arrays(x, np.arange(60) % 2)
    learn(data, photons=1e4, masks=3, training={"epochs": 1}, device="cpu").save(file)
    words = ("evaluate", file, "--photons", "1e4")
    assert "arrays in memory: give the data" in refuse(*words)
    np.savez(npz, x=x, y=np.arange(60) % 2)
    assert "note: " not in done(*words, "--data", npz), "they are the same"
    np.savez(npz, x=x[:, ::-1], y=np.arange(60) % 2)
    assert "is not the data that the design was trained on" in done(*words, "--data", npz)


@pytest.mark.usefixtures("trained_once")
def test_unbalanced_data_shows_its_worst_class(done, file, tmp_path):
    """At `design` and `evaluate`; tests/sweeps and tests/report have those of comparisons."""
    folder = save_pictures(tmp_path / "leaves", {"ash": 90, "oak": 8, "yew": 8})
    light = ("--data", folder, "--photons", "1e2", "--epochs", 2)
    words = ("design", *light, "--masks", 3, "-o", file)
    assert "worst class" in done(*words)
    tested = json.loads(done("evaluate", file, "--photons", "1e2", "--json"))["results"][0]
    assert tested["classes"] == ["ash", "oak", "yew"]
    assert len(tested["rates"]) == len(tested["confusion"]) == 3
    assert tested["balanced"] == pytest.approx(np.mean(tested["rates"]))
    table = done("evaluate", file, "--photons", "1e2")
    assert f"{tested['balanced']:.3f}" in table
    assert f"{min(tested['rates']):.3f} (" in table


def test_masks_that_have_no_time_are_told(done, pictures, file):
    """Of 40 masks in an exposure of 10 frames at most."""
    asked = ["--data", pictures, "--dmd", "dlp7000", "--masks", 40, "--epochs", 2]
    asked += ["--exposure", "400us", "--flux", "1e8", "-o", file]
    out = done("design", *asked)
    lit = int((Design.load(file).rails.stacked.amax(dim=-1) > 0).any(dim=0).sum())
    assert 0 < lit <= 12
    assert f"masks: 40 asked, {lit} lit: {40 - lit} have no time under this budget" in out
    assert json.loads(done("design", *asked, "--json", "--force"))["lit_masks"] == lit
    done("show", file, "-o", file.with_suffix(".png"))


def test_pictures_that_were_trained_on_are_told_apart_in_a_live_run(done, pictures, file, tmp_path):
    frames, run = tmp_path / "patterns", tmp_path / "run"
    adaptive = ("--light", "free-dwell", "--design", "adaptive")
    done("design", "--data", pictures, *LIT, *adaptive, "-o", file)
    done("dmd", "export", file, "--dmd", "dlp7000", "--dwell", "4ms", "-o", frames)
    words = ("--scene", pictures / "oak", *SHOWN, "-o", run, "--json")
    told = json.loads(done("camera", "live", frames, *words))
    trained_on = [scene["trained_on"] for scene in told["scenes"]]
    assert sum(trained_on) == 24, "30 pictures of a class, of which six are test scenes"
    again = json.loads(done("camera", "classify", file, run, "--json"))
    assert [scene["trained_on"] for scene in again["scenes"]] == trained_on
    assert again["score"] == told["score"]


def test_pictures_of_several_sizes_are_shown_as_the_design_has_them(done, refuse, pictures, file):
    """A design with a size brings them to it, for `camera simulate` as for `design`."""
    patterns, run = file.with_name("patterns"), file.with_name("run")
    [first, *_] = sorted(pictures.rglob("*.png"))
    with Image.open(first) as image:
        larger = image.resize((16, 16), Image.Resampling.NEAREST)
    larger.save(first)
    shown = ("camera", "simulate", patterns, "--scene", pictures / "ash", *SHOWN, "-o", run)
    done("design", "--data", pictures, "--size", 4, *TRAINED, *OPTICS, "-o", file)
    done("dmd", "export", file, "--dmd", "64x48", "--dwell", "4ms", "-o", patterns)
    assert "averaged to 4x4 pixels" in done(*shown)
    scenes = json.loads((run / "acquisition.json").read_text())["scenes"]
    assert next(scene["name"] for scene in scenes) == first.name
    assert all("hash" in scene for scene in scenes)


def test_a_virtual_detector_says_what_its_efficiency_leaves(done, pictures, patterns, tmp_path):
    words = ("camera", "simulate", patterns, "--scene", pictures / "ash", "--exposure", "5ms")
    light = ("--flux", "1e6", "-o")
    said = done(*words, *light, tmp_path / "pmt", "--virtual", "pmt")
    assert "5000 photons in an exposure, of which an efficiency of 0.2 leaves 1000" in said
    assert "efficiency" not in done(*words, *light, tmp_path / "ideal", "--virtual", "ideal")


def test_few_and_unequal_pictures_are_told(done, tmp_path):
    """Noise has no class: what is learned by heart says nothing of others, at any light."""
    rng = np.random.default_rng(6)
    for label, count in (("ash", 80), ("oak", 40)):
        save_images(tmp_path / "noise" / label, rng.integers(0, 256, (count, 8, 8), np.uint8))
    words = ("design", "--data", tmp_path / "noise", "--masks", 32, "--photons", "1e6")
    said = done(*words, "--epochs", 30, "-o", tmp_path / "noise.safetensors")
    assert "note: classes have 32 to 64 training scenes" in said
    assert "`training.balance` of a recipe, weighs all alike" in said
    assert "in ten times the light: give more pictures, not more light" in said
    even = {"ash": 30, "oak": 30, "yew": 30}
    words = ("design", "--data", save_pictures(tmp_path / "leaves", even), "--photons", "1e6")
    said = done(*words, "--masks", 8, "--epochs", 20, "-o", tmp_path / "even.safetensors")
    assert "balance`" not in said
    assert "not more light" not in said

"""Commands on adaptive masks: made, tested, drawn, stopped; refused where masks must be known."""

import json

import numpy as np
import pytest

from deepfsi import load_design


@pytest.fixture(scope="module")
def file(tmp_path_factory, digits):
    from deepfsi import learn

    made = learn(digits.hold_out(900), design="adaptive", masks=3, photons=1e4)
    return made.save(tmp_path_factory.mktemp("adaptive") / "a.safetensors")


def test_a_design_is_made_and_tested(done, tmp_path):
    out = tmp_path / "a.safetensors"
    made = ("design", "--design", "adaptive", "--masks", 2, "--photons", "1e3", "--hold-out", 1100)
    assert "adaptive with 2 looks" in done(*made, "-o", out)
    before = load_design(out).prior.arrays
    done(*made, "-o", out)  # of the same settings, it may be replaced
    again = load_design(out).prior.arrays
    assert all(np.array_equal(before[name], again[name]) for name in before | again)


def test_clusters_stand_for_the_scenes(done, refuse, tmp_path):
    made = ("design", "--design", "adaptive", "--masks", 2, "--photons", "1e3", "--clusters")
    sizes = []
    for count in (2, 40):
        done(*made, count, "-o", tmp_path / f"{count}.safetensors")
        sizes.append((tmp_path / f"{count}.safetensors").stat().st_size)
    assert sizes[0] < sizes[1]
    told = refuse(*made, 400, "-o", tmp_path / "many.safetensors")
    assert "400 clusters of each class are too many" in told
    assert not (tmp_path / "many.safetensors").exists()


def test_it_is_evaluated_with_its_looks(done, file):
    told = json.loads(done("evaluate", file, "--photons", "1e4", "--draws", 1, "--json"))
    [result] = told["results"]
    assert len(result["photons_per_mask"]) == 3
    assert 0.3 < result["accuracy"] < 1
    assert (told["detectors"], told["readout"]) == (1, "difference")


def test_one_exposure_is_drawn(done, file, tmp_path):
    out = tmp_path / "looks.png"
    done("show", file, "-o", out)
    assert out.read_bytes().startswith(b"\x89PNG")


def test_a_camera_runs_with_it_and_replays_its_run(done, file, tmp_path):
    told = json.loads(done("dmd", "export", file, "-o", tmp_path / "patterns", "--json"))
    assert (told["looks"], told["mask_frames"], told["load_s"]) == (3, 1, 3.3e-3)
    done("data", "export", "digits", "--per-class", 1, "-o", tmp_path / "scenes")
    shown = ("--scene", tmp_path / "scenes", "--exposure", "10ms", "--flux", "1e6")
    done("camera", "live", tmp_path / "patterns", *shown, "-o", tmp_path / "run")
    again = json.loads(done("camera", "classify", file, tmp_path / "run", "--json"))
    assert [each["agrees"] for each in again["scenes"]] == [True] * 10
    assert {each["looks"] for each in again["scenes"]} == {3}


def test_a_page_is_written(done, refuse, file, tmp_path):
    out = tmp_path / "a.html"
    told = json.loads(done("page", file, "-o", out, "--json"))
    assert [point["photons"] for point in told["curve"]] == [10.0**power for power in range(1, 8)]
    assert told["test"]["images"] == 300
    assert told["rules"] == []
    assert "knows the 537 training scenes" in out.read_text()
    assert "end the name in .html" in refuse("page", file, "-o", tmp_path / "a")


def test_it_stops_early(done, file):
    told = json.loads(done("stop", file, "--photons", "1e4", "--draws", 1, "--json"))
    assert told["rule"]["after"] == [1, 2, 3]


@pytest.mark.parametrize(
    "words",
    [
        "export FILE -o a.onnx",
        "predict FILE . --photons 1e4",
        "camera classify FILE counts.csv --photons 1e4",
    ],
)
def test_what_needs_masks_beforehand_refuses_it(refuse, file, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    told = refuse(*words.replace("FILE", str(file)).split())
    assert "makes its masks while the camera looks" in told
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("option", [("--ideal",), ("--first", 2)])
def test_options_of_known_masks_are_refused(refuse, file, option):
    assert "leave --ideal and --first out" in refuse("evaluate", file, "--photons", "1e4", *option)


def test_it_stops_by_the_rule_that_is_written(done, file, tmp_path):
    out = tmp_path / "b.safetensors"
    done("stop", file, "--photons", "1e4", "--threshold", 0.6, "--draws", 1, "-o", out)
    counts = [
        json.loads(done("evaluate", each, "--photons", "1e4", "--draws", 1, "--json"))["results"][
            0
        ]["counts"]
        for each in (file, out)
    ]
    assert counts[1] < 0.95 * counts[0]

"""Commands on adaptive masks: made, tested, drawn, stopped; refused where masks must be known."""

import json

import numpy as np
import pytest

from deepfsi import load_design, predict
from deepfsi.datasets import write_display


@pytest.fixture(scope="module")
def file(tmp_path_factory, digits):
    from deepfsi import learn

    made = learn(digits.hold_out(900), design="adaptive", masks=3, photons=1e4)
    return made.save(tmp_path_factory.mktemp("adaptive") / "a.safetensors")


def test_a_design_is_made_and_tested(done, tmp_path):
    out = tmp_path / "a.safetensors"
    made = ("design", "--design", "adaptive", "--masks", 2, "--photons", "1e3", "--hold-out", 1100)
    assert "adaptive with 2 looks" in done(*made, "-o", out)
    before = load_design(out).prior_exposure.prior.arrays
    done(*made, "-o", out)  # of the same settings, it may be replaced
    again = load_design(out).prior_exposure.prior.arrays
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


def test_one_exposure_is_drawn(done, file, tmp_path):
    out = tmp_path / "looks.png"
    done("show", file, "-o", out)
    assert out.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    "words",
    [
        "export FILE -o a.onnx",
        "camera classify FILE counts.csv --photons 1e4",
    ],
)
def test_what_needs_masks_beforehand_refuses_it(refuse, file, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    told = refuse(*words.replace("FILE", str(file)).split())
    assert "makes its masks while the camera looks" in told
    assert not list(tmp_path.iterdir())


def test_it_classifies_pictures_as_the_function_does(done, file, digits, tmp_path):
    """Masks are made for each picture while it is exposed."""
    write_display(digits, tmp_path / "p", per_class=1)
    told = json.loads(done("predict", file, tmp_path / "p", "--photons", "1e4", "--json"))
    found = predict(load_design(file), tmp_path / "p", 1e4)
    assert [each["class"] for each in told["pictures"]] == [p.predicted for p in found.pictures]
    assert told["score"]["new"] == found.score.new.as_dict()
    assert f"{len(found.pictures)} pictures" in done("predict", file, tmp_path / "p")


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

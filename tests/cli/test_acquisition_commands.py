"""An acquisition of one's own laboratory: prepared, wired, recorded, counted."""

import json
import shutil

import pytest

from deepfsi.hardware.patterns import read_patterns
from hardware.counting.recording_samples import DWELL, Run, patterns_of, shining, train

LIST = "name,label\nfirst,cat\nsecond,dog\nthird,\n"


@pytest.fixture
def lab(tmp_path):
    """Patterns, and a list of three scenes."""
    patterns_of(tmp_path / "patterns")
    patterns_of(tmp_path / "arms", "two-arm")
    (tmp_path / "scenes.csv").write_text(LIST)
    return tmp_path


def prepared(done, lab, *words, patterns="patterns"):
    run = lab / "run"
    given = ["--scenes", lab / "scenes.csv", "-o", run, *words]
    out = json.loads(done("camera", "prepare", lab / patterns, *given, "--json"))
    content = json.loads((run / "acquisition.json").read_text())
    assert (out["folder"], out["acquisition"]) == (str(run), content)
    return run, content


def test_the_longest_exposure_ends_before_the_next_marker_may_come(done, lab):
    run, content = prepared(done, lab)
    assert content["exposure_s"] == pytest.approx(11 * (DWELL - 1e-5 - 1e-5))
    assert (content["inputs"], content["marker_bit"], content["repeats"]) == ([0], 1, 1)
    shutil.rmtree(run)
    _, content = prepared(done, lab, "--repeats", 4)
    assert content["exposure_s"] == pytest.approx(11 * (DWELL - 2e-5) / 4)
    assert content["repeats"] == 4


def test_two_arms_have_two_inputs(done, refuse, lab):
    _, content = prepared(done, lab, "--input", 2, "--input", 1, patterns="arms")
    assert content["inputs"] == [1, 0]
    words = ["--scenes", lab / "scenes.csv", "-o", lab / "other"]
    assert "need 2" in refuse("camera", "prepare", lab / "arms", *words, "--input", 1)
    assert "an input of its own" in refuse(
        "camera", "prepare", lab / "arms", *words, "--input", 1, "--input", 1
    )


def test_pictures_are_a_list_of_scenes_too(done, lab):
    done("data", "export", "digits", "--per-class", 1, "-o", lab / "images")
    (lab / "scenes.csv").unlink()
    shutil.move(lab / "images", lab / "scenes.csv")  # a folder of that name
    patterns_of(lab / "masks", file=None)  # no design that could see the pictures
    _, content = prepared(done, lab, patterns="masks")
    assert [scene["label"] for scene in content["scenes"]] == [str(k) for k in range(10)]


def record(run) -> Run:
    """Photons on input 3, markers with bit 4: marker input 2."""
    patterns = read_patterns(run / "patterns")
    starts = train(patterns.manifest, 3)
    light = shining(patterns, 3)
    recorded = Run(run, patterns, starts, light)
    recorded.record(starts, starts.ravel(), light)
    return recorded


def test_a_lab_counts_what_it_prepared(done, lab):
    run, _ = prepared(done, lab, "--input", 3, "--marker", 2)
    recorded = record(run)
    said = json.loads(done("camera", "inspect", run / "photons.ptu", "--json"))
    assert list(said["markers"]) == ["2"]
    assert "3" in said["photons"]
    counted = json.loads(done("camera", "count", run, "--json"))
    assert counted["whole"] == 3
    assert counted["photons_counted"] == recorded.photons[:, 2:-2].sum()


@pytest.mark.parametrize(
    ("rate", "said"),
    [(0.005, "0.50% longer"), (-2e-4, "200.0 ppm shorter")],
)
def test_the_drift_of_the_clocks_is_said(done, lab, rate, said):
    run, _ = prepared(done, lab, "--input", 3, "--marker", 2)
    recorded = record(run)
    starts = train(recorded.patterns.manifest, 3, rate, jitter=1e-13)
    recorded.record(starts, starts.ravel(), recorded.photons)
    assert f"clocks: frames last {said} than planned" in done("camera", "count", run)
    assert json.loads(done("camera", "count", run, "--json"))["drift"] == pytest.approx(
        rate, abs=1e-8
    )


def test_wrong_wiring_is_put_right_when_counting(done, refuse, lab):
    run, _ = prepared(done, lab)
    recorded = record(run)
    assert "0 frame markers" in refuse("camera", "count", run)
    words = ["--input", 3, "--marker", 2]
    counted = json.loads(done("camera", "count", run, *words, "--json"))
    assert counted["photons_counted"] == recorded.photons[:, 2:-2].sum()
    assert counted["inputs"] == [3]
    assert "--input 0: give 1 or more" in refuse("camera", "count", run, "--input", 0)
    assert "2 inputs are given" in refuse("camera", "count", run, "--input", 1, "--input", 2)
    assert "--input 65" in refuse("camera", "count", run, "--input", 65)

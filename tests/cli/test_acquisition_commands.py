"""An acquisition of one's own laboratory: prepared, wired, recorded, counted."""

import json

import pytest

from deepfsi.hardware.patterns.folder import Patterns
from hardware.counting.recording_samples import DWELL, Run, patterns_of, shining, train


@pytest.fixture
def lab(tmp_path):
    """Patterns, and a list of three scenes."""
    patterns_of(tmp_path / "patterns")
    patterns_of(tmp_path / "arms", "two-arm")
    (tmp_path / "scenes.csv").write_text("name,label\nfirst,cat\nsecond,dog\nthird,\n")
    return tmp_path


@pytest.fixture
def prepare(done, lab):
    """Prepare a run; gives its folder and what is written of it."""

    def run(*words, patterns="patterns"):
        given = ["--scenes", lab / "scenes.csv", "-o", lab / "run", *words]
        out = json.loads(done("camera", "prepare", lab / patterns, *given, "--json"))
        content = json.loads((lab / "run" / "acquisition.json").read_text())
        assert (out["folder"], out["acquisition"]) == (str(lab / "run"), content)
        return lab / "run", content

    return run


@pytest.mark.parametrize("repeats", [1, 4])
def test_the_longest_exposure_ends_before_the_next_marker_may_come(prepare, repeats):
    _, content = prepare("--repeats", repeats)
    assert content["exposure_s"] == pytest.approx(11 * (DWELL - 2e-5) / repeats)
    assert (content["inputs"], content["marker_bit"], content["repeats"]) == ([0], 1, repeats)


def test_two_arms_have_two_inputs(prepare, refuse, lab):
    _, content = prepare("--input", 2, "--input", 1, patterns="arms")
    assert content["inputs"] == [1, 0]
    words = ["camera", "prepare", lab / "arms", "--scenes", lab / "scenes.csv", "-o", lab / "other"]
    assert "need 2" in refuse(*words, "--input", 1)
    assert "an input of its own" in refuse(*words, "--input", 1, "--input", 1)


def record(folder):
    """Record photons on input 3 and markers with bit 4, marker input 2."""
    patterns = Patterns.read(folder / "patterns")
    starts = train(patterns.manifest, 3)
    recorded = Run(folder, patterns, starts, shining(patterns, 3))
    recorded.record(starts, starts.ravel(), recorded.photons)
    return recorded


WIRED = ("--input", 3, "--marker", 2)


@pytest.mark.parametrize("wired", [True, False])
def test_a_lab_counts_what_it_prepared_and_wrong_wiring_is_put_right(done, refuse, prepare, wired):
    run, _ = prepare(*(WIRED if wired else ()))
    recorded = record(run)
    said = json.loads(done("camera", "inspect", run / "photons.ptu", "--json"))
    assert list(said["markers"]) == ["2"]
    assert "3" in said["photons"]
    if not wired:
        assert "0 frame markers" in refuse("camera", "count", run)
        assert "--input 0: give 1 or more" in refuse("camera", "count", run, "--input", 0)
        assert "2 inputs are given" in refuse("camera", "count", run, "--input", 1, "--input", 2)
        assert "--input 65" in refuse("camera", "count", run, "--input", 65)
    counted = json.loads(done("camera", "count", run, *(() if wired else WIRED), "--json"))
    assert (counted["whole"], counted["inputs"]) == (3, [3])
    assert counted["photons_counted"] == recorded.photons[:, 2:-2].sum()

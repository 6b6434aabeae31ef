"""A recording of one's own laboratory: imported, wired, counted."""

import json

import pytest

from counting.recording_samples import DWELL, Run, patterns_of, shining, train
from deepfsi.patterns.folder import Patterns


@pytest.fixture
def lab(tmp_path):
    """Patterns, a list of three scenes, and their photons on input 3, with markers on input 2."""
    patterns_of(tmp_path / "patterns")
    patterns_of(tmp_path / "arms", "two-arm")
    (tmp_path / "scenes.csv").write_text("name,label\nfirst,cat\nsecond,dog\nthird,\n")
    patterns = Patterns.read(tmp_path / "patterns")
    starts = train(patterns.manifest, 3)
    recorded = Run(tmp_path, patterns, starts, shining(patterns, 3))
    recorded.record(starts, starts.ravel(), recorded.photons)
    return recorded


@pytest.fixture
def words(lab):
    """Give the words of an import."""

    def of(*others, patterns="patterns", run="run"):
        folder = lab.folder
        given = ["--scenes", folder / "scenes.csv", "-o", folder / run, *others]
        photons = folder / "photons.ptu"
        return ["camera", "import", photons, "--patterns", folder / patterns, *given]

    return of


@pytest.fixture
def imported(done, lab, words):
    """Import the recording; gives its folder and what is written of it."""

    def run(*others, **where):
        out = json.loads(done(*words(*others, **where), "--json"))
        content = json.loads((lab.folder / "run" / "acquisition.json").read_text())
        assert (out["folder"], out["acquisition"]) == (str(lab.folder / "run"), content)
        return lab.folder / "run", content

    return run


@pytest.mark.parametrize("repeats", [1, 4])
def test_the_longest_exposure_ends_before_the_next_marker_may_come(imported, repeats):
    _, content = imported("--repeats", repeats)
    assert content["exposure_s"] == pytest.approx(11 * (DWELL - 2e-5) / repeats)
    assert (content["inputs"], content["marker_bit"], content["repeats"]) == ([0], 1, repeats)


def test_two_arms_have_two_inputs(imported, refuse, words):
    _, content = imported("--input", 2, "--input", 1, patterns="arms")
    assert content["inputs"] == [1, 0]
    others = {"patterns": "arms", "run": "other"}
    assert "need 2" in refuse(*words("--input", 1, **others))
    assert "an input of its own" in refuse(*words("--input", 1, "--input", 1, **others))


WIRED = ("--input", 3, "--marker", 2)


@pytest.mark.parametrize("wired", [True, False])
def test_a_lab_counts_its_recording_and_wrong_wiring_is_put_right(
    done, refuse, lab, imported, wired
):
    run, _ = imported(*(WIRED if wired else ()))
    said = json.loads(done("camera", "inspect", run / "photons.ptu", "--json"))
    assert list(said["markers"]) == ["2"]
    assert "3" in said["photons"]
    if not wired:
        assert "0 frame markers" in refuse("camera", "count", run)
        settings = json.loads((run / "acquisition.json").read_text())
        right = settings | {"inputs": [2], "marker_bit": 4}
        (run / "acquisition.json").write_text(json.dumps(right))
    counted = json.loads(done("camera", "count", run, "--json"))
    assert (counted["exposures"], counted["inputs"]) == (3, [3])
    assert counted["photons_counted"] == lab.photons[:, 2:-2].sum()


def test_time_stamps_become_a_photon_file(done, refuse, tmp_path):
    """A trigger on channel 8 and three detections; what is imported is whole or not there."""
    stamps, photons = tmp_path / "tags.csv", tmp_path / "photons.ptu"
    stamps.write_text("time,channel\n0,8\n5,3\n9,3\n12,3\n")
    given = ("camera", "import", stamps, "--marker-channel", 8, "-o", photons)
    assert "give their --unit" in refuse(*given)
    assert "channel 7 has no events" in refuse(*given, "--unit", "1ps", "--channel", 7)
    done(*given, "--unit", "1ps")
    said = json.loads(done("camera", "inspect", photons, "--json"))
    assert (said["photons"], said["markers"]) == ({"1": 3}, {"0": 1})
    assert "exists already" in refuse(*given, "--unit", "1ps")
    assert "give --scenes" in refuse(*given[:-1], tmp_path / "run", "--patterns", tmp_path)

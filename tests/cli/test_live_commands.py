"""Live runs at the command line: decisions as they fall, Ctrl-C, counts and classes of a run."""

import fcntl
import json
import signal
import subprocess
import sys

import pytest

from deepfsi.datasets.display import write_pictures
from shared.live_samples import make_patterns

LIGHT = ["--flux", "1e7", "--exposure", "10ms", "--virtual", "ideal"]


@pytest.fixture(scope="module")
def lab(tmp_path_factory, digits):
    """Patterns of adaptive masks on a small device, and scenes."""
    folder = tmp_path_factory.mktemp("lab")
    make_patterns(folder, digits, photons=1e5)
    shown = [(f"{y}/{k}.png", digits.x_test[k].reshape(8, 8)) for k, y in enumerate(digits.y_test)]
    for count, name in ((3, "images"), (150, "many")):
        write_pictures(dict(shown[:count]), folder / name)
    return folder


def test_each_decision_is_printed_and_a_run_is_classified(done, refuse, lab, made, tmp_path):
    run = tmp_path / "run"
    out = done("camera", "live", lab / "patterns", "--scene", lab / "images", *LIGHT, "-o", run)
    lines = [line for line in out.splitlines() if ", clock " in line and "confidence" in line]
    assert len(lines) == 3
    for line in lines:
        assert "confidence 0." in line or "confidence 1." in line
        assert "3 looks, light 10 ms" in line
    assert "right: " in out
    assert "3 scenes do not exclude that the picture on the device is" in out
    assert "lags by a whole scene cannot be seen" in out
    out = done("camera", "classify", lab / "adaptive.safetensors", run)
    assert "a live run, as it was decided" in out
    fixed = made("deepfsi", "free-dwell", "single").save(tmp_path / "fixed.safetensors")
    assert "while it is recorded" in refuse("camera", "count", run)
    assert "not the design" in refuse("camera", "classify", fixed, run)


@pytest.mark.skipif(not hasattr(fcntl, "F_SETPIPE_SZ"), reason="needs pipes of Linux")
def test_ctrl_c_keeps_the_scenes_that_are_finished(done, lab, tmp_path):
    """The program waits for its full pipe when the signal comes, so it is never done before."""
    words = ["camera", "live", lab / "patterns", "--scene", lab / "many", *LIGHT]
    process = subprocess.Popen(
        [sys.executable, "-m", "deepfsi", *map(str, words), "-o", str(tmp_path / "run")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    fcntl.fcntl(process.stdout, fcntl.F_SETPIPE_SZ, 4096)
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert b"finished scenes are kept" in errors
    told = done("camera", "classify", lab / "adaptive.safetensors", tmp_path / "run", "--json")
    scenes = json.loads(told)["scenes"]
    assert 1 <= len(scenes) < 150


def test_a_run_in_which_no_scene_has_light_ends_with_an_error(call, lab, tmp_path):
    """Its scenes are named, and its folder is kept."""
    words = [lab / "patterns", "--scene", lab / "images", *LIGHT, "--flux", "1e-9"]
    code, out, errors = call("camera", "live", *words, "-o", tmp_path / "run")
    assert code == 2
    assert out.count("no light") == 3
    assert "no scene of" in errors
    assert (tmp_path / "run" / "photons.ptu").exists()

"""Live runs at the command line: decisions as they fall, Ctrl-C, counts and classes of a run."""

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
from click.testing import CliRunner

from conftest import quick
from deepfsi import Design
from deepfsi.camera import StopRule
from deepfsi.cli import app
from deepfsi.datasets import write_pictures
from deepfsi.hardware.counting import read_run

LIGHT = ["--flux", "1e7", "--exposure", "10ms", "--virtual", "ideal"]


@pytest.fixture(scope="module")
def lab(tmp_path_factory, digits):
    """A design of three looks, its patterns on a small device, and scenes."""
    folder = tmp_path_factory.mktemp("lab")
    optics = {"light": "free-dwell", "rails": "single", "levels": 2}
    kept = digits.hold_out(300)
    quick(kept, masks=12, looks=3, photons=1e5, epochs=8, **optics).save(
        folder / "looks.safetensors"
    )
    for count, name in ((3, "images"), (40, "some"), (150, "many")):
        pictures = {
            f"{digits.y_test[k]}/{k}.png": digits.x_test[k].reshape(8, 8) for k in range(count)
        }
        write_pictures(pictures, folder / name)
    words = ["dmd", "export", folder / "looks.safetensors", "--device", "64x48"]
    told = CliRunner().invoke(app, [*map(str, words), "-o", str(folder / "patterns")])
    assert told.exit_code == 0, told.output
    return folder


def test_each_decision_is_printed_and_a_replay_agrees(done, lab, tmp_path):
    run = tmp_path / "run"
    out = done("camera", "live", lab / "patterns", "--scene", lab / "images", *LIGHT, "-o", run)
    lines = [line for line in out.splitlines() if ", clock " in line and "confidence" in line]
    assert len(lines) == 3
    for line in lines:
        assert "confidence 0." in line or "confidence 1." in line
        assert "3 looks, light 10 ms (100%)" in line
    assert "right: " in out
    out = done("camera", "classify", lab / "looks.safetensors", run)
    assert "as decided in the run, bit for bit: 3 of 3 scenes" in out
    assert "a live run: 3 scenes, 9 looks" in done("camera", "count", run)
    assert done("camera", "classify", lab / "looks.safetensors", run) == out


def test_patterns_of_looks_are_not_recorded_as_a_sequence(refuse, lab, tmp_path):
    words = ["--scenes", lab / "images", "-o", tmp_path / "run"]
    assert "use `deepfsi camera live`" in refuse("camera", "prepare", lab / "patterns", *words)
    words = [
        "--scene",
        lab / "images",
        "--flux",
        "1e7",
        "--exposure",
        "5ms",
        "-o",
        tmp_path / "run",
    ]
    assert "use `deepfsi camera live`" in refuse("camera", "simulate", lab / "patterns", *words)
    assert not (tmp_path / "run").exists()


def test_a_design_file_is_exported_for_the_moment(done, lab, tmp_path):
    words = ["--scene", lab / "images" / sorted(os.listdir(lab / "images"))[0], *LIGHT]
    done("camera", "live", lab / "looks.safetensors", *words, "-o", tmp_path / "run")
    patterns = read_run(tmp_path / "run").patterns
    assert patterns.manifest.device.name == "dlp7000"
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_the_rule_of_the_design_stops_its_exposures(done, lab, tmp_path):
    sure = tmp_path / "sure.safetensors"
    done("stop", lab / "looks.safetensors", "--photons", "1e5", "--draws", 1, "--threshold", 0.5,
         "-o", sure)  # fmt: skip
    rule = StopRule.model_validate(Design.load(sure).info["stopping"])
    assert rule.threshold == 0.5
    assert rule.photons == 1e5
    done("dmd", "export", sure, "--device", "64x48", "-o", tmp_path / "p")
    words = ["--scene", lab / "some", *LIGHT]
    done("camera", "live", tmp_path / "p", *words, "-o", tmp_path / "run")
    live = read_run(tmp_path / "run").acquisition.live
    assert live.rule == rule
    done("camera", "count", tmp_path / "run")
    told = json.loads(done("camera", "classify", sure, tmp_path / "run", "--json"))["scenes"]
    assert all(each["agrees"] for each in told)
    assert {each["looks"] for each in told} > {3}


def test_the_accuracy_is_that_of_evaluate(done, lab, tmp_path, digits):
    """150 scenes of `lab`, within five standard deviations of the test set's accuracy."""
    words = ["--scene", lab / "many", *LIGHT, "-o", tmp_path / "run", "--json"]
    live = json.loads(done("camera", "live", lab / "patterns", *words))["scenes"]
    right = np.mean([each["class"] == each["label"] for each in live])
    words = ["evaluate", lab / "patterns", "--photons", "1e5", "--json"]
    accuracy = json.loads(done(*words))["results"][0]["accuracy"]
    spread = np.sqrt(accuracy * (1 - accuracy) * (1 / 150 + 1 / len(digits.y_test)))
    assert abs(right - accuracy) < 5 * spread


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
    done("camera", "count", tmp_path / "run")
    told = done("camera", "classify", lab / "looks.safetensors", tmp_path / "run", "--json")
    scenes = json.loads(told)["scenes"]
    assert 1 <= len(scenes) < 150
    assert all(each["agrees"] for each in scenes)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--projector dlp", "unknown projector"),
        ("--projector vialux", "do not go together"),
        ("--counter-config levels.ini", "for --counter picoquant"),
        ("--alp-version 4.1", "for --projector vialux"),
        ("--latency comand=1ms", "did you mean 'command'"),
        ("--latency command=fast", "is not a time"),
        ("--latency block=0", "block"),
        ("--until 2", "--until between 0 and 1"),
        ("--shortest-dwell 1s", "shortest_dwell"),
        ("--exposure 0", "exposure = '0': give more than 0"),
        ("--flux 1e14", "flux"),
        ("--flux 1e12", "--yes"),
        ("--flux -1", "flux"),
        ("--flux 0", "flux = '0': give more than 0"),
        ("--input 1 --input 1", "an input of its own"),
        ("--input 1 --input 2", "2 inputs"),
        ("--input 40 --input 41", "inputs"),
        ("--exposure 1e9s", "hold"),
    ],
)
def test_bad_words_are_refused_in_one_line(refuse, lab, tmp_path, words, message):
    run = ["camera", "live", lab / "patterns", "--scene", lab / "images", *LIGHT]
    assert message in refuse(*run, "-o", tmp_path / "run", *words.split())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("", "ALP4lib"),
        ("--counter-config levels.ini", "levels.ini"),
        ("--flux 1e7", "--flux is for virtual devices"),
        ("--virtual pmt", "--virtual is for virtual devices"),
        ("--latency command=1ms", "--latency is for virtual devices"),
        ("--seed 0", "--seed is for virtual devices"),
        ("--yes", "--yes is for virtual devices"),
    ],
)
def test_real_devices_refuse_words_of_virtual_ones(refuse, lab, tmp_path, words, message):
    run = ["--scene", lab / "images", "--exposure", "10ms", "-o", tmp_path / "run"]
    real = ["--projector", "vialux", "--counter", "picoquant", *words.split()]
    assert message in refuse("camera", "live", lab / "patterns", *run, *real)


def test_live_runs_with_a_dlpc900_are_refused(refuse, lab, tmp_path):
    words = ["--scene", lab / "images", "--exposure", "10ms", "-o", tmp_path / "run"]
    real = ["--projector", "dlpc900", "--counter", "picoquant"]
    told = refuse("camera", "live", lab / "patterns", *words, *real)
    assert "deepfsi camera record" in told
    assert not (tmp_path / "run").exists()


def test_virtual_devices_need_a_flux(refuse, lab, tmp_path):
    words = ["--scene", lab / "images", "--exposure", "10ms", "-o", tmp_path / "run"]
    assert "--flux" in refuse("camera", "live", lab / "patterns", *words)


def test_a_run_in_which_no_scene_has_light_ends_with_an_error(call, lab, tmp_path):
    """Its scenes are named, and its folder is kept."""
    words = [
        "--scene",
        lab / "images",
        "--exposure",
        "10ms",
        "--flux",
        "1e-9",
        "--virtual",
        "ideal",
    ]
    run = ["camera", "live", lab / "patterns", *words, "-o", tmp_path / "run"]
    code, out, errors = call(*map(str, run))
    assert code == 2
    assert {line.rpartition(": ")[2] for line in out.splitlines()} == {"no light"}
    assert "no scene of" in errors
    assert (tmp_path / "run" / "photons.ptu").exists()


def test_designs_and_runs_that_do_not_fit_are_refused(refuse, done, lab, made, tmp_path):
    fixed = made("deepfsi", "free-dwell", "single").save(tmp_path / "fixed.safetensors")
    words = ["--scene", lab / "images", *LIGHT, "-o", tmp_path / "other"]
    assert "fixed dwells" in refuse("camera", "live", fixed, *words)
    done("camera", "live", lab / "patterns", "--scene", lab / "images", *LIGHT,
         "-o", tmp_path / "run")  # fmt: skip
    done("camera", "count", tmp_path / "run")
    assert "as it was" in refuse("camera", "count", tmp_path / "run", "--exposure", "1ms")
    assert "a live run" in refuse("camera", "image", tmp_path / "run")
    assert "not the design" in refuse("camera", "classify", fixed, tmp_path / "run")
    shutil.rmtree(tmp_path / "run" / "calibration")


def test_a_run_and_its_replay_need_no_torch(lab, tmp_path):
    words = ["--scene", str(lab / "images"), *LIGHT, "-o", str(tmp_path / "run")]
    commands = [
        ["deepfsi", "camera", "live", str(lab / "patterns"), *words],
        ["deepfsi", "camera", "classify", str(lab / "looks.safetensors"), str(tmp_path / "run")],
    ]
    code = (
        "import contextlib, sys\n"
        "from deepfsi.cli import run_command_line\n"
        f"for sys.argv in {commands!r}:\n"
        "    with contextlib.suppress(SystemExit):\n"
        "        run_command_line()\n"
        "assert 'torch' not in sys.modules\n"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert told.returncode == 0, told.stderr
    assert "3 of 3 scenes" in told.stdout

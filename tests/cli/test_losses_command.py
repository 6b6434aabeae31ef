"""`deepfsi plan --losses`: the light of a named camera, of a file and of a design, and refusals."""

import json

import pytest

from conftest import quick
from deepfsi import evaluate

LAB = """
device = "dlp7000"
exposure = "10ms"
flux = 1e6
dead_time = "20ns"
"""


@pytest.fixture(scope="module")
def folder(digits, tmp_path_factory):
    """A camera file, and a design of that camera."""
    folder = tmp_path_factory.mktemp("losses")
    (folder / "lab.toml").write_text(LAB)
    (folder / "none.npy").write_bytes(b"")
    design = quick(digits, masks=6, photons=1e4, camera=str(folder / "lab.toml"), epochs=2)
    design.save(folder / "a.safetensors")
    return folder


@pytest.fixture
def losses(done, folder, monkeypatch):
    """Losses that the command gives as JSON."""
    monkeypatch.chdir(folder)
    return lambda *words: json.loads(done("plan", "--losses", *words, "--json"))


def test_a_named_camera_needs_nothing_else_and_what_is_assumed_is_said(losses):
    found = losses("--camera", "dmd")
    assert found["schema"] == "deepfsi.plan.losses/1"
    assert found["throughput"] == pytest.approx(0.5)
    assert found["gates_s"] == pytest.approx(0.024)
    assert [text.split(",")[0] for text in found["assumed"]] == [
        "device dlp7000", "24 masks with half of the mirrors ON", "exposure 24 ms"
    ]  # fmt: skip
    assert losses("--camera", "two-arm")["throughput"] == pytest.approx(1)
    quarter = losses("--camera", "dmd-2x2", "--masks", 6, "--exposure", "6ms")
    assert quarter["gates_s"] == pytest.approx(6e-3)
    assert "8 detectors" in [each["change"] for each in quarter["changes"]]


def test_a_camera_file_says_its_times_and_what_dead_time_takes(losses):
    found = losses("--camera", "lab.toml", "--masks", 10, "--efficiency", 0.25)
    assert found["arriving"] == pytest.approx(4e6 * found["clock_s"])
    assert found["registered"] == pytest.approx(1 / (1 + 0.5e6 * 20e-9))
    assert [text.split(" ")[0] for text in found["assumed"]] == ["10"]


def test_a_design_gives_its_own_throughput(losses, digits, folder):
    """That of `evaluate`, in the mean over training scenes; its camera is that of the training."""
    from deepfsi import load_design

    found = losses("a.safetensors")
    [result] = evaluate(load_design(folder / "a.safetensors"), digits, 1e4)
    # the shares of its frames may leave a part of the exposure
    assert 0.8 < found["gates_s"] / 0.01 <= 1 + 1e-6
    share = found["throughput"] * found["gates_s"] / 0.01
    assert share == pytest.approx(result.throughput, rel=1e-4)
    assert found["assumed"] == []
    longer = losses("a.safetensors", "--exposure", "20ms")
    assert longer["gates_s"] == pytest.approx(2 * found["gates_s"])
    assert longer["throughput"] == found["throughput"]


def test_adaptive_masks_wait_for_loads_and_decisions(losses):
    found = losses("adaptive-mnist", "--decision", "2ms")
    assert found["waits_s"]["loading"] == pytest.approx(32 * 3.3e-3)
    assert found["waits_s"]["decision"] == pytest.approx(32 * 2e-3)
    assert 0.1 < found["throughput"] < 0.15
    ready = next(each for each in found["changes"] if "before" in each["change"])
    left = found["clock_s"] - sum(found["waits_s"].values()) + found["waits_s"]["loading"]
    assert ready["factor"] == pytest.approx(left / found["gates_s"])


def test_the_table_has_each_cause_and_what_stays(done, folder, monkeypatch):
    monkeypatch.chdir(folder)
    out = done("plan", "--losses", "a.safetensors", "--flux", "1e6")
    for words in ("mirrors that are OFF", "all-ON and all-OFF", "counted", "a second arm"):
        assert words in out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--target 0.5", "--target is of trainings, and --losses trains nothing"),
        ("--epochs 5", "--epochs is of trainings"),
        ("--photons 1e4", "--photons is of trainings"),
        ("--data digits", "--data is of trainings"),
        ("-o out", "--out is of trainings"),
        ("--masks 0", "--masks 0 is not allowed: give 1 to"),
        ("--masks 1e9", "is not allowed: give 1 to"),
        ("--masks 3,4", "'3,4' is not a number"),
        ("a.safetensors --masks 3", "--masks is the number without a design"),
        ("nosuch.safetensors", "no design file at nosuch.safetensors"),
        ("none.npy", "none.npy is not a whole deepfsi design file"),
        ("--camera nosuch", "unknown camera 'nosuch'"),
        ("--camera nosuch.toml", "nosuch.toml"),
        ("--camera paper", "column is no mirror device"),
        ("--light dose", "dose is no mirror device"),
        ("--efficiency 0", "--efficiency 0: give"),
        ("--efficiency 1.5", "--efficiency 1.5: give"),
        ("--decision never", "--decision"),
        ("--exposure 1ns", "give a longer"),
        ("--exposure 0", "exposure = '0': give more than 0"),
        ("--dmd dlp4500 --masks 100", "104 frames do not fit dlp4500"),
        ("adaptive-mnist --dmd dlp6500", "dlp6500 takes no frame then"),
        ("a.safetensors --light two-arm --rails dual", "for 1 arm with 1 detector, and this"),
        ("a.safetensors --camera dmd-2x2", "this camera has 1 arm with 4 detectors"),
        ("--camera lab.toml --device cuda", "--device is of trainings"),
    ],
)
def test_what_cannot_be_is_one_line_and_exit_code_2(call, folder, monkeypatch, words, message):
    monkeypatch.chdir(folder)
    code, out, errors = call("plan", "--losses", *words.split())
    assert code == 2
    assert message in errors
    assert errors.count("\n") == 1
    assert not out

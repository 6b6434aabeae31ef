"""`camera record`: a projector and a counter record a fixed design, which is then counted."""

import io
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepfsi.base import InputError
from deepfsi.camera import find_device
from deepfsi.datasets import write_pictures
from deepfsi.hardware.calibration import scan_rails
from deepfsi.hardware.counting import Acquisition, Scene, count_run, read_counts, read_run
from deepfsi.hardware.drivers import swabian as swabian_module
from deepfsi.hardware.live import run as record
from deepfsi.hardware.patterns import FrameSettings, export_patterns, read_patterns
from deepfsi.hardware.virtual import CAMERAS, Latencies, arrival_rates, virtual_setup
from hardware.drivers import swabian_fake

FLUX, EXPOSURE, SCENES = 1e7, 10e-3, 5
LIGHT = ("--flux", f"{FLUX:g}", "--exposure", "10ms", "--virtual", "ideal")


@pytest.fixture(scope="module")
def lab(tmp_path_factory, digits) -> Path:
    folder = tmp_path_factory.mktemp("record")
    frames = FrameSettings(find_device("64x48"), 1e-3)
    export_patterns(scan_rails("raster", (8, 8)), frames, folder / "patterns")
    pictures = {f"{digits.y_test[k]}/{k}.png": digits.x_test[k].reshape(8, 8) for k in range(5)}
    write_pictures(pictures, folder / "images")
    return folder


def planned(lab: Path, scenes: np.ndarray, **settings):
    """Acquisition of some scenes, and its virtual bench."""
    shown = tuple(Scene(name=str(k)) for k in range(len(scenes)))
    told = {"flux": FLUX, "camera": CAMERAS["ideal"].model_dump(mode="json"), "seed": 1}
    manifest = read_patterns(lab / "patterns").manifest
    acquisition = Acquisition.plan(manifest, shown, exposure_s=EXPOSURE, repeats=1, **told)
    acquisition = acquisition.model_copy(update=settings)
    return acquisition, virtual_setup(lab / "patterns", scenes, acquisition, Latencies())


def test_one_command_records_counts_and_names(done, lab, tmp_path):
    words = ("--scene", lab / "images", *LIGHT, "-o", tmp_path / "run")
    out = done("camera", "record", lab / "patterns", *words)
    lines = [line for line in out.splitlines() if "counts/s in the masks' frames" in line]
    assert len(lines) == SCENES
    assert not any("NO LIGHT" in line for line in lines)
    assert "of them whole" in out
    acquisition = read_run(tmp_path / "run").acquisition
    assert [scene.label for scene in acquisition.scenes] == sorted(
        scene.label for scene in acquisition.scenes
    )
    assert read_counts(tmp_path / "run").valid.all()
    told = json.loads(
        done("camera", "record", lab / "patterns", *words[:-1], tmp_path / "2", "--json")
    )
    assert told["schema"] == "deepfsi.camera.record/1"
    assert told["faults"] == []
    assert told["counts"] == read_counts(tmp_path / "run").counts.tolist()  # of one seed


def test_counts_are_those_that_the_light_says(lab, digits, tmp_path):
    """Each readout's sum over the scenes is Poisson about rate times gate; all of them: chi²."""
    scenes = digits.x_test[:40].reshape(40, 8, 8)
    acquisition, bench = planned(lab, scenes)
    recorded = list(record.record_run(tmp_path / "run", lab / "patterns", acquisition, bench))
    assert all(each.lit for each in recorded)
    counts = count_run(tmp_path / "run")
    manifest = read_patterns(lab / "patterns").manifest
    rates = arrival_rates(lab / "patterns", scenes, CAMERAS["ideal"], FLUX)
    wanted = (rates[:, manifest.shown, 0] * counts.gate_s).sum(axis=0)
    found = counts.counts[:, 0, 0].sum(axis=0)
    chi2 = ((found - wanted) ** 2 / wanted).sum()
    assert abs(chi2 - len(wanted)) < 5 * np.sqrt(2 * len(wanted))
    on = np.array([each.on_rate for each in recorded])
    assert on.mean() == pytest.approx(rates[:, 0].mean(), rel=5 / np.sqrt(FLUX * 2e-3 * 40) + 1e-3)


@pytest.mark.parametrize("late", [False, True])
def test_a_run_that_is_stopped_keeps_its_finished_scenes(lab, digits, tmp_path, late):
    """Before a pass, and while one is shown."""
    acquisition, bench = planned(lab, digits.x_test[:4].reshape(4, 8, 8))
    run = bench.projector.run

    def stopped() -> None:
        frames = np.arange(20)
        bench.projector.show(frames, read_patterns(lab / "patterns").manifest.picture_s[frames])
        raise KeyboardInterrupt

    def display(scene: int) -> None:
        if scene == 2:
            if not late:
                raise KeyboardInterrupt
            bench.projector.run = stopped
        bench.projector._optics.display(scene)

    told = record.record_run(
        tmp_path / "run", lab / "patterns", acquisition, replace(bench, display=display)
    )
    with pytest.raises(KeyboardInterrupt):
        list(told)
    bench.projector.run = run
    assert [scene.name for scene in read_run(tmp_path / "run").acquisition.scenes] == ["0", "1"]
    assert count_run(tmp_path / "run").valid.tolist() == [[True], [True]]


def tagged(lab: Path, scenes: np.ndarray, monkeypatch):
    """The same bench, whose photons and triggers are tags of a fake of a Time Tagger."""
    acquisition, bench = planned(lab, scenes)
    device = swabian_fake.install(monkeypatch)
    bench.projector._optics.written = device
    counter = swabian_module.TaggerCounter(acquisition.inputs, acquisition.marker_bit, trigger=8)
    return device, acquisition, replace(bench, counter=counter)


def test_a_time_tagger_records_what_the_virtual_counter_does(lab, digits, tmp_path, monkeypatch):
    """Tags on channels in blocks that end anywhere become the same run: count by count."""
    scenes = digits.x_test[:3].reshape(3, 8, 8)
    acquisition, bench = planned(lab, scenes)
    usual = list(record.record_run(tmp_path / "usual", lab / "patterns", acquisition, bench))
    device, *settings = tagged(lab, scenes, monkeypatch)
    told = list(record.record_run(tmp_path / "run", lab / "patterns", *settings))
    assert told == usual
    counts = count_run(tmp_path / "run")
    assert counts.valid.all()
    assert np.array_equal(counts.counts, count_run(tmp_path / "usual").counts)
    assert device.steps[-2:] == ["stop", "freeTimeTagger"]


@pytest.mark.parametrize("loss", [False, True])
def test_ctrl_c_or_a_loss_lets_go_of_the_time_tagger_and_keeps_scenes(
    lab, digits, tmp_path, monkeypatch, loss
):
    device, acquisition, bench = tagged(lab, digits.x_test[:4].reshape(4, 8, 8), monkeypatch)

    def display(scene: int) -> None:
        if scene == 2 and not loss:
            raise KeyboardInterrupt
        if scene == 2:
            last = [bench.projector._optics._end]
            device.add(times=last, channels=[0], types=[swabian_fake.OVERFLOW_BEGIN], missed=[0])
        bench.projector._optics.display(scene)

    told = record.record_run(
        tmp_path / "run", lab / "patterns", acquisition, replace(bench, display=display)
    )
    with pytest.raises(InputError if loss else KeyboardInterrupt) as end:
        list(told)
    assert ("overflowed" in str(end.value)) == loss
    assert device.steps[-2:] == ["stop", "freeTimeTagger"]
    assert [scene.name for scene in read_run(tmp_path / "run").acquisition.scenes] == ["0", "1"]
    assert count_run(tmp_path / "run").valid.tolist() == [[True], [True]]


def test_real_devices_are_asked_by_the_same_options(refuse, lab, tmp_path, monkeypatch):
    scenes = tmp_path / "scenes.csv"
    scenes.write_text("first,3\nsecond,4\n")
    words = ("camera", "record", lab / "patterns", "--scene", scenes, "-o", tmp_path / "run")
    assert "ALP4lib" in refuse(*words, "--projector", "vialux", "--counter", "picoquant")
    monkeypatch.setitem(sys.modules, "hid", None)
    own = ("--projector", "dlpc900", "--counter", "picoquant")
    assert "pip install hidapi" in refuse(*words, *own)
    assert "for --projector vialux" in refuse(*words, *own, "--alp-version", "4.1")
    assert "do not go together" in refuse(*words, "--projector", "vialux")
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    assert "for virtual devices" in refuse(
        *words, "--projector", "vialux", "--counter", "picoquant", "--flux", "1e6"
    )
    swabian = ("--projector", "vialux", "--counter", "swabian")
    assert "needs --marker-channel" in refuse(*words, *swabian)
    assert "no detector's" in refuse(*words, *swabian, "--marker-channel", "1")
    assert "ALP4lib" in refuse(*words, *swabian, "--marker-channel", "-8")
    levels = tmp_path / "levels.toml"
    levels.write_text("[trigger_levels]\n1 = 'high'\n")
    config = (*swabian, "--marker-channel", "8", "--counter-config", levels)
    assert f"{levels} cannot be used at trigger_levels.1" in refuse(*words, *config)
    levels.write_text("[trigger_levels]\n1 = 0.1\n8 = 1.2\n")
    assert "ALP4lib" in refuse(*words, *config)
    assert "is for --counter swabian" in refuse(
        *words, "--projector", "vialux", "--counter", "picoquant", "--marker-channel", "8"
    )

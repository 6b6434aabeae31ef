"""`camera record`: a projector and a counter record a fixed design, which is then counted."""

from dataclasses import replace

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi.camera.device import find_device
from deepfsi.counting.acquisition import Acquisition, Scene
from deepfsi.counting.recording import Recording
from deepfsi.lab import live as record
from deepfsi.lab.calibration import scan_rails
from deepfsi.lab.devices import virtual_setup
from deepfsi.lab.virtual_optics import CAMERAS
from deepfsi.patterns.folder import Patterns
from deepfsi_drivers import swabian as swabian_module
from drivers import swabian_fake


@pytest.fixture(scope="module")
def patterns(tmp_path_factory):
    folder = tmp_path_factory.mktemp("record") / "patterns"
    Patterns.from_rails(scan_rails("raster", (8, 8)), find_device("64x48"), 1e-3).write(folder)
    return folder


def planned(patterns, digits, count):
    """Acquisition of some scenes, and its virtual bench."""
    shown = tuple(Scene(name=str(k)) for k in range(count))
    told = {"flux": 1e7, "camera": CAMERAS["ideal"].model_dump(mode="json"), "seed": 1}
    read = Patterns.read(patterns)
    acquisition = Acquisition.plan(read.manifest, shown, exposure_s=10e-3, repeats=1, **told)
    scenes = digits.x_test[:count].reshape(count, 8, 8)
    return acquisition, virtual_setup(read, scenes, acquisition)


def tagged(patterns, digits, count, monkeypatch):
    """The same bench, whose photons and triggers are tags of a fake of a Time Tagger."""
    acquisition, bench = planned(patterns, digits, count)
    device = swabian_fake.install(monkeypatch)
    bench.projector.recorder.writer = device
    counter = swabian_module.TaggerCounter(acquisition.inputs, acquisition.marker_bit, trigger=8)
    return device, acquisition, replace(bench, counter=counter)


@pytest.mark.parametrize("stop", ["before a pass", "within a pass", "tags lost"])
def test_a_run_that_is_stopped_keeps_its_finished_scenes(
    patterns, digits, tmp_path, monkeypatch, stop
):
    """By Ctrl-C, before a pass or while one is shown, or by a loss; a device is let go of."""
    if stop == "tags lost":
        device, acquisition, bench = tagged(patterns, digits, 4, monkeypatch)
    else:
        acquisition, bench = planned(patterns, digits, 4)
    optics = bench.projector

    def stopped() -> None:
        frames = np.arange(20)
        bench.projector.show(frames, Patterns.read(patterns).manifest.picture_s[frames])
        raise KeyboardInterrupt

    def display(scene: int) -> None:
        if scene == 2 and stop == "before a pass":
            raise KeyboardInterrupt
        if scene == 2 and stop == "within a pass":
            monkeypatch.setattr(bench.projector, "run", stopped)
        elif scene == 2:
            begin = [swabian_fake.OVERFLOW_BEGIN]
            device.add(times=[optics.recorder.end], channels=[0], types=begin, missed=[0])
        optics.display(scene)

    bench = replace(bench, display=display)
    with pytest.raises(InputError if stop == "tags lost" else KeyboardInterrupt) as end:
        list(record.record_run(tmp_path / "run", Patterns.read(patterns), acquisition, bench))
    assert ("overflowed" in str(end.value)) == (stop == "tags lost")
    assert stop != "tags lost" or device.steps[-2:] == ["stop", "freeTimeTagger"]
    assert [scene.name for scene in Recording.read(tmp_path / "run").acquisition.scenes] == [
        "0",
        "1",
    ]
    assert Recording.read(tmp_path / "run").count().valid.tolist() == [[True], [True]]

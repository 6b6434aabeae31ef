"""The loop on the drivers of real devices: fakes of two devices, and a file that grows."""

from dataclasses import replace

import numpy as np
import pytest

from deepfsi.counting.events import PtuWriter
from deepfsi.lab import results as frame_log
from deepfsi.lab.devices import Setup, virtual_setup
from deepfsi.lab.virtual_detector import DETECTOR_TICK_S
from deepfsi_drivers import file_tail, swabian, vialux
from drivers import swabian_fake
from drivers.vialux_fake import install
from shared.live_samples import LOOKS, Counted, live, make_patterns, planned, scenes_of

SCENES, FLUX = 3, 1e7


@pytest.mark.parametrize("entries", [4096, 100])
def test_the_loop_runs_on_a_vialux_device_and_a_file_that_grows(
    digits, tmp_path, monkeypatch, entries
):
    """Also where lists are so long that pictures must last longer than the shortest."""
    patterns, folder = make_patterns(tmp_path, digits), tmp_path / "run"
    x, scenes = scenes_of(digits, SCENES)
    run = planned(patterns, scenes, 20e-3, FLUX)
    usual = virtual_setup(run.patterns, x, run.settings)
    library = install(monkeypatch)
    optics = usual.projector

    def on_list(frames, us):
        optics.show(np.array(frames), np.full(len(frames), us * 1e-6))

    class Counter(file_tail.FollowedCounter):
        def start(self, path):
            optics.recorder.writer = PtuWriter(path, DETECTOR_TICK_S, growing=True).__enter__()
            super().start(path)

    library.size, library.on_list, library.entries = (64, 48), on_list, entries
    devices = Setup(vialux.VialuxLooks(), Counter(), usual.display)
    counted = Counted(monkeypatch)
    decided = list(run.steps(folder, devices))
    optics.recorder.writer.__exit__(None, None, None)
    assert len(decided) == SCENES * LOOKS
    assert library.calls.count("SeqAlloc") == 1
    assert not library.allocated

    lists = [each for scene in frame_log.read_log(folder) for each in scene.lists]
    assert len(library.lists) == len(lists) == SCENES * (LOOKS + 2)
    for (pictures, us), each in zip(library.lists, lists, strict=True):
        assert len(pictures) <= entries
        assert pictures == np.repeat([*each.frames, 1], each.markers).tolist()
        held = np.array(each.markers[:-1]) * us
        assert (held * 1000 >= np.array(each.gate_ns) + run.settings.settle_s * 1e9).all()
    assert (max(us for _, us in library.lists) > 44) == (entries == 100)
    assert max(max(each.markers) for each in lists) > 3
    counted.check_file(folder)


def test_the_loop_runs_on_a_time_tagger_as_on_the_virtual_counter(digits, tmp_path, monkeypatch):
    """The same light, through tags of channels in blocks that end anywhere: the same decisions."""
    patterns = make_patterns(tmp_path, digits)
    x, scenes = scenes_of(digits, SCENES)
    device = swabian_fake.install(monkeypatch, trigger=-4)
    folder, run = tmp_path / "run", planned(patterns, scenes, 20e-3, FLUX)
    devices = virtual_setup(run.patterns, x, run.settings)
    devices.projector.recorder.writer = device
    counter = swabian.TaggerCounter(run.settings.inputs, run.settings.marker_bit, trigger=-4)
    devices = replace(devices, counter=counter)
    counted = Counted(monkeypatch)
    decided = list(run.steps(folder, devices))
    assert len(decided) == SCENES * LOOKS
    assert device.steps[-2:] == ["stop", "freeTimeTagger"]
    counted.check_file(folder)
    usual = live(tmp_path / "usual", patterns, digits, SCENES, exposure_s=20e-3, flux=FLUX)
    chances = [each.probabilities for each in decided]
    assert np.array_equal(chances, [each.probabilities for each in usual])

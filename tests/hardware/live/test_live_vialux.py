"""A live run on a Vialux device, as far as a fake of its library goes."""

import numpy as np
import pytest
from live_samples import LOOKS, make_patterns, scenes_of

from deepfsi.hardware.drivers import vialux
from deepfsi.hardware.live.replay import count_live, replay_run
from deepfsi.hardware.live.run import Bench, plan_live, run_live
from deepfsi.hardware.live.shown import read_shown
from deepfsi.hardware.patterns.devices import find_device
from deepfsi.hardware.virtual.bench import BenchCounter, Laboratory, Latencies
from deepfsi.hardware.virtual.camera import CAMERAS, arrival_rates
from hardware.drivers import test_vialux
from hardware.drivers.test_vialux import library  # noqa: F401


@pytest.mark.parametrize("entries", [4096, 100])
def test_a_run_shows_lists_of_frames_that_were_loaded_once(
    library,  # noqa: F811
    digits,
    tmp_path,
    monkeypatch,
    entries,
):
    """What the device shows, each repeat with its marker, is what detectors see and are told."""
    patterns = make_patterns(tmp_path, digits, epochs=1)
    monkeypatch.setattr(test_vialux, "DEVICE", find_device("64x48"))
    library.entries = entries
    x, scenes = scenes_of(digits, 3)
    rates = arrival_rates(patterns, x, CAMERAS["ideal"], 1e6)
    laboratory = Laboratory(rates, CAMERAS["ideal"], Latencies())

    class Board(vialux.VialuxLooks):
        def show(self, frames, dwells_s):
            super().show(frames, dwells_s)
            shown, us = library.lists[-1]
            laboratory.show(np.array(shown), np.full(len(shown), us * 1e-6))

    devices = Bench(Board(), BenchCounter(laboratory, (0,)), laboratory.display)
    acquisition = plan_live(patterns, scenes, 10e-3)
    decided = list(run_live(tmp_path / "run", patterns, acquisition, devices))
    assert len(decided) == 3 * LOOKS
    assert not library.allocated
    assert len(library.lists) == 3 * (1 + LOOKS)
    for (shown, us), each in zip(
        library.lists, [each for s in read_shown(tmp_path / "run") for each in s.lists], strict=True
    ):
        assert shown == np.repeat([*each.frames, 1], each.markers).tolist()
        held = np.array(each.markers[:-1]) * us * 1000
        assert (held >= np.array(each.gate_ns) + 12_000).all()
        assert len(shown) <= entries
    count_live(tmp_path / "run")
    assert all(each.agrees for each in replay_run(tmp_path / "run"))

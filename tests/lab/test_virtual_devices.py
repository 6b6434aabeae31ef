"""Virtual devices of a live run say what comes first; `test_live.py` tests what they show."""

import numpy as np
import pytest

from deepfsi.counting.reader import count_windows, read_markers, summarise
from deepfsi.lab import virtual_optics as camera_module
from deepfsi.lab.devices import LATENCIES, VirtualBench
from deepfsi.lab.virtual_detector import DETECTOR_TICK_S
from deepfsi.lab.virtual_optics import VirtualCamera


def test_lists_follow_each_other_on_one_clock_and_every_photon_is_kept(tmp_path):
    """Frames of three rates, twice, between times that nothing is shown anew; stamps jitter.

    Every event of what was shown is in the file, to the end of the last frame, and none after it.
    """
    rates = np.array([[[0.0], [1e6], [3e6]]])
    camera, dwells = VirtualCamera(jitter_s=1e-7), np.array([2e-3, 1e-3, 4e-3])
    setup = VirtualBench(rates, camera, LATENCIES | {"command": 5e-3, "display": 50e-3}, (0,))
    path = tmp_path / "run.ptu"
    setup.start(path)
    starts = []
    for _ in range(2):
        setup.display(0)
        shown_s = setup.now_s + 5e-3
        setup.show(np.array([1, 2, 0]), dwells)
        starts.append(shown_s + np.array([0, *np.cumsum(dwells[:-1])]))
    setup.wait()
    assert setup.now_s == pytest.approx(
        starts[-1][0] + dwells.sum() + 8e-7, abs=2 * DETECTOR_TICK_S
    )
    setup.stop()
    times, bits = read_markers(path)
    assert (bits == camera_module.FRAME_MARKER).all()
    np.testing.assert_allclose(
        times * DETECTOR_TICK_S, np.concatenate(starts), atol=2 * DETECTOR_TICK_S
    )
    edges, shown = np.concatenate(starts), np.tile(dwells, 2)
    gates = (np.rint(each / DETECTOR_TICK_S).astype(np.int64) for each in (edges, edges + shown))
    found = count_windows(path, *gates)[:, 0]
    expected = np.tile(rates[0, [1, 2, 0], 0], 2) * shown
    # Some 0.3 counts come into a gate from beside it, or leave it
    assert (abs(found - expected) < 5 * np.sqrt(expected) + 5).all()
    waited = 1e6 * starts[0][0]  # frame 1 is seen until the first list
    whole = waited + expected.sum()
    assert abs(summarise(path).photons[1] - whole) < 5 * np.sqrt(whole)

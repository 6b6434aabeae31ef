"""Virtual devices of a live run say what comes first; `hardware/live` tests what they show."""

import numpy as np
import pytest
from virtual_samples import SHAPE, patterns

from deepfsi.errors import InputError
from deepfsi.hardware.virtual.bench import BenchCounter, BenchProjector, Latencies, VirtualSetup
from deepfsi.hardware.virtual.camera import VirtualCamera, arrival_rates


def test_virtual_devices_say_what_comes_first(tmp_path):
    folder = tmp_path / "patterns"
    patterns(folder)
    rates = arrival_rates(folder, np.ones((1, *SHAPE)), VirtualCamera(), 1e6)
    setup = VirtualSetup(rates, VirtualCamera(), Latencies())
    with pytest.raises(InputError, match="load a pattern folder first"):
        BenchProjector(setup).show(np.array([0]), np.array([1e-3]))
    with pytest.raises(InputError, match="nothing is recorded"):
        BenchCounter(setup, (0,)).counts_since_marker(0.0)
    (folder / "frames.npy").write_bytes(b"")
    with pytest.raises(InputError, match="is not a numpy file"):
        BenchProjector(setup).load(folder)

"""What tests of several drivers share: patterns to show, and rules of every counter."""

import numpy as np

from deepfsi.counting.reader import count_windows, read_markers
from deepfsi.lab.devices import StreamingCounter
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.rails import DesignRails


def make_patterns(folder, device, masks, light="free-dwell", format="npy", dwell=1e-3, least=0.1):
    """Folder of patterns of masks of 4 × 8, whose brightest pixels differ down to `least`."""
    rng = np.random.default_rng(3)
    rails = rng.random((1, masks, 32)) * rng.uniform(least, 1, (1, masks, 1))
    rails /= masks if light == "equal-dwell" else rails.max(axis=2).sum()
    Patterns.from_rails(
        DesignRails(rails, light, (4, 8), summed_reflectance=10.0), device, dwell, format=format
    ).write(folder)
    return folder


def collect(counter: StreamingCounter, frames: int) -> np.ndarray:
    found: list[list[int]] = []
    while len(found) < frames:
        more = counter.counts_since_marker(60).tolist()
        assert more, f"{len(found)} frames came, of {frames}"
        found += more
    return np.array(found)


def check_counts(found, path, gates, inputs, tick_s):
    times, bits = read_markers(path)
    starts = times[bits == 2][: len(found)]
    opens = starts + np.rint(gates.offsets_s / tick_s).astype(int)
    closes = opens + np.rint(gates.lengths_s / tick_s).astype(int)
    assert np.array_equal(found, count_windows(path, opens, closes, inputs))
    assert found.sum() > 100

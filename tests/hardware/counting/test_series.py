"""Cumulative counts and even time bins become the table of a counter between markers."""

import json

import numpy as np
import pytest

from deepfsi.base import InputError
from deepfsi.base.numeric import read_table
from deepfsi.camera import DetectorMap, Device
from deepfsi.hardware.counting import TableSettings, count_table, table_of_series
from deepfsi.hardware.counting.tables import ROLL_OVER, column_names
from deepfsi.hardware.patterns import DesignRails, FrameSettings, export_patterns, read_patterns
from deepfsi.hardware.virtual import VirtualCamera, arrival_rates

DEVICE = Device(name="small", columns=36, rows=26, shortest_us=10, settle_us=2)
SHAPE, MASKS, FLUX, BIN_US = (3, 4), 8, 2e7, 100
SCENES = np.random.default_rng(4).uniform(0.5, 1, (5, *SHAPE)).astype(np.float32)


@pytest.fixture(scope="module", params=[1, 2], ids=["one", "two"])
def shown(request, tmp_path_factory):
    """Patterns with pictures of ten bins, and rates (S, F, inputs) of some scenes."""
    folder = tmp_path_factory.mktemp("series") / "patterns"
    rails = np.random.default_rng(3).integers(0, 2, (1, MASKS, 12)).astype(np.float32) / MASKS
    cells = DetectorMap(count=2, cells=(0, 1) * 6) if request.param == 2 else None
    made = DesignRails(rails, "equal-dwell", SHAPE, float(SCENES.sum() / 5), detectors=cells)
    export_patterns(made, FrameSettings(DEVICE, BIN_US * 10e-6), folder)
    rates = arrival_rates(folder, SCENES, VirtualCamera(dark=200.0), FLUX)
    return folder, read_patterns(folder).manifest, rates


def in_bins(manifest, rates: np.ndarray, seed: int):
    """Counts (n, inputs) in bins, any phase and any pauses, and the true first bins of passes."""
    rng, width = np.random.default_rng(seed), BIN_US * 1e-6
    starts, rows, edges, at = [], [], [0.0], 0.0
    for each in rates:
        pause = float(rng.uniform(3, 40)) * width
        rows += [rates[0, 1], *each]  # all OFF, then a pass
        at += pause
        starts.append(at)
        edges += [at, *(at + np.cumsum(manifest.picture_s))]
        at += manifest.pass_s
    rows.append(rates[0, 1])
    edges.append(at + 20 * width)
    grid = np.arange(0, edges[-1], width)
    whole = np.concatenate([[np.zeros(rates.shape[2])], np.diff(edges)[:, None] * np.array(rows)])
    light = np.cumsum(whole, axis=0)
    mean = np.stack([np.interp(grid, edges, light[:, k]) for k in range(rates.shape[2])], axis=1)
    return rng.poisson(np.diff(mean, axis=0)), np.floor(np.array(starts) / width).astype(int)


@pytest.mark.parametrize("seed", range(8))
def test_passes_in_bins_are_found_where_they_are(shown, seed):
    _, manifest, rates = shown
    counts, starts = in_bins(manifest, rates, seed)
    rows, names = table_of_series(counts.astype(float), manifest, bin_s=BIN_US * 1e-6)
    assert names == column_names(manifest)
    frames = 10 * np.arange(MASKS + 4)
    for row, start in zip(rows, starts, strict=True):
        firsts = start + frames + 1
        clean = [
            np.array([counts[f - early : f + 9 - early].sum(axis=0) for f in firsts]).ravel()
            for early in (0, 1)  # where an edge of bins is an edge of frames, either is left out
        ]
        assert any(np.array_equal(row, each) for each in clean)


def test_the_table_has_the_counts_that_the_light_says(shown, done, tmp_path):
    """Through the files and the commands; the budget and each readout within 5 sigma."""
    folder, manifest, rates = shown
    counts, _ = in_bins(manifest, rates, 0)
    np.savetxt(tmp_path / "bins.txt", counts, fmt="%d")
    words = ("camera", "import", tmp_path / "bins.txt", "--bins", "100us", "--patterns", folder)
    out = done(*words, "-o", tmp_path / "table.csv")
    assert "5 passes" in out
    assert "--settle 100us" in out
    table = read_table(tmp_path / "table.csv")
    found, _ = count_table(table, manifest, TableSettings(settle_s=BIN_US * 1e-6))
    wanted = (rates - 200.0)[:, manifest.shown] * (manifest.shares * found.exposure_s)[:, None]
    signal = found.signal()[:, 0, 0].reshape(wanted.shape)
    noise = np.sqrt(found.variance[:, 0, 0].reshape(wanted.shape) + 1)
    assert abs((signal - wanted) / noise).max() < 5
    told = json.loads(done(*words, "--passes", 5, "--json", "-o", tmp_path / "2.csv"))
    assert (told["passes"], told["settle_s"]) == (5, pytest.approx(1e-4))


def test_bins_that_do_not_tell_are_refused(shown):
    _, manifest, rates = shown
    counts, _ = in_bins(manifest, rates, 1)
    given = counts.astype(float)
    with pytest.raises(InputError, match=r"5 passes .* and 6 are asked for"):
        table_of_series(given, manifest, bin_s=BIN_US * 1e-6, passes=6)
    with pytest.raises(InputError, match="not whole numbers of bins of 30 µs"):
        table_of_series(given, manifest, bin_s=30e-6)
    with pytest.raises(InputError, match="0 passes"):
        table_of_series(np.ones_like(given), manifest, bin_s=BIN_US * 1e-6)
    with pytest.raises(InputError, match="no count"):
        table_of_series(given - 0.5, manifest, bin_s=BIN_US * 1e-6)
    with pytest.raises(InputError, match="a column for each"):
        table_of_series(given[:, [0, 0, 0]], manifest, bin_s=BIN_US * 1e-6)
    alike = np.tile(np.repeat([1000.0, 0.0], 10), 3 * len(manifest.frames) // 2)[:, None]
    with pytest.raises(InputError, match="counts do not tell"):  # masks that are all ON or all OFF
        table_of_series(np.repeat(alike, counts.shape[1], axis=1), manifest, bin_s=BIN_US * 1e-6)


@pytest.mark.parametrize("first", [0, ROLL_OVER - 1000])
def test_cumulative_counts_become_those_of_frames(shown, first):
    """Also where the counter begins again within a pass."""
    _, manifest, rates = shown
    rng, inputs = np.random.default_rng(0), rates.shape[2]
    counts = rng.poisson(rates * manifest.picture_s[:, None])
    pauses = rng.poisson(50, (len(rates), 1, inputs))
    steps = np.concatenate([pauses, counts], axis=1)  # from the trigger before each latch
    latched = (first + steps.reshape(-1, inputs).cumsum(axis=0)) % ROLL_OVER
    rows, names = table_of_series(latched.astype(float), manifest)
    assert names == column_names(manifest)
    np.testing.assert_array_equal(rows, counts.reshape(len(rates), -1))
    starts = latched.reshape(len(rates), -1, inputs)[:, :-1]  # no trigger at the end of a pass
    rows, names = table_of_series(starts.reshape(-1, inputs).astype(float), manifest)
    assert names == column_names(manifest)[2 * inputs : -2 * inputs]
    np.testing.assert_array_equal(rows, counts[:, 2:-2].reshape(len(rates), -1))


def test_latches_that_are_not_of_whole_passes_are_refused(shown, refuse, tmp_path):
    _, manifest, rates = shown
    frames, inputs = len(manifest.frames), rates.shape[2]
    rising = np.arange(frames * (frames + 1) * inputs, dtype=float).reshape(-1, inputs)
    with pytest.raises(InputError, match="how many `passes`"):
        table_of_series(rising, manifest)
    assert len(table_of_series(rising, manifest, passes=frames)[0]) == frames
    assert len(table_of_series(rising, manifest, passes=frames + 1)[0]) == frames + 1
    with pytest.raises(InputError, match="whole passes"):
        table_of_series(rising[:-1], manifest)
    with pytest.raises(InputError, match="fall within a pass"):
        table_of_series(rising[::-1], manifest, passes=frames)
    np.savetxt(tmp_path / "n.txt", rising, fmt="%d")
    words = ("camera", "import", tmp_path / "n.txt", "-o", tmp_path / "t.csv")
    assert "--patterns" in refuse(*words, "--cumulative")
    assert "for time stamps" in refuse(*words, "--cumulative", "--marker-channel", 1)
    assert "not events, give --cumulative or --bins" in refuse(*words[:-1], tmp_path / "t.ptu")
    told = refuse(*words[:-1], tmp_path / "t.ptu", "--marker-channel", 1, "--passes", 3)
    assert "are for --cumulative or --bins" in told
    assert not (tmp_path / "t.csv").exists()

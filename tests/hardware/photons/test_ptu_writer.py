"""T2 files written: read back by us and by ptufile, refused or left as they were."""

import numpy as np
import ptufile
import pytest

from deepfsi.base.errors import InputError
from deepfsi.hardware.photons.reader import inspect, read_markers
from deepfsi.hardware.photons.writer import Writer
from shared.disks import nearly_full


def test_what_is_written_is_read_back_by_us_and_by_ptufile(tmp_path):
    rng, n = np.random.default_rng(4), 5000
    steps = rng.integers(0, 10**6, n)
    steps[[10, 11, 400]] = 2**25, 2**35, 3 * 2**48  # pauses of one overflow and of many
    times = np.cumsum(steps)
    codes = rng.integers(-15, 64, n).astype(np.int16)
    path = tmp_path / "new" / "a.ptu"
    with Writer(path, tick_s=5e-12) as writer:
        for part in np.array_split(np.arange(n), [0, 1, 11, 12, 3000]):
            writer.write(times[part], codes[part])
    assert list(path.parent.iterdir()) == [path]

    contents = inspect(path)
    photons, markers = codes >= 0, codes < 0
    inputs = np.unique(codes[photons], return_counts=True)
    assert contents.photons == dict(zip(*inputs, strict=True))
    assert (contents.first, contents.last) == (times[0], times[-1])
    assert (contents.tick_s, contents.syncs, contents.problems) == (5e-12, 0, ())
    found = read_markers(path)
    assert np.array_equal(found[0], times[markers])
    assert np.array_equal(found[1], -codes[markers])
    with ptufile.PtuFile(path) as theirs:
        events = theirs.decode_records()
        assert theirs.number_records == contents.records == len(events)
        assert theirs.global_resolution == 5e-12
        assert theirs.tags["CreatorSW_Name"] == "deepfsi"
    kept = (events["channel"] >= 0) | (events["marker"] > 0)
    assert np.array_equal(events["time"][kept], times)
    assert np.array_equal(np.where(photons, codes, -1), events["channel"][kept])


def test_the_same_events_give_the_same_bytes_however_they_are_split(tmp_path, monkeypatch):
    times, codes = np.arange(1000) * 10**6, np.zeros(1000, np.int16)
    for name, parts in (("a", 1), ("b", 7)):
        with Writer(tmp_path / name) as writer:
            for part in np.array_split(np.arange(1000), parts):
                writer.write(times[part], codes[part])
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_growing_file_loses_no_record_in_silence(tmp_path):
    """A disk that fills up within a write: an error, and before it whole records alone."""
    path, times, codes = tmp_path / "a.ptu", np.arange(1000) * 1000, np.zeros(1000, int)
    with Writer(path, growing=True) as writer:
        writer.write(times, codes)
        full = nearly_full(path.stat().st_size + 2002)
        with full, pytest.raises(InputError, match=r"cannot write .*a.ptu: File too large"):
            writer.write(times + 10**6, codes)
    contents = inspect(path)
    assert contents.photons == {0: 1000}
    assert contents.problems == ()


def test_a_stopped_writer_leaves_what_was_there(tmp_path):
    path = tmp_path / "a.ptu"
    path.write_text("before")

    def stop() -> None:
        with Writer(path) as writer:
            writer.write(np.array([5]), np.array([0]))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop()
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_text() == "before"


@pytest.mark.parametrize(
    ("times", "codes", "message"),
    [
        ([5, 4], [0, 0], "run back"),
        ([2], [0], "run back"),
        ([-1], [0], "run back"),
        ([2**55 + 1], [0], "at most"),
        ([5], [64], "0 to 63"),
        ([5], [-16], "0 to 63"),
        ([5, 6], [0], "one for each"),
        ([5.0], [0], "integers"),
        ([5], [0.0], "integers"),
    ],
)
def test_events_that_cannot_be_are_refused(tmp_path, times, codes, message):
    def write() -> None:
        with Writer(tmp_path / "a.ptu") as writer:
            writer.write(np.array([3]), np.array([1]))
            writer.write(np.array([], int), np.array([], int))
            writer.write(np.array(times), np.array(codes))

    with pytest.raises(InputError, match=message):
        write()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("tick_s", [0, -1, float("nan"), float("inf"), 1e-20])
def test_ticks_that_cannot_be_are_refused(tmp_path, tick_s):
    with pytest.raises(InputError, match="tick"):
        Writer(tmp_path / "a.ptu", tick_s)

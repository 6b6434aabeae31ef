"""A photon file followed while it grows, and a pipe."""

import os
import threading
from pathlib import Path

import numpy as np
import pytest
from driver_samples import collect

from deepfsi.base.errors import InputError
from deepfsi.counting.events import PtuWriter
from deepfsi.counting.streaming import FrameCounter, FrameGates
from deepfsi_drivers import file_tail as followed

GATES = FrameGates.of(10e-6, [60e-6] * 20)


@pytest.fixture(scope="module")
def content(tmp_path_factory) -> bytes:
    path, rng = tmp_path_factory.mktemp("followed") / "a.ptu", np.random.default_rng(0)
    times = np.sort(np.append(np.arange(20) * 10**8, rng.integers(0, 21 * 10**8, 20000)))
    with PtuWriter(path) as writer:
        writer.write(times, np.where(times % 10**8 == 0, -1, 0))
    return path.read_bytes()


@pytest.mark.parametrize("make", [Path.touch, os.mkfifo], ids=["file", "pipe"])
def test_a_growing_file_gives_the_counts_of_the_whole_one(tmp_path, content, make):
    path, whole = tmp_path / "photons.ptu", FrameCounter((0,))
    whole.expect(GATES)
    wanted = whole.feed(content)
    assert len(wanted) == 20
    make(path)

    def grow() -> None:
        with path.open("wb", buffering=0) as file:
            for first in range(0, len(content), 1777):
                file.write(content[first : first + 1777])

    with followed.FollowedCounter() as counter:
        counter.start(path)
        counter.expect(GATES)
        writer = threading.Thread(target=grow)
        writer.start()
        assert np.array_equal(collect(counter, 20), wanted)
        writer.join()
        assert len(counter.counts_since_marker(0.0)) == 0


def test_someone_is_asked_to_begin_and_to_end_a_recording(tmp_path, content):
    path, said = tmp_path / "photons.ptu", []

    def ask(what: str) -> None:
        said.append(what.split()[0])
        path.write_bytes(content)

    with followed.FollowedCounter(ask=ask) as counter:
        counter.start(path)
        assert said == ["begin"]
        counter.stop()
    assert said == ["begin", "end"]


def test_what_is_not_there_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(followed, "APPEARS_S", 0.0)
    with followed.FollowedCounter() as counter:
        with pytest.raises(InputError, match="did not appear within 0 s"):
            counter.start(tmp_path / "absent.ptu")
        with pytest.raises(InputError, match="cannot be read: Is a directory"):
            counter.start(tmp_path)
    assert followed.FILE_POLL_S < 1e-3


def test_frames_may_be_told_before_the_header_has_come(tmp_path, content):
    path = tmp_path / "photons.ptu"
    path.write_bytes(content[:50])
    with followed.FollowedCounter() as counter:
        counter.start(path)
        counter.expect(FrameGates.of(10e-6, [60e-6] * 3))
        counter.expect(FrameGates.of(10e-6, [60e-6] * 17))
        assert len(counter.counts_since_marker(0.0)) == 0
        path.write_bytes(content)
        assert len(collect(counter, 20)) == 20


@pytest.mark.parametrize("change", [lambda path: path.rename(path.with_name("old.ptu")), os.remove])
def test_a_file_that_is_replaced_is_not_followed_in_silence(tmp_path, content, change):
    """Software that writes another file and renames it: the old one never grows again."""
    path = tmp_path / "photons.ptu"
    path.write_bytes(content[: len(content) // 2])
    with followed.FollowedCounter() as counter:
        counter.start(path)
        counter.expect(GATES)
        assert len(collect(counter, 5)) >= 5
        change(path)
        with pytest.raises(InputError, match="replaced, renamed or deleted"):
            counter.counts_since_marker(60)

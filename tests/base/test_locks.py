"""One process at a time has a lock, wherever the folder is, and none outlives its process."""

import os
import random
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from deepfsi.base import locks
from deepfsi.base.locks import Locks
from shared.waiting import until


def lock_of(process, folder):
    """The file of a lock `a` that a process has."""
    path = folder / "locks" / "a" / str(process)
    path.parent.mkdir(parents=True)
    path.touch()
    return path


def test_one_has_it_until_it_is_given_up(tmp_path):
    first, second = Locks(tmp_path), Locks(tmp_path)
    assert first.take("a")
    assert not second.take("a")
    assert second.take("b")
    first.give_up("a")
    assert second.take("a")
    second.give_up_all()
    assert not list(tmp_path.iterdir())


def test_many_at_once_never_share_a_lock(tmp_path):
    """Each of four takes it twenty times; whoever has it is alone."""
    alone = threading.Lock()

    def take_turns(seed):
        mine, chance, turns, wrong = Locks(tmp_path), random.Random(seed), 0, 0
        while turns < 20:
            if mine.take("a"):
                free = alone.acquire(blocking=False)
                turns, wrong = turns + 1, wrong + (not free)
                time.sleep(0)
                if free:
                    alone.release()
                mine.give_up("a")
            time.sleep(chance.uniform(0, 0.002))
        return wrong

    with ThreadPoolExecutor() as pool:
        assert list(pool.map(take_turns, range(4))) == [0] * 4
    assert not list(tmp_path.glob("locks/*/*"))


@pytest.fixture
def other(tmp_path):
    """Yield a process that has the lock `a`."""
    code = (
        "import sys, time, pathlib; from deepfsi.base.locks import Locks\n"
        "print(Locks(pathlib.Path(sys.argv[1])).take('a'), flush=True); time.sleep(600)"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "True\n"
    yield process
    process.kill()
    process.communicate()


def test_a_lock_ends_with_its_process(tmp_path, other):
    mine = Locks(tmp_path)
    assert not mine.take("a")
    other.kill()
    other.wait()
    assert mine.take("a")
    assert len(list(tmp_path.glob("locks/a/*"))) == 1


def test_a_new_process_of_an_old_number_is_another_one(tmp_path):
    """Numbers of processes come again; their moments of start do not."""
    own = locks.this_process()
    lock_of(own._replace(start_s=own.start_s - 3600), tmp_path)
    assert Locks(tmp_path).take("a")


def test_another_host_keeps_its_lock_while_its_file_changes(tmp_path):
    path = lock_of("0123456789ab-1-1-00000000", tmp_path)
    mine = Locks(tmp_path)
    assert not mine.take("a")
    os.utime(path, (1, 1))
    assert mine.take("a")
    assert not path.exists()


def test_a_lock_shows_that_its_process_lives(tmp_path, monkeypatch):
    monkeypatch.setattr(locks, "BEAT_SECONDS", 0.001)
    mine = Locks(tmp_path)
    assert mine.take("a")
    (path,) = tmp_path.glob("locks/a/*")
    os.utime(path, (1, 1))
    until(lambda: path.stat().st_mtime > 1)
    mine.give_up_all()

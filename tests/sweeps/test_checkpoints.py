"""A sweep that is stopped within a trial goes on within it, to the same bits."""

from pathlib import Path

import pytest
from filelock import FileLock

from deepfsi.sweeps import batch
from deepfsi.sweeps.plan import Trial
from deepfsi.sweeps.records import FinishedTrial, Records
from shared.checkpoints import Stopped, write_each_step
from shared.trials import left_over, planned, tensors, train_trials


@pytest.fixture
def trials(digits) -> list[Trial]:
    training = {"epochs": 1, "batch": 100}
    return planned(digits, masks=4, designs=("pca", "deepfsi"), training=training)


@pytest.fixture
def stop(monkeypatch):
    """Write a checkpoint after each step, and end after the one of the number that is set."""
    return write_each_step(monkeypatch)


@pytest.fixture
def left(digits, trials, stop, tmp_path) -> Path:
    """Give the checkpoint of a sweep that ended at its second step and may go on."""
    stop["last"] = 2
    with pytest.raises(Stopped):
        train_trials(trials, digits, tmp_path / "sweep")
    (file,) = (tmp_path / "sweep" / "checkpoints").iterdir()
    stop["last"] = 0
    return file


def test_a_sweep_goes_on_within_a_trial(digits, trials, stop, tmp_path):
    whole, folder = tmp_path / "whole", tmp_path / "sweep"
    train_trials(trials, digits, whole)
    steps = stop["count"]
    assert steps >= 8
    stop.update(count=0, last=2)
    for _ in range(2):  # batches, of two designs each
        with pytest.raises(Stopped):
            train_trials(trials, digits, folder)
        assert len(list((folder / "checkpoints").iterdir())) == 1
        stop["last"] += steps // 2
    train_trials(trials, digits, folder)
    assert stop["count"] == steps  # none was done twice
    assert tensors(folder) == tensors(whole)
    assert not left_over(folder) + left_over(whole)


@pytest.mark.parametrize("bytes_left", [100, 0, None])
def test_a_checkpoint_that_is_of_no_use_is_replaced(digits, trials, left, tmp_path, bytes_left):
    """Cut, empty, or of two designs where now one is trained: another training, named alike."""
    if bytes_left is None:
        trials = [trial for trial in trials if trial.design_key == left.stem]
    else:
        left.write_bytes(left.read_bytes()[:bytes_left])
    train_trials(trials, digits, tmp_path / "sweep")
    train_trials(trials, digits, tmp_path / "whole")
    assert tensors(tmp_path / "sweep") == tensors(tmp_path / "whole")
    assert not left_over(tmp_path / "sweep")


def test_who_has_no_lock_leaves_a_checkpoint_alone(digits, trials, left, tmp_path, monkeypatch):
    folder, before = tmp_path / "sweep", left.read_bytes()
    (folder / "locks").mkdir()
    lock = FileLock(folder / "locks" / f"{left.stem}.lock")
    lock.acquire()
    asked = []

    def train(self, trials, *_):
        asked.extend(trial.design_key for trial in trials)
        return [FinishedTrial(trial, None, None) for trial in trials]

    def sleep(_):
        raise Stopped

    monkeypatch.setattr(batch.BatchTrainer, "train", train)
    monkeypatch.setattr("deepfsi.sweeps.run.time.sleep", sleep)
    with pytest.raises(Stopped):
        train_trials(trials, digits, folder)
    assert left.stem not in asked
    assert left.read_bytes() == before


def test_a_checkpoint_left_by_a_kill_before_its_removal_is_removed(digits, trials, tmp_path):
    train_trials(trials, digits, tmp_path)
    made = sorted((tmp_path / "designs").iterdir())
    (tmp_path / "checkpoints").mkdir()
    for name in (f"{made[0].stem}.checkpoint", "0" * 24 + ".checkpoint"):
        (tmp_path / "checkpoints" / name).touch()
    Records(tmp_path)
    assert [path.stem for path in (tmp_path / "checkpoints").iterdir()] == ["0" * 24]

"""A sweep that is stopped within a trial goes on within it, to the same bits."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from safetensors.numpy import load_file

from deepfsi.base import saved_work_text
from deepfsi.base.locks import parse_process, this_process
from deepfsi.sweeps import FinishedTrial, Records, Trial, plan_trials
from deepfsi.sweeps.batch import BatchTrainer
from deepfsi.training import checkpoint
from shared.checkpoints import Stopped, write_each_step
from shared.trials import small, train_trials

RECIPE = {"masks": (4,), "designs": ("pca", "deepfsi"), "training": {"epochs": 1, "batch": 100}}


@pytest.fixture
def trials(digits) -> list[Trial]:
    return plan_trials(small(**RECIPE), digits)


@pytest.fixture
def stop(monkeypatch):
    """Write a checkpoint after each step, and end after the one of the number that is set."""
    return write_each_step(monkeypatch)


def tensors(folder: Path) -> dict[str, dict[str, bytes]]:
    return {
        path.name: {name: held.tobytes() for name, held in load_file(path).items()}
        for path in folder.glob("designs/*")
    }


def left_over(folder: Path) -> list[Path]:
    return [*folder.rglob(".*"), *folder.rglob("*checkpoint*"), *folder.rglob("locks*")]


def test_a_sweep_goes_on_within_a_trial(digits, trials, stop, tmp_path):
    whole, folder = tmp_path / "whole", tmp_path / "sweep"
    train_trials(trials, digits, whole)
    steps = stop["count"]
    assert steps >= 8
    stop.update(count=0, last=2)
    for kept in (1, 1):  # two batches, of two designs each
        with pytest.raises(Stopped):
            train_trials(trials, digits, folder)
        assert len(list((folder / "checkpoints").iterdir())) == kept
        stop["last"] += steps // 2
    train_trials(trials, digits, folder)
    assert stop["count"] == steps  # none was done twice
    assert tensors(folder) == tensors(whole)
    assert not left_over(folder) + left_over(whole)


def test_keys_and_records_do_not_know_of_checkpoints(digits, trials, stop, tmp_path, monkeypatch):
    kept = train_trials(trials, digits, tmp_path / "kept")
    assert stop["count"]
    monkeypatch.setattr(checkpoint, "CHECKPOINT_SECONDS", 1e9)
    plain = train_trials(trials, digits, tmp_path / "plain")
    for record in kept + plain:
        record["info"]["seconds"] = 0.0
    assert kept == plain


@pytest.mark.parametrize("damage", [lambda content: content[:100], lambda content: b""])
def test_a_checkpoint_that_is_of_no_use_is_replaced(digits, trials, stop, tmp_path, damage):
    stop["last"] = 2
    with pytest.raises(Stopped):
        train_trials(trials, digits, tmp_path / "sweep")
    (file,) = (tmp_path / "sweep" / "checkpoints").iterdir()
    file.write_bytes(damage(file.read_bytes()))
    stop["last"] = 0
    train_trials(trials, digits, tmp_path / "sweep")
    train_trials(trials, digits, tmp_path / "whole")
    assert tensors(tmp_path / "sweep") == tensors(tmp_path / "whole")
    assert not left_over(tmp_path / "sweep")


def test_a_checkpoint_of_other_companions_is_not_resumed(digits, trials, stop, tmp_path):
    """A batch of two designs is another training than one of them, though named alike."""
    stop["last"] = 2
    with pytest.raises(Stopped):
        train_trials(trials, digits, tmp_path / "sweep")
    (file,) = (tmp_path / "sweep" / "checkpoints").iterdir()
    (one,) = [trial for trial in trials if trial.design_key == file.stem]
    stop["last"] = 0
    train_trials([one], digits, tmp_path / "sweep")
    train_trials([one], digits, tmp_path / "alone")
    assert tensors(tmp_path / "sweep") == tensors(tmp_path / "alone")
    assert not left_over(tmp_path / "sweep")


def test_who_has_no_lock_leaves_a_checkpoint_alone(digits, trials, stop, tmp_path, monkeypatch):
    folder = tmp_path / "sweep"
    stop["last"] = 2
    with pytest.raises(Stopped):
        train_trials(trials, digits, folder)
    (file,) = (folder / "checkpoints").iterdir()
    before = file.read_bytes()
    lock = folder / "locks" / file.stem / str(this_process()._replace(host="0" * 12))
    assert parse_process(lock.name)
    lock.parent.mkdir(parents=True)
    lock.touch()  # of another host
    asked, lost = [], lambda batch: [FinishedTrial(trial, None, None) for trial in batch]
    monkeypatch.setattr(
        BatchTrainer, "train", lambda self, batch, *_: asked.append(batch) or lost(batch)
    )
    monkeypatch.setattr("deepfsi.sweeps.run.time.sleep", lambda _: (_ for _ in ()).throw(Stopped))
    with pytest.raises(Stopped):
        train_trials(trials, digits, folder)
    assert file.stem not in {trial.design_key for batch in asked for trial in batch}
    assert file.read_bytes() == before


def test_a_checkpoint_left_by_a_kill_before_its_removal_is_removed(digits, trials, tmp_path):
    train_trials(trials, digits, tmp_path)
    made = sorted((tmp_path / "designs").iterdir())
    (tmp_path / "checkpoints").mkdir()
    for name in (made[0].name, "0" * 24 + ".safetensors"):
        (tmp_path / "checkpoints" / name).touch()
    Records(tmp_path)
    assert [path.stem for path in (tmp_path / "checkpoints").iterdir()] == ["0" * 24]


def test_a_stopped_sweep_says_that_it_goes_on(digits, trials, stop, tmp_path, monkeypatch):
    monkeypatch.setattr("deepfsi.base.interrupts._saved_work", "")
    stop["last"] = 2
    with pytest.raises(Stopped):
        train_trials(trials, digits, tmp_path)
    assert saved_work_text() == "; what was trained is kept, run again to go on"


@pytest.mark.slow
@pytest.mark.parametrize("command", ["sweep", "design"])
def test_a_kill_within_a_training_costs_no_bit(done, tmp_path, command):
    """A process that is killed at its fifth checkpoint, and the same command again."""
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(
        'designs = ["deepfsi"]\nphotons = [1e2, 1e3]\nmasks = [4]\ndraws = 1\n'
        "training = { epochs = 2, batch = 100 }\n"
    )
    design = ["design", "--masks", "4", "--photons", "1e3", "--epochs", "2", "--batch", "100"]
    words = {
        "sweep": lambda out: ["sweep", str(recipe), "--workers", "1", "-o", str(out)],
        "design": lambda out: [*design, "--resume", "-o", str(out / "designs" / "a.safetensors")],
    }[command]
    killed_words = words(tmp_path / "killed")
    for out in ("killed", "whole"):
        (tmp_path / out / "designs").mkdir(parents=True)
    kill = (
        "import os, sys; from deepfsi.cli import run_command_line\n"
        "from deepfsi.training import checkpoint\n"
        "checkpoint.CHECKPOINT_SECONDS, calls = 0.0, []\n"
        f"write, sys.argv = checkpoint.write_atomically, ['deepfsi', *{killed_words}]\n"
        "def written(*given):\n"
        "    calls.append(write(*given)); os.kill(os.getpid(), 9) if len(calls) == 5 else None\n"
        "checkpoint.write_atomically = written; run_command_line()"
    )
    killed = subprocess.run([sys.executable, "-c", kill], capture_output=True)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert list((tmp_path / "killed").rglob("*checkpoint*"))
    done(*killed_words)
    done(*words(tmp_path / "whole"))
    assert tensors(tmp_path / "killed") == tensors(tmp_path / "whole") != {}
    assert not left_over(tmp_path / "killed")


@pytest.mark.slow
def test_ctrl_c_within_a_training_keeps_it(done, refuse, tmp_path):
    """The command line says so, and what to do."""
    out = tmp_path / "a.safetensors"
    again = ["design", "--masks", "4", "--photons", "1e3", "-o", str(out)]
    code = (
        "import os, sys; from deepfsi.cli import run_command_line\n"
        "from deepfsi.training import checkpoint\n"
        "checkpoint.STOP_SECONDS = 0.0\n"
        f"sys.argv = ['deepfsi', *{again!r}]\n"
        "keep = checkpoint.Checkpoint.keep\n"
        "def after(self, loop):\n"
        "    os.kill(os.getpid(), 2) if loop.step == 7 else None\n"
        "    keep(self, loop)\n"
        "checkpoint.Checkpoint.keep = after; run_command_line()"
    )
    stopped = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert stopped.returncode == 130
    line = stopped.stderr.splitlines()[-1]
    assert line == (
        f"deepfsi: stopped; {out}.checkpoint holds the training so far, from which it can be "
        "resumed"
    )
    assert "--resume goes on with it, --force begins anew" in refuse(*again)
    done(*again, "--resume")
    assert os.listdir(tmp_path) == [out.name]

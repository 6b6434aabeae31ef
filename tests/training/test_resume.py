"""The law of checkpoints: a resumed training ends in the bits of one that was never stopped."""

import os
import re
import signal
from dataclasses import replace
from pathlib import Path

import pytest
from safetensors.numpy import load_file, save_file

from conftest import RECIPE
from deepfsi.base import InputError, Progress, interrupts
from deepfsi.exposure import TrainingSet
from deepfsi.training import Checkpoint, Diverged, learning, loop, train
from deepfsi.training import checkpoint as module
from shared.checkpoints import Stopped, write_each_step
from shared.jobs import job as job_of
from shared.jobs import learn

SCENES = 100
SHORT = {**RECIPE, "epochs": 2, "batch": 32, "masks": 5, "photons": 1e3, "device": "cpu", "seed": 3}
"""Six steps of a training."""

CASES = {
    "fixed masks": {"design": "random", "dropout": 0.1},
    "fixed masks, read noise": {"design": "pca", "noise": "gaussian", "sigma": 2.0},
    "ml_gauss": {"dropout": 0.1, "decay": 0.01, "balance": True},
    "gaussian": {"noise": "gaussian", "sigma": 3.0, "light": "two-arm"},
    "poisson": {"noise": "poisson", "rails": "single", "light": "free-dwell"},
    "camera noise": {"camera": "dmd", "noise": "camera", "sigma": 1.0, "dark": 5.0, "levels": 4},
    "few counts": {"noise": "poisson", "counts": 50.0, "camera": "dmd"},
    "a range of budgets": {"span": 100.0},
    "nested masks": {"nested": 2, "light": "equal-dwell"},
    "looks": {"camera": "dmd", "looks": 2, "dropout": 0.1},
    "patches": {"design": "deepfsi", "patch": 4, "masks": 6, "classifier": "vit", "hidden": None},
    "a module of one's own": {"classifier": "shared.networks:Cnn", "hidden": None},
    "a noise of one's own": {"noise": "shared.noises:photons", "design": "pca"},
    "the control group": {"design": "control", "sigma": 3.0, "dropout": 0.1},
    "a budget of counts": {"counts": 200.0, "photons": None, "camera": "dmd"},
    "values in bfloat16": {"precision": "bfloat16"},
}


def settings(changes):
    """Settings of the short training with changes; None leaves one out."""
    return {name: each for name, each in {**SHORT, **changes}.items() if each is not None}


@pytest.fixture
def few(digits):
    """Scenes that are not left out in folds, whose trainings have their own test."""
    return replace(digits, x_train=digits.x_train[:SCENES], y_train=digits.y_train[:SCENES])


@pytest.fixture
def unfolded(monkeypatch):
    monkeypatch.setattr(learning, "folds_of", lambda data: [])


@pytest.fixture
def writes(monkeypatch):
    """Write a checkpoint after each step; end the training after one of them, numbered from 1."""
    return write_each_step(monkeypatch)


def bits(design) -> bytes:
    design.info["seconds"] = 0.0
    return design.to_bytes()


def check_law(make, writes, path: Path) -> None:
    """Compare a whole training with ones that are stopped after a step and resumed, at 3 steps."""
    writes.update(count=0, last=0)
    make(path)
    steps = writes["count"]
    assert steps >= 6
    assert not path.exists()
    whole = [bits(design) for design in make(None)]
    for last in (1, steps // 2, steps - 1):
        writes.update(count=0, last=last)
        with pytest.raises(Stopped):
            make(path)
        assert path.exists()
        writes["last"] = 0
        assert [bits(design) for design in make(path)] == whole
        assert writes["count"] == steps  # each step was done once
        assert not path.exists()


@pytest.mark.usefixtures("unfolded")
@pytest.mark.parametrize("case", CASES)
def test_a_resumed_training_ends_in_the_same_bits(few, writes, tmp_path, case):
    check_law(
        lambda path: [learn(few, checkpoint=path, **settings(CASES[case]))],
        writes,
        tmp_path / "training.checkpoint",
    )


@pytest.mark.usefixtures("uncharacterised", "unfolded")
@pytest.mark.parametrize("stacked", [False, True])
@pytest.mark.parametrize("design", ["pca", "deepfsi"])
def test_designs_of_two_seeds_side_by_side_are_resumed(
    few, writes, tmp_path, monkeypatch, design, stacked
):
    """With their weights stacked, as on a GPU, or not."""
    from deepfsi.training import loop

    usual = loop.Replicas
    monkeypatch.setattr(loop, "Replicas", lambda nets, _, dtype: usual(nets, stacked, dtype))
    given = {**SHORT, "noise": "poisson", "design": design, "dropout": 0.1}
    del given["device"], given["seed"], given["photons"]
    jobs = [job_of(seed=s, photons=b, **given) for s, b in ((3, 1e2), (3, 1e4), (5, 1e3))]
    training_set = TrainingSet(few, "cpu")

    def make(path):
        kept = Checkpoint.of(path, training_set, jobs)
        designs = train(training_set, jobs, checkpoint=kept)
        kept.remove()
        return designs

    check_law(make, writes, tmp_path / "training.checkpoint")


def test_trainings_that_leave_folds_out_are_resumed(digits, writes, tmp_path):
    """Eleven trainings: the sixth and the last are stopped, too."""
    few = replace(digits, x_train=digits.x_train[:40], y_train=digits.y_train[:40])
    given = {**SHORT, "epochs": 1}
    check_law(
        lambda path: [learn(few, checkpoint=path, **given)], writes, tmp_path / "few.checkpoint"
    )


@pytest.fixture
def stopped(few, writes, tmp_path, unfolded):
    """Checkpoint of a training that was stopped after three steps."""
    writes["last"] = 3
    path = tmp_path / "training.checkpoint"
    with pytest.raises(Stopped):
        learn(few, checkpoint=path, **SHORT)
    writes["last"] = 0
    return path


@pytest.mark.parametrize(
    "change", [{"seed": 4}, {"photons": 1e4}, {"lr": 1e-3}, {"epochs": 3}, {"noise": "poisson"}]
)
def test_a_checkpoint_of_other_settings_is_refused_and_kept(few, stopped, change):
    before = stopped.read_bytes()
    with pytest.raises(InputError, match=r"training\.checkpoint is of another training.*") as said:
        learn(few, checkpoint=stopped, **{**SHORT, **change})
    assert "\n" not in str(said.value)
    assert "deepfsi, 5 masks, 1000 photons" in str(said.value)
    assert stopped.read_bytes() == before


def test_a_checkpoint_of_other_data_is_refused(few, stopped):
    other = replace(few, x_train=few.x_train[::-1].copy())
    with pytest.raises(InputError, match="is of another training"):
        learn(other, checkpoint=stopped, **SHORT)


def test_a_checkpoint_of_another_source_file_is_refused(few, writes, tmp_path, monkeypatch):
    (tmp_path / "lab_net.py").write_text("import torch\nnet = torch.nn.Linear\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    given = settings({"classifier": "lab_net:net", "hidden": None})
    source = iter("abab")
    monkeypatch.setattr(module, "source_hash", lambda name: next(source))
    path, writes["last"] = tmp_path / "training.checkpoint", 2
    with pytest.raises(Stopped):
        learn(few, checkpoint=path, **given)
    with pytest.raises(InputError, match="is of another training"):
        learn(few, checkpoint=path, **given)


def damages(path: Path):
    content, tensors = path.read_bytes(), load_file(path)
    yield content[: len(content) // 2]
    yield b""
    yield b"photons"
    for place in (20, len(content) // 2, len(content) - 3):
        yield content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :]
    save_file(tensors, path)
    yield path.read_bytes()  # no header


def test_a_damaged_checkpoint_is_named(few, stopped):
    sound = stopped.read_bytes()
    for damaged in list(damages(stopped)):
        stopped.write_bytes(damaged)
        with pytest.raises(InputError, match=r"training\.checkpoint (is damaged|is of another)"):
            learn(few, checkpoint=stopped, **SHORT)
    stopped.write_bytes(sound)
    learn(few, checkpoint=stopped, **SHORT)


@pytest.mark.usefixtures("unfolded")
def test_a_full_disk_does_not_end_a_training(few, writes, monkeypatch, tmp_path):
    def full(path, content):
        raise InputError(f"cannot write {path}: no space left; nothing of it was kept")

    monkeypatch.setattr(module, "write_atomically", full)
    with pytest.warns(UserWarning, match="no space left"):
        design = learn(few, checkpoint=tmp_path / "training.checkpoint", **SHORT)
    assert bits(design) == bits(learn(few, **SHORT))


@pytest.mark.usefixtures("unfolded")
def test_the_time_before_a_stop_counts(few, stopped, monkeypatch):
    read = module.read_tensors

    def late(*given):
        text, tensors = read(*given)
        return re.sub(r'"seconds": ?[\d.e-]+', '"seconds": 1000.0', text), tensors

    monkeypatch.setattr(module, "read_tensors", late)
    assert 1000 < learn(few, checkpoint=stopped, **SHORT).info["seconds"] < 2000


@pytest.mark.usefixtures("unfolded")
def test_a_training_that_diverged_leaves_no_checkpoint(few, writes, tmp_path):
    path = tmp_path / "training.checkpoint"
    with pytest.raises(Diverged):
        learn(few, checkpoint=path, **{**SHORT, "lr": 1e30, "mask_lr": 1e30})
    assert writes["count"]
    assert not path.exists()


@pytest.mark.usefixtures("unfolded")
@pytest.mark.parametrize("number", interrupts.STOP_SIGNALS)
def test_a_signal_ends_a_training_after_its_step_and_writes_it(few, monkeypatch, tmp_path, number):
    """A handler that a command line has: it raises. The resumed training is the whole one."""
    path, usual = tmp_path / "training.checkpoint", signal.getsignal(number)
    monkeypatch.setattr(module, "STOP_SECONDS", 0.0)
    steps = []

    def stop(number, frame):
        raise KeyboardInterrupt

    def report(share, what):
        steps.append(share)
        if len(steps) == 3:
            os.kill(os.getpid(), number)

    monkeypatch.setattr(loop, "REPORT_SECONDS", 0.0)
    signal.signal(number, stop)
    try:
        with pytest.raises(KeyboardInterrupt):
            learn(few, checkpoint=path, report=Progress(report), **SHORT)
    finally:
        signal.signal(number, usual)
    assert path.exists()
    assert bits(learn(few, checkpoint=path, **SHORT)) == bits(learn(few, **SHORT))

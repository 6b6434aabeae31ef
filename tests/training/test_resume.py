"""The law of checkpoints: a resumed training ends in the bits of one that was never stopped."""

import hashlib
import io
import pickle
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from conftest import RECIPE
from deepfsi.base.errors import InputError
from deepfsi.design.file import file_of
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.training import checkpoint as module
from deepfsi.training import loop
from deepfsi.training.checkpoint import Checkpoint
from deepfsi.training.learning import train
from shared.checkpoints import TRAININGS, Stopped, write_each_step
from shared.jobs import job as job_of
from shared.jobs import learn

SHORT = {**RECIPE, "epochs": 2, "batch": 32, "masks": 5, "photons": 1e3, "device": "cpu", "seed": 3}


def settings(changes):
    return {name: each for name, each in {**SHORT, **changes}.items() if each is not None}


@pytest.fixture
def few(digits):
    return replace(digits, x_train=digits.x_train[:100], y_train=digits.y_train[:100])


@pytest.fixture
def writes(monkeypatch):
    """Write a checkpoint after each step; end the training after one of them, numbered from 1."""
    return write_each_step(monkeypatch)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "training.checkpoint"


def bits(design) -> bytes:
    design.info["seconds"] = 0.0
    return file_of(design).to_bytes()


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


@pytest.mark.usefixtures("uncharacterised", "trained_once")
@pytest.mark.parametrize("case", TRAININGS)
def test_a_resumed_training_ends_in_the_same_bits(few, writes, path, case):
    given = settings(TRAININGS[case])
    check_law(lambda path: [learn(few, checkpoint=path, **given)], writes, path)


@pytest.mark.usefixtures("uncharacterised", "trained_once")
@pytest.mark.parametrize("stacked", [False, True])
@pytest.mark.parametrize("design", ["pca", "deepfsi"])
def test_designs_of_two_seeds_side_by_side_are_resumed(
    few, writes, path, monkeypatch, design, stacked
):
    usual = loop.Replicas
    monkeypatch.setattr(loop, "Replicas", lambda nets, _, dtype: usual(nets, stacked, dtype))
    given = settings({"noise": "poisson", "design": design, "dropout": 0.1, "device": None})
    numbers = ((3, 1e2), (3, 1e4), (5, 1e3))
    jobs = [job_of(**{**given, "seed": seed, "photons": photons}) for seed, photons in numbers]
    training_set = TrainingSet(few, "cpu")

    def make(path):
        kept = Checkpoint.of(path, training_set, jobs)
        designs = train(training_set, jobs, checkpoint=kept)
        kept.remove()
        return designs

    check_law(make, writes, path)


def test_trainings_that_leave_folds_out_are_resumed(digits, writes, path, monkeypatch):
    """Eleven trainings: the sixth and the last are stopped, too."""
    from deepfsi.training import characterisation  # by its path it is not found once left out

    few_budgets = lambda photons, _: photons * np.array([1, 10])  # noqa: E731
    monkeypatch.setattr(characterisation, "calibration_budgets", few_budgets)
    few = replace(digits, x_train=digits.x_train[:40], y_train=digits.y_train[:40])
    given = settings({"epochs": 1})
    check_law(lambda path: [learn(few, checkpoint=path, **given)], writes, path)


@pytest.fixture
def stopped(few, writes, path, trained_once):
    writes["last"] = 3
    with pytest.raises(Stopped):
        learn(few, checkpoint=path, **SHORT)
    writes["last"] = 0
    return path


def test_a_checkpoint_of_another_training_is_refused_and_kept(few, stopped):
    changes = {"seed": 4}, {"photons": 1e4}, {"lr": 1e-3}, {"epochs": 3}, {"noise": "poisson"}
    others = [(few, change) for change in changes]
    others.append((replace(few, x_train=few.x_train[::-1].copy()), {}))
    before = stopped.read_bytes()
    for data, change in others:
        match = r"training\.checkpoint is of another training.*deepfsi, 5 masks, 1000 photons"
        with pytest.raises(InputError, match=match):
            learn(data, checkpoint=stopped, **settings(change))
        assert stopped.read_bytes() == before


def damages(path: Path):
    content = path.read_bytes()
    yield from (content[: len(content) // 2], b"", b"photons")
    for place in (20, len(content) // 2, len(content) - 3):
        yield content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :]
    bomb = io.BytesIO()
    sound = zipfile.ZipFile(io.BytesIO(content[32:]))
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as packed:
        for name in sound.namelist():
            packed.writestr(name, sound.read(name) + bytes(10**6))
    strange = io.BytesIO()
    torch.save({"key": "x"}, strange)
    for made in (bomb.getvalue(), strange.getvalue(), pickle.dumps(print), b""):
        yield hashlib.sha256(made).digest() + made


def test_a_damaged_checkpoint_is_named(few, stopped):
    sound = stopped.read_bytes()
    for damaged in list(damages(stopped)):
        stopped.write_bytes(damaged)
        with pytest.raises(InputError, match=r"training\.checkpoint (is damaged|is of another)"):
            learn(few, checkpoint=stopped, **SHORT)
    stopped.write_bytes(sound)
    learn(few, checkpoint=stopped, **SHORT)


@pytest.mark.usefixtures("trained_once")
def test_a_full_disk_does_not_end_a_training(few, writes, monkeypatch, path):
    def full(path, content):
        raise InputError(f"cannot write {path}: no space left; nothing of it was kept")

    monkeypatch.setattr(module, "write_atomically", full)
    with pytest.warns(UserWarning, match="no space left"):
        design = learn(few, checkpoint=path, **SHORT)
    assert bits(design) == bits(learn(few, **SHORT))

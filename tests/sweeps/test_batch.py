"""Trials of whole scenes: batched, trained and tested."""

import weakref

import numpy as np
import pytest
import torch

from deepfsi import Design, InputError
from deepfsi.sweeps import batch
from deepfsi.training import learning
from deepfsi.training.learning import footprint
from shared.jobs import learn
from shared.trials import planned, train_trials

FOUR = {"designs": "deepfsi", "masks": 6, "photons": (1e1, 1e2, 1e3, 1e4)}


@pytest.fixture
def trainer(digits):
    return batch.BatchTrainer(digits, 0, "cpu")


def test_batches_are_split_to_fit_the_memory(digits, trainer):
    trials = planned(digits, **FOUR)
    jobs = [trial.job for trial in trials]
    need = [footprint(trainer.training_set, jobs[:n]) for n in (1, 2, 4)]
    assert need == sorted(set(need))
    for limit, sizes in ((0, [1, 1, 1, 1]), (need[1], [2, 2]), (need[2], [4])):
        assert [len(each) for each in trainer.batches_within(trials, limit)] == sizes


def test_a_processor_is_not_crowded_with_learned_masks(digits, trainer, monkeypatch):
    monkeypatch.setattr(batch, "MASKS_AT_ONCE", 12)
    trials = planned(digits, **{**FOUR, "designs": ("pca", "deepfsi")})
    batches = trainer.batches_within(trials, 1e12)
    assert {each[0].job.design: len(each) for each in batches} == {"pca": 4, "deepfsi": 2}


def test_a_failed_batch_is_freed_before_its_parts_are_trained(digits, trainer, monkeypatch):
    """Otherwise the smaller parts find the memory full, too."""
    real, failed = batch.train, []

    def train(scenes, jobs, *rest, **how):
        assert all(work() is None for work in failed)
        if len(jobs) == 1:
            return real(scenes, jobs, *rest, **how)
        work = np.zeros(3)
        failed.append(weakref.ref(work))
        raise (torch.OutOfMemoryError if len(jobs) > 2 else batch.Diverged)

    trials = planned(digits, photons=(1e2, 1e3, 1e4))[:4]
    monkeypatch.setattr(batch, "train", train)
    monkeypatch.setattr(batch.BatchTrainer, "batches_within", lambda self, trials, limit: [trials])
    assert len(trainer.train(trials)) == len(trials)
    assert len(failed) == 3


def test_memory_that_torch_keeps_on_a_gpu_is_free(monkeypatch):
    """8 GB of its 10 are used by no tensor; the device has 5 GB besides."""
    memory = {"mem_get_info": (5e9, 80e9), "memory_reserved": 10e9, "memory_allocated": 2e9}
    for name, value in memory.items():
        monkeypatch.setattr(torch.cuda, name, lambda device, value=value: value)
    assert learning.memory_for(torch.device("cuda")) == 13e9


def test_a_machine_that_batches_otherwise_still_works(digits, trainer, monkeypatch):
    """The one that planned had no bfloat16, this one has."""
    trials = planned(digits, designs="deepfsi", masks=3, photons=(1e3, 1e9))
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})
    assert len(trainer.train(trials)) == len(trials)


def test_a_trial_does_not_depend_on_its_companions(digits, tmp_path):
    photons = {"alone": 1e3, "together": (1e2, 1e3, 1e4)}
    for folder, budgets in photons.items():
        trials = planned(digits, photons=budgets, masks=3)
        train_trials(trials, digits, tmp_path / folder)
    for path in (tmp_path / "alone" / "designs").iterdir():
        one, other = (Design.load(tmp_path / each / "designs" / path.name) for each in photons)
        np.testing.assert_allclose(one.matrix, other.matrix, rtol=0, atol=1e-4)


def test_validation_scenes_are_not_trained_on(digits, tmp_path, monkeypatch):
    seen, real = [], batch.TrainingSet
    monkeypatch.setattr(batch, "TrainingSet", lambda data, *_: seen.append(data) or real(data))
    train_trials(planned(digits, designs="pca", masks=3, validation=200), digits, tmp_path)
    (parts,) = seen
    assert len(parts.x_train) == len(digits.x_train) - 200
    assert np.array_equal(parts.x_test, digits.x_train[-200:])


def test_what_does_not_fit_the_memory_is_refused_before_any_work(digits, trainer, monkeypatch):
    """By a training alone, and by a sweep for all its processes."""
    trials = planned(digits, **{**FOUR, "photons": (1e2, 1e3)})
    need = footprint(trainer.training_set, [trials[0].job]) - trainer.training_set.full.nbytes
    monkeypatch.setattr(learning, "free_memory", lambda: need - 1)
    with pytest.raises(InputError, match=r"1437 scenes of 64 pixels.*GB are free: give fewer"):
        learn(digits, photons=1e3, masks=6, device="cpu")
    with pytest.raises(InputError, match=r"6 masks and 1 processes need"):
        trainer.batches(trials[:1])
    monkeypatch.setattr(learning, "free_memory", lambda: need)
    assert len(trainer.batches(trials[:1])) == 1
    with pytest.raises(InputError, match=r"2 processes.*fewer `workers`"):
        trainer.batches(trials, workers=2)

"""Trials of whole scenes: batched, trained and tested."""

import weakref

import numpy as np
import pytest
import torch

from deepfsi import Design
from deepfsi.base import InputError
from deepfsi.exposure import TrainingSet
from deepfsi.sweeps import batch, plan_trials
from deepfsi.sweeps.batch import BatchTrainer
from deepfsi.training import footprint, train
from deepfsi.training import learning as memory
from shared.jobs import learn
from shared.trials import small, train_trials


def test_tests_count_grey_levels_as_the_training_does(digits):
    (trial,) = plan_trials(small(designs="pca", masks=3, photons=1e3, light="equal-dwell"), digits)
    (design,) = train(TrainingSet(digits, "cpu"), [trial.job])
    shown = design.quantised(2).rails.stacked.unique().double()
    near = torch.isclose(shown, shown.max(), rtol=1e-6) | (shown == 0)
    assert near.all()
    with pytest.raises(ValueError, match="dark alone"):
        small(test_levels=(0, 1))


def test_batches_are_split_to_fit_the_memory(digits):
    trials = plan_trials(small(designs="deepfsi", masks=6, photons=(1e1, 1e2, 1e3, 1e4)), digits)
    sweep = BatchTrainer(digits, 0, "cpu")
    need = [footprint(sweep.training_set, [trial.job for trial in trials[:n]]) for n in (1, 2, 4)]
    assert need == sorted(set(need))
    for limit, sizes in ((0, [1, 1, 1, 1]), (need[1], [2, 2]), (need[2], [4])):
        assert [len(batch) for batch in sweep.batches_within(trials, limit)] == sizes


def test_a_processor_is_not_crowded_with_learned_masks(digits, monkeypatch):
    monkeypatch.setattr(batch, "MASKS_AT_ONCE", 12)
    recipe = small(designs=("pca", "deepfsi"), masks=6, photons=(1e1, 1e2, 1e3, 1e4))
    found = BatchTrainer(digits, 0, "cpu").batches_within(plan_trials(recipe, digits), 1e12)
    assert {batch[0].job.design: len(batch) for batch in found} == {"pca": 4, "deepfsi": 2}


def test_a_gpu_out_of_memory_takes_smaller_batches(digits, tmp_path, monkeypatch):
    real = batch.train

    def train(scenes, jobs, *rest, **how):
        if len(jobs) > 1:
            raise torch.OutOfMemoryError
        return real(scenes, jobs, *rest, **how)

    trials = plan_trials(small(photons=(1e2, 1e3, 1e4)), digits)
    monkeypatch.setattr(batch, "train", train)
    assert len(train_trials(trials, digits, tmp_path)) == len(trials)


def test_a_batch_is_split_where_less_memory_is_free_than_was_planned_for(
    digits, tmp_path, monkeypatch
):
    trials = plan_trials(small(designs="deepfsi", masks=6, photons=(1e1, 1e2, 1e3, 1e4)), digits)
    sweep, sizes, real = BatchTrainer(digits, 0, "cpu"), [], batch.train
    need = footprint(sweep.training_set, [trial.job for trial in trials[:2]])
    monkeypatch.setattr(memory, "free_memory", lambda: need - sweep.training_set.full.nbytes)
    monkeypatch.setattr(
        batch,
        "train",
        lambda at, jobs, *rest, **how: sizes.append(len(jobs)) or real(at, jobs, *rest, **how),
    )
    assert len(sweep.train(trials)) == 4
    assert sizes == [2, 2]


def test_a_failed_batch_is_freed_before_its_parts_are_trained(digits, monkeypatch):
    """Otherwise the smaller parts find the memory full, too."""
    real, held = batch.train, []

    def train(scenes, jobs, *rest, **how):
        assert all(each() is None for each in held)
        if len(jobs) == 1:
            return real(scenes, jobs, *rest, **how)
        work = np.zeros(3)
        held.append(weakref.ref(work))
        raise (torch.OutOfMemoryError if len(jobs) > 2 else batch.Diverged)

    trials = plan_trials(small(photons=(1e2, 1e3, 1e4)), digits)[:4]
    monkeypatch.setattr(batch, "train", train)
    monkeypatch.setattr(BatchTrainer, "batches_within", lambda self, batch, limit: [batch])
    assert len(BatchTrainer(digits, 0, "cpu").train(trials)) == len(trials)
    assert len(held) == 3


def test_memory_that_torch_keeps_on_a_gpu_is_free(monkeypatch):
    """8 GB of its 10 are used by no tensor; the device has 5 GB besides."""
    for name, value in (("mem_get_info", (5e9, 80e9)), ("memory_reserved", 10e9)):
        monkeypatch.setattr(torch.cuda, name, lambda device, value=value: value)
    monkeypatch.setattr(torch.cuda, "memory_allocated", lambda device: 2e9)
    assert memory.memory_for(torch.device("cuda")) == 13e9


def test_every_trial_is_in_one_batch(digits):
    trials = plan_trials(small(trials=3, photons=(1e2, 1e7)), digits)
    sweep = BatchTrainer(digits, 0, "cpu")
    found = sweep.batches_within(trials, 1e12)
    assert sorted(trial.key for batch in found for trial in batch) == sorted(
        trial.key for trial in trials
    )
    costs = [sweep.effort(batch) for batch in found]
    assert costs == sorted(costs, reverse=True)


def test_a_machine_that_batches_otherwise_still_works(digits, monkeypatch):
    """The one that planned had no bfloat16, this one has."""
    trials = plan_trials(small(designs="deepfsi", masks=3, photons=(1e3, 1e9)), digits)
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})
    assert len(BatchTrainer(digits, 0, "cpu").train(trials)) == len(trials)


def test_a_trial_does_not_depend_on_its_companions(digits, tmp_path):
    alone = plan_trials(small(photons=1e3, masks=3), digits)
    together = plan_trials(small(photons=(1e2, 1e3, 1e4), masks=3), digits)
    train_trials(alone, digits, tmp_path / "alone")
    train_trials(together, digits, tmp_path / "together")
    for trial in alone:
        name = f"{trial.design_key}.safetensors"
        one = Design.load(tmp_path / "alone" / "designs" / name)
        other = Design.load(tmp_path / "together" / "designs" / name)
        np.testing.assert_allclose(one.matrix, other.matrix, rtol=0, atol=1e-4)


def test_validation_scenes_are_not_trained_on(digits, tmp_path, monkeypatch):
    seen = []
    real = batch.TrainingSet
    monkeypatch.setattr(batch, "TrainingSet", lambda data, *_: seen.append(data) or real(data))
    train_trials(
        plan_trials(small(designs="pca", masks=3, validation=200), digits), digits, tmp_path
    )
    (parts,) = seen
    assert len(parts.x_train) == len(digits.x_train) - 200
    assert np.array_equal(parts.x_test, digits.x_train[-200:])


def test_a_matrix_of_ones_own_is_compared(digits, tmp_path):
    matrix = np.eye(64)[:5] / 5
    trials = plan_trials(small(designs=("custom", "pca"), masks=5), digits, matrix)
    assert {trial.job.design: trial.job.masks for trial in trials} == {"custom": 5, "pca": 5}
    assert len(train_trials(trials, digits, tmp_path, matrix=matrix)) == len(trials)


def test_what_does_not_fit_the_memory_is_refused_before_any_work(digits, monkeypatch):
    """By a training alone, and by a sweep for all its processes."""
    trials = plan_trials(small(designs="deepfsi", masks=6, photons=(1e2, 1e3)), digits)
    sweep = BatchTrainer(digits, 0, "cpu")
    need = footprint(sweep.training_set, [trials[0].job])
    held = sweep.training_set.full.nbytes
    monkeypatch.setattr(memory, "free_memory", lambda: need - held - 1)
    with pytest.raises(InputError, match=r"1437 scenes of 64 pixels.*GB are free: give fewer"):
        learn(digits, photons=1e3, masks=6, device="cpu")
    with pytest.raises(InputError, match=r"6 masks and 1 processes need"):
        sweep.batches(trials[:1])
    monkeypatch.setattr(memory, "free_memory", lambda: need - held)
    assert len(sweep.batches(trials[:1])) == 1
    with pytest.raises(InputError, match=r"2 processes.*fewer `workers`"):
        sweep.batches(trials, workers=2)

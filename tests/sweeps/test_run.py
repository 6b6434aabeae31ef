"""Comparisons of recipes, and their trials that are stopped, killed, shared and repeated."""

import json
import multiprocessing
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from deepfsi import Design, InputError, evaluate
from deepfsi.base.intervals import unpack_values
from deepfsi.sweeps import batch
from deepfsi.sweeps.plan import Trial
from deepfsi.sweeps.records import Records
from deepfsi.sweeps.results import RESULTS_SCHEMA
from deepfsi.sweeps.run import compare
from shared.trials import planned, small, train_trials


@pytest.fixture
def trained(monkeypatch):
    """Keys of all jobs that are trained, as often as they are."""
    real, seen = batch.train, []

    def train(scenes, jobs, *rest, **how):
        seen.extend(job.model_dump_json() for job in jobs)
        return real(scenes, jobs, *rest, **how)

    monkeypatch.setattr(batch, "train", train)
    return seen


def test_levels_are_an_axis(digits, tmp_path):
    training = {"epochs": 1}
    trials = planned(digits, designs="deepfsi", masks=3, levels=[0, 2, 769], training=training)
    levels = [trial.job.camera.levels for trial in trials]
    assert set(levels) == {0, 2, 769}
    read = [Trial.model_validate_json(trial.model_dump_json()) for trial in trials]
    assert [trial.key for trial in read] == [trial.key for trial in trials]
    records = train_trials(trials, digits, tmp_path)
    assert [record["trial"]["job"]["camera"]["levels"] for record in records] == levels
    assert {test["levels"] for record in records for test in record["test"]} == {0}


def test_a_test_scene_that_was_trained_on_is_in_no_interval(digits, tmp_path):
    parts = {"x_test": digits.x_train, "y_test": digits.y_train}
    more = {k: np.concatenate([train[:1], getattr(digits, k)]) for k, train in parts.items()}
    data = replace(digits, **more)
    recipe = small(designs="pca", masks=3, photons=1e3, training={"epochs": 1})
    results, _ = compare(recipe, data, tmp_path, command="deepfsi")
    (point,) = results.points
    assert len(unpack_values(point.terms[0])) == len(digits.x_test)
    np.testing.assert_array_equal(
        np.sum(point.confusion, axis=1), np.bincount(digits.y_test, minlength=10)
    )


def test_records_are_reused_and_designs_are_what_was_tested(digits, tmp_path, trained):
    trials = planned(digits)
    first = train_trials(trials, digits, tmp_path, device="cpu")
    assert train_trials(trials, digits, tmp_path) == first
    assert len(trained) == len(trials)
    record = first[-1]
    design = Design.load(tmp_path / "designs" / f"{record['design']}.safetensors")
    job = record["trial"]["job"]
    again = evaluate(design, digits, job["photons"], draws=1, seed=job["seed"])[0]
    assert again.accuracy == record["test"][0]["accuracy"]
    assert not list(tmp_path.glob("**/.*"))


def test_two_at_once_on_one_folder_share_the_work(digits, tmp_path, trained):
    trials = planned(digits, trials=2, masks=3, designs=("pca", "random", "lda"))
    with ThreadPoolExecutor() as pool:
        runs = [pool.submit(train_trials, trials, digits, tmp_path) for _ in range(3)]
        found = [run.result() for run in runs]
    assert len(trained) == len(trials)
    assert found[0] == found[1] == found[2]
    assert [record["key"] for record in found[0]] == [trial.key for trial in trials]
    assert not list(tmp_path.glob("**/locks"))


def test_other_tests_of_the_same_training_need_no_training(digits, tmp_path, trained):
    train_trials(planned(digits, designs="deepfsi"), digits, tmp_path)
    count = len(trained)
    tests = {"test_photons": (1e3, 1e5), "test_noise": ("poisson", "ml_gauss")}
    more = planned(digits, designs="deepfsi", **tests, test_levels=(0, 9))
    records = train_trials(more, digits, tmp_path)
    assert len(trained) == count
    assert {len(record["test"]) for record in records} == {2 * 2 * 2}
    fresh = train_trials(more, digits, tmp_path / "fresh")
    for one, other in zip(records, fresh, strict=True):
        assert [t["accuracy"] for t in one["test"]] == [t["accuracy"] for t in other["test"]]


def shared_training(digits):
    """Trials that differ in their tests only."""
    once, twice = (planned(digits, designs="pca", masks=3, draws=draws) for draws in (1, 2))
    return once + twice


def test_trials_of_one_training_train_it_once(digits, tmp_path):
    """The lock on their common design must not lock them out."""
    trials = shared_training(digits)
    assert len({trial.design_key for trial in trials}) == len(trials) / 2
    assert len(train_trials(trials, digits, tmp_path)) == len(trials)
    assert len(list((tmp_path / "designs").iterdir())) == len(trials) / 2


@pytest.mark.slow
def test_processes_give_what_one_gives_and_leave_those_of_the_caller_alone(digits, tmp_path):
    trials = planned(digits, designs="deepfsi", masks=3, photons=1e3, trials=1)
    patches = {"designs": "pca", "masks": 3, "photons": 1e3, "trials": 1, "exposure": {"patch": 4}}
    trials += planned(digits, **patches) + shared_training(digits)
    wild = planned(digits, designs="pca", masks=6, training={"epochs": 2, "lr": 1e30})
    mine = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(600,))
    mine.start()
    try:
        with pytest.raises(InputError, match=r"diverged and the others are done: pca, 6 masks;"):
            train_trials([*trials, *wild], digits, tmp_path / "two", workers=2)
        assert mine.is_alive()
    finally:
        mine.kill()
        mine.join()
        mine.close()
    assert not list(tmp_path.glob("**/locks"))
    assert len(list((tmp_path / "two" / "designs").iterdir())) < len(trials)
    two = train_trials(trials, digits, tmp_path / "two")
    one = train_trials(trials, digits, tmp_path / "one")
    for first, second in zip(one, two, strict=True):
        assert first["key"] == second["key"]
        assert first["test"] == second["test"]


def test_a_trial_that_diverges_is_named_and_the_others_are_done(digits, tmp_path):
    trials = planned(digits, designs="pca", masks=3, training={"epochs": 2, "lr": [1e-2, 1e30]})
    with pytest.raises(InputError, match=r"diverged.*pca, 3 masks"):
        train_trials(trials, digits, tmp_path)
    assert not list(tmp_path.glob("**/locks"))
    assert len(list((tmp_path / "trials").iterdir())) == len(trials) / 2


def test_a_lock_whose_folder_another_process_takes_away_is_not_taken(digits, tmp_path, monkeypatch):
    """The folder is there when it is made, and gone when it is looked for."""

    def make(*_):
        raise FileExistsError

    records = Records(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr("os.mkdir", make)
        assert not records.lock(planned(digits))
    assert records.lock(planned(digits, designs="pca", masks=3))
    records.release_all()


@pytest.fixture
def alone(digits, tmp_path):
    """Give a trial that was trained, and the record of it."""
    trials = planned(digits, designs="pca", masks=3, photons=1e3)
    return trials, *train_trials(trials, digits, tmp_path)


@pytest.mark.parametrize(
    "damage", [{"test": [{}]}, {"key": "0" * 24}, {"schema": RESULTS_SCHEMA - 1, "test": []}]
)
def test_a_record_without_its_numbers_or_of_another_trial_is_none(digits, alone, tmp_path, damage):
    """Its design, if it is of this training, is tested anew and not trained."""
    trials, first = alone
    ([path], [design]) = (list((tmp_path / part).iterdir()) for part in ("trials", "designs"))
    trained = design.stat().st_mtime_ns
    path.write_text(json.dumps({**first, **damage}))
    [again] = train_trials(trials, digits, tmp_path)
    assert (again["key"], again["test"]) == (first["key"], first["test"])
    assert (design.stat().st_mtime_ns == trained) or "schema" not in damage


@pytest.mark.parametrize(
    ("folder", "left"),
    [("trials", None), ("designs", None), ("trials", '{"key":'), ("trials", "null")],
)
def test_what_is_lost_or_damaged_is_made_again(digits, alone, tmp_path, folder, left):
    trials, first = alone
    (path,) = (tmp_path / folder).iterdir()
    path.write_text(left) if left else path.unlink()
    (again,) = train_trials(trials, digits, tmp_path)
    assert again["key"] == first["key"]
    assert len(list(tmp_path.glob("*/*"))) == 2

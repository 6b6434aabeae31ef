"""Trials that are stopped, killed, shared and repeated."""

import fcntl
import multiprocessing
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from deepfsi import Design, evaluate
from deepfsi.base import InputError
from deepfsi.sweeps import context
from deepfsi.sweeps.trial import plan
from shared.trials import small, train_trials


def test_records_are_reused_and_designs_are_what_was_tested(digits, tmp_path, monkeypatch):
    trials = plan(small(), digits)
    first = train_trials(trials, digits, tmp_path, device="cpu")
    monkeypatch.setattr(context, "train", lambda *_: pytest.fail("a finished trial was repeated"))
    assert train_trials(trials, digits, tmp_path) == first
    record = first[-1]
    design = Design.load(tmp_path / "designs" / f"{record['design']}.safetensors")
    job = record["trial"]["job"]
    again = evaluate(design, digits, job["photons"], draws=1, seed=job["seed"])[0]
    assert again.accuracy == record["test"][0]["accuracy"]
    assert not list(tmp_path.glob("**/.*"))


def test_a_stopped_run_goes_on_where_it_was(digits, tmp_path, monkeypatch):
    trials = plan(small(), digits)
    real, calls = context.train, []

    def stop_at_third(*arguments):
        calls.append(arguments)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return real(*arguments)

    monkeypatch.setattr(context, "train", stop_at_third)
    with pytest.raises(KeyboardInterrupt):
        train_trials(trials, digits, tmp_path)
    assert len(list((tmp_path / "trials").iterdir())) == 4
    train_trials(trials, digits, tmp_path)
    assert len(calls) == 3 + 2


@pytest.fixture
def trained(monkeypatch):
    """Keys of all jobs that are trained, as often as they are."""
    real, seen = context.train, []

    def train(scenes, jobs, *rest):
        seen.extend(job.model_dump_json() for job in jobs)
        return real(scenes, jobs, *rest)

    monkeypatch.setattr(context, "train", train)
    return seen


def test_two_at_once_on_one_folder_share_the_work(digits, tmp_path, trained, monkeypatch):
    """Also where file locks do nothing, as on network folders that are mounted without them."""
    monkeypatch.setattr(fcntl, "flock", lambda *_: None)
    monkeypatch.setattr(fcntl, "lockf", lambda *_: None)
    trials = plan(small(trials=2, designs=("pca", "random", "lda")), digits)
    with ThreadPoolExecutor() as pool:
        runs = [pool.submit(train_trials, trials, digits, tmp_path) for _ in range(3)]
        found = [run.result() for run in runs]
    assert len(trained) == len(trials)
    assert found[0] == found[1] == found[2]
    assert [record["key"] for record in found[0]] == [trial.key for trial in trials]
    assert not list(tmp_path.glob("**/locks"))


def test_other_tests_of_the_same_training_need_no_training(digits, tmp_path, trained):
    train_trials(plan(small(), digits), digits, tmp_path)
    count = len(trained)
    more = small(test_photons=(1e3, 1e5), test_noise=("poisson", "ml_gauss"), test_levels=(0, 9))
    records = train_trials(plan(more, digits), digits, tmp_path)
    assert len(trained) == count
    assert {len(record["test"]) for record in records} == {2 * 2 * 2}
    fresh = train_trials(plan(more, digits), digits, tmp_path / "fresh")
    for one, other in zip(records, fresh, strict=True):
        assert [t["accuracy"] for t in one["test"]] == [t["accuracy"] for t in other["test"]]


def test_a_changed_recipe_trains_only_what_is_new(digits, tmp_path, trained):
    train_trials(plan(small(), digits), digits, tmp_path)
    trained.clear()
    grown = small(masks=(3, 6, 9), trials=2)
    train_trials(plan(grown, digits), digits, tmp_path)
    assert len(trained) == 2 * 2 * 3 * 2 - 2 * 2 * 2


def shared_training(digits):
    """Trials that differ in their tests only."""
    recipes = [small(designs="pca", masks=3, draws=draws) for draws in (1, 2)]
    return [trial for recipe in recipes for trial in plan(recipe, digits)]


def test_trials_of_one_training_train_it_once(digits, tmp_path):
    """The lock on their common design must not lock them out."""
    trials = shared_training(digits)
    assert len({trial.design_key for trial in trials}) == len(trials) / 2
    assert len(train_trials(trials, digits, tmp_path)) == len(trials)
    assert len(list((tmp_path / "designs").iterdir())) == len(trials) / 2


@pytest.mark.slow
def test_processes_give_what_one_gives_and_leave_those_of_the_caller_alone(digits, tmp_path):
    recipe = small(designs=("deepfsi", "random", "control"), photons=1e3, trials=1)
    patches = small(designs="pca", masks=3, photons=1e3, trials=1, exposure={"patch": 4})
    trials = plan(recipe, digits) + plan(patches, digits) + shared_training(digits)
    wild = plan(small(designs="pca", masks=6, training={"epochs": 2, "lr": 1e30}), digits)
    mine = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(600,))
    mine.start()
    try:
        with pytest.raises(InputError, match=r"diverged and the others are done: pca, 6 masks;"):
            train_trials([*trials, *wild], digits, tmp_path / "two", count=2)
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
    recipe = small(designs="pca", masks=3, training={"epochs": 2, "lr": [1e-2, 1e30]})
    trials = plan(recipe, digits)
    with pytest.raises(InputError, match=r"diverged.*pca, 3 masks"):
        train_trials(trials, digits, tmp_path)
    assert not list(tmp_path.glob("**/locks"))
    assert len(list((tmp_path / "trials").iterdir())) == len(trials) / 2

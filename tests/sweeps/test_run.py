"""Recipes, records and their summary."""

import json
import math
import multiprocessing
import os
import signal
import subprocess
import sys
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import polars
import pytest
import torch
from scipy import stats

from deepfsi.datasets import load_dataset
from deepfsi.design.artifact import Design
from deepfsi.design.evaluation import evaluate
from deepfsi.errors import InputError
from deepfsi.sweeps import context
from deepfsi.sweeps.context import SweepContext
from deepfsi.sweeps.forecast import forecast_cost
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.recipe_files import parts
from deepfsi.sweeps.records import rows, write_table
from deepfsi.sweeps.run import compare
from deepfsi.sweeps.summary import summarise
from deepfsi.sweeps.trial import Trial, plan
from deepfsi.training.learning import train
from deepfsi.training.memory import footprint
from deepfsi.training.training_set import TrainingSet
from shared.trials import train_trials

FILES = {
    path.stem: tomllib.loads(path.read_text())
    for path in sorted((Path(__file__).parents[2] / "recipes").glob("*.toml"))
    if not path.stem.startswith("ovit")  # of another kind: test_ovit
}
RECIPES = {
    " ".join(filter(None, (name, part, "quick" * quick))): settings
    for name, file in FILES.items()
    for quick in (False, True)
    if not quick or "quick" in file
    for part, settings in parts(file, quick).items()
}
SHORT = {"epochs": 2}


@pytest.fixture(scope="module")
def digits():
    return load_dataset("digits")


def small(**changes):
    settings = {
        "designs": ("pca", "deepfsi"),
        "photons": (1e2, 1e3),
        "masks": (3, 6),
        "draws": 1,
        "training": SHORT,
        **changes,
    }
    return Recipe(**settings)


def test_plan_holds_every_point_once(digits):
    trials = plan(small(trials=2), digits)
    assert len({trial.key for trial in trials}) == len(trials) == 2 * 2 * 2 * 2


def test_designs_without_a_choice_of_masks_appear_once(digits):
    trials = plan(small(designs=("impulse", "raster", "hadamard"), photons=1e3), digits)
    assert [trial.job.masks for trial in trials] == [64, 64, 64]


def test_a_count_that_a_design_cannot_have_is_replaced_by_its_most(digits):
    assert small(designs="lda", masks=(20, 40)).mask_counts("lda", digits) == [9]


def test_paper_ratios_are_the_default(digits):
    counts = Recipe(designs="pca").mask_counts("pca", digits)
    assert counts == [1, 3, 6, 10, 16, 23, 31, 41, 52, 64]


@pytest.mark.parametrize(
    "change",
    [
        {"photons": (2e2, 1e3)},
        {"training": {"epochs": 3}},
        {"training": {"levels": 2}},
        {"draws": 2},
        {"validation": 100},
        {"light": "free-dwell"},
        {"noise": "gaussian"},
        {"test_noise": "ml_gauss"},
        {"tuned": {"deepfsi": {"lr": 1e-3}, "pca": {"lr": 1e-3}}},
    ],
)
def test_every_setting_changes_the_key(digits, change):
    before = {trial.key for trial in plan(small(), digits)}
    after = {trial.key for trial in plan(small(**change), digits)}
    assert len(after - before) >= len(before) / 2


def test_levels_are_an_axis_and_a_column(digits, tmp_path):
    recipe = small(designs="deepfsi", masks=3, training={"epochs": 1, "levels": [0, 2, 769]})
    trials = plan(recipe, digits)
    levels = [trial.job.training.levels for trial in trials]
    assert set(levels) == {0, 2, 769}
    assert {Trial.model_validate_json(t.model_dump_json()).key for t in trials} == {
        t.key for t in trials
    }
    table = rows(train_trials(trials, digits, tmp_path))
    assert [row["training_levels"] for row in table] == levels
    assert {row["levels"] for row in table} == {0}


def test_tests_count_grey_levels_as_the_training_does(digits):
    (trial,) = plan(small(designs="pca", masks=3, photons=1e3, light="equal-dwell"), digits)
    (design,) = train(TrainingSet(digits, "cpu"), [trial.job])
    shown = design.quantised(2).rails.unique().double()
    near = torch.isclose(shown, shown.max(), rtol=1e-6) | (shown == 0)
    assert near.all()
    with pytest.raises(ValueError, match="dark alone"):
        small(test_levels=(0, 1))


def test_other_data_changes_the_key(digits):
    other = load_dataset("digits", rescale=(0.1, 1.0))
    keys = [{trial.key for trial in plan(small(), data)} for data in (digits, other)]
    assert not keys[0] & keys[1]


def test_all_mistakes_of_a_recipe_are_reported():
    with pytest.raises(ValueError, match="photons") as error:
        Recipe(photons=(-1.0,), trials=0, light="colum")
    assert {fault["loc"][0] for fault in error.value.errors()} == {"photons", "trials", "light"}


def test_records_are_reused_and_designs_are_what_was_tested(digits, tmp_path, monkeypatch):
    trials = plan(small(), digits)
    first = train_trials(trials, digits, tmp_path)
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


@pytest.mark.slow
def test_a_killed_process_leaves_only_whole_records(tmp_path):
    command = [sys.executable, "-m", "deepfsi", "compare", "--designs", "pca,random"]
    command += ["--epochs", "4", "--photons", "1e2", "--masks", "1,2,3,4,5,6", "--trials", "1"]
    command += ["--workers", "1", "-o", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    trials = tmp_path / "trials"
    deadline = time.monotonic() + 120
    while not (trials.is_dir() and len(list(trials.glob("*.json"))) >= 2):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    left = {path: path.stat().st_mtime_ns for path in trials.glob("*.json")}
    for path in left:
        assert json.loads(path.read_text())["test"]
    subprocess.run(command, check=True, capture_output=True)
    assert len(list(trials.glob("*.json"))) == 12
    assert {path: path.stat().st_mtime_ns for path in left} == left


@pytest.fixture
def trained(monkeypatch):
    """Keys of all jobs that are trained, as often as they are."""
    real, seen = context.train, []

    def train(scenes, jobs, *rest):
        seen.extend(job.model_dump_json() for job in jobs)
        return real(scenes, jobs, *rest)

    monkeypatch.setattr(context, "train", train)
    return seen


def test_two_at_once_on_one_folder_share_the_work(digits, tmp_path, trained):
    trials = plan(small(trials=4, designs=("pca", "random", "lda")), digits)
    with ThreadPoolExecutor() as pool:
        runs = [pool.submit(train_trials, trials, digits, tmp_path) for _ in range(3)]
        found = [run.result() for run in runs]
    assert len(trained) == len(trials)
    assert found[0] == found[1] == found[2]
    assert [record["key"] for record in found[0]] == [trial.key for trial in trials]
    assert not list(tmp_path.glob("**/*.lock"))


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


def shared_training():
    """Recipe of trials that differ in their tests only."""
    return small(designs="pca", masks=3, noise=("poisson", "gaussian"), train_noise="gaussian")


def test_trials_of_one_training_train_it_once(digits, tmp_path):
    """The claim on their common design must not lock them out."""
    trials = plan(shared_training(), digits)
    assert len({trial.design_key for trial in trials}) == len(trials) / 2
    assert len(train_trials(trials, digits, tmp_path)) == len(trials)
    assert len(list((tmp_path / "designs").iterdir())) == len(trials) / 2


@pytest.mark.slow
def test_processes_give_what_one_gives_and_leave_those_of_the_caller_alone(digits, tmp_path):
    recipe = small(designs=("deepfsi", "random", "control"), photons=1e3, trials=2)
    trials = plan(recipe, digits) + plan(shared_training(), digits)
    mine = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(600,))
    mine.start()
    try:
        two = train_trials(trials, digits, tmp_path / "two", count=2)
        assert mine.is_alive()
    finally:
        mine.kill()
        mine.join()
        mine.close()
    assert len(list((tmp_path / "two" / "designs").iterdir())) < len(trials)
    one = train_trials(trials, digits, tmp_path / "one")
    for first, second in zip(one, two, strict=True):
        assert first["key"] == second["key"]
        assert first["test"] == second["test"]


@pytest.mark.slow
def test_a_mistake_in_a_worker_is_told(digits, tmp_path):
    trials = plan(small(designs="deepfsi", photons=1e3, training={"epochs": 2, "lr": 1e30}), digits)
    with pytest.raises(InputError, match="diverged"):
        train_trials(trials, digits, tmp_path, count=2)
    assert not list(tmp_path.glob("**/*.lock"))


def test_batches_are_split_to_fit_the_memory(digits):
    trials = plan(small(designs="deepfsi", masks=6, photons=(1e1, 1e2, 1e3, 1e4)), digits)
    sweep = SweepContext(digits, 0, "cpu")
    need = [footprint(sweep.training_set, [trial.job for trial in trials[:n]]) for n in (1, 2, 4)]
    assert need == sorted(set(need))
    for limit, sizes in ((0, [1, 1, 1, 1]), (need[1], [2, 2]), (need[2], [4])):
        assert [len(batch) for batch in sweep.batches_within(trials, limit)] == sizes


def test_a_processor_is_not_crowded_with_learned_masks(digits, monkeypatch):
    monkeypatch.setattr(context, "MASKS_AT_ONCE", 12)
    recipe = small(designs=("pca", "deepfsi"), masks=6, photons=(1e1, 1e2, 1e3, 1e4))
    found = SweepContext(digits, 0, "cpu").batches_within(plan(recipe, digits), 1e12)
    assert {batch[0].job.design: len(batch) for batch in found} == {"pca": 4, "deepfsi": 2}


def test_a_gpu_out_of_memory_takes_smaller_batches(digits, tmp_path, monkeypatch):
    real = context.train

    def train(scenes, jobs, *rest):
        if len(jobs) > 1:
            raise torch.OutOfMemoryError
        return real(scenes, jobs, *rest)

    trials = plan(small(photons=(1e2, 1e3, 1e4)), digits)
    monkeypatch.setattr(context, "train", train)
    assert len(train_trials(trials, digits, tmp_path)) == len(trials)


def test_every_trial_is_in_one_batch(digits):
    trials = plan(small(trials=3, photons=(1e2, 1e7)), digits)
    sweep = SweepContext(digits, 0, "cpu")
    found = sweep.batches_within(trials, 1e12)
    assert sorted(trial.key for batch in found for trial in batch) == sorted(
        trial.key for trial in trials
    )
    costs = [sweep.effort(batch) for batch in found]
    assert costs == sorted(costs, reverse=True)


def test_every_list_of_the_training_is_an_axis(digits, tmp_path):
    recipe = small(
        designs="deepfsi",
        masks=3,
        photons=1e3,
        training={"epochs": 1, "start": ["pca", "random"], "hidden": [[8], [4, 4]]},
    )
    trials = plan(recipe, digits)
    assert len({trial.key for trial in trials}) == 4
    results, _ = compare(recipe, digits, tmp_path, command="deepfsi")
    assert len({point.variant for point in results.points}) == 4
    assert all(point.best for point in results.points)


def test_noise_of_the_training_may_be_another_than_that_of_the_test(digits, tmp_path):
    recipe = small(designs="deepfsi", masks=3, train_noise=("ml_gauss", "poisson", "gaussian"))
    results, _ = compare(recipe, digits, tmp_path, command="deepfsi")
    kinds = {(point.trained_under, point.noise) for point in results.points}
    assert kinds == {(train, "poisson") for train in ("ml_gauss", "poisson", "gaussian")}


def test_gaussian_noise_may_have_budgets_of_its_own(digits):
    both = small(noise=("poisson", "gaussian"), photons=1e3, gaussian_photons=(30, 300))
    budgets = {(trial.job.noise, trial.job.photons) for trial in plan(both, digits)}
    assert budgets == {("ml_gauss", 1e3), ("gaussian", 30), ("gaussian", 300)}


def test_a_table_has_a_row_for_each_test(digits, tmp_path):
    recipe = small(test_photons=(1e2, 1e4), test_levels=(0, 769))
    records = train_trials(plan(recipe, digits), digits, tmp_path)
    csv = polars.read_csv(write_table(records, tmp_path / "all.csv"))
    parquet = polars.read_parquet(write_table(records, tmp_path / "all.parquet"))
    assert csv.shape == parquet.shape
    assert len(csv) == len(records) * 4
    assert csv["accuracy"].to_list() == [t["accuracy"] for r in records for t in r["test"]]
    assert set(csv["levels"]) == {0, 769}
    with pytest.raises(InputError, match=r"\.csv or \.parquet"):
        write_table(records, tmp_path / "all.xls")


def test_a_trial_that_diverges_is_named_and_the_others_are_done(digits, tmp_path):
    recipe = small(designs="pca", masks=3, training={"epochs": 2, "lr": [1e-2, 1e30]})
    trials = plan(recipe, digits)
    with pytest.raises(InputError, match=r"diverged.*pca, 3 masks"):
        train_trials(trials, digits, tmp_path)
    assert len(list((tmp_path / "trials").iterdir())) == len(trials) / 2


def test_a_machine_that_batches_otherwise_still_works(digits, monkeypatch):
    """The one that planned had no bfloat16, this one has."""
    trials = plan(small(designs="deepfsi", masks=3, photons=(1e3, 1e9)), digits)
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})
    assert len(SweepContext(digits, 0, "cpu").train(trials)) == len(trials)


def test_settings_of_masks_do_not_multiply_fixed_designs(digits):
    recipe = small(masks=3, photons=1e3, training={"epochs": 1, "start": ["pca", "random"]})
    designs = [trial.job.design for trial in plan(recipe, digits)]
    assert sorted(designs) == ["deepfsi", "deepfsi", "pca"]


@pytest.mark.parametrize(
    ("settings", "parts"),
    [
        ({"training": {"epochs": [1, 0], "lr": -1, "start": "nope"}}, ("epochs", "lr", "start")),
        ({"training": {"lr": []}}, ("lr is empty",)),
        ({"photons": [[1e3, 1e4]]}, ("photons",)),
    ],
)
def test_mistakes_in_axes_are_all_told(settings, parts):
    with pytest.raises(ValueError, match=parts[0]) as error:
        small(**settings)
    assert all(part in str(error.value) for part in parts)


def test_a_record_that_is_something_else_is_made_again(digits, tmp_path):
    trials = plan(small(designs="pca", masks=3, photons=1e3), digits)
    train_trials(trials, digits, tmp_path)
    (path,) = (tmp_path / "trials").iterdir()
    path.write_text("null")
    assert len(train_trials(trials, digits, tmp_path)) == 1


def test_a_forecast_counts_what_is_left(digits, tmp_path):
    recipe = small(trials=2)
    before = forecast_cost(recipe, digits, tmp_path)
    first = plan(small(), digits)
    train_trials(first, digits, tmp_path)
    after = forecast_cost(recipe, digits, tmp_path)
    assert (before.trials, before.done, after.done) == (16, 0, len(first))
    assert before.operations == pytest.approx(2 * after.operations)
    assert 0 < after.seconds < math.inf
    train_trials(plan(recipe, digits), digits, tmp_path)
    assert forecast_cost(recipe, digits, tmp_path).seconds == 0


def test_a_trial_does_not_depend_on_its_companions(digits, tmp_path):
    alone = plan(small(photons=1e3, masks=3), digits)
    together = plan(small(photons=(1e2, 1e3, 1e4), masks=3), digits)
    train_trials(alone, digits, tmp_path / "alone")
    train_trials(together, digits, tmp_path / "together")
    for trial in alone:
        name = f"{trial.design_key}.safetensors"
        one = Design.load(tmp_path / "alone" / "designs" / name)
        other = Design.load(tmp_path / "together" / "designs" / name)
        np.testing.assert_allclose(one.matrix, other.matrix, rtol=0, atol=1e-4)


def record(photons, masks, seed, validation, test, noise="ml_gauss"):
    result = {"noise": "poisson", "photons": photons, "throughput": 0.5, "low": 0.1, "high": 0.9}
    result["levels"] = 0
    job = {"light": "column", "rails": "dual", "design": "pca", "photons": photons, "masks": masks}
    job["noise"] = noise
    return {
        "key": f"{masks}-{seed}",
        "design": f"{masks}-{seed}",
        "trial": {"job": job, "variant": ""},
        "validation": [{**result, "accuracy": validation}],
        "test": [{**result, "accuracy": test}],
        "info": {"seconds": 1.0, "device": "cpu"},
    }


def summary(data, records, **changes):
    return summarise(small(**changes), data, records, command="deepfsi", seconds=1.0).points


def test_mask_counts_are_chosen_on_validation_never_on_test(digits):
    records = [record(1e3, 3, 0, 0.8, 0.5), record(1e3, 6, 0, 0.7, 0.9)]
    best = [point.masks for point in summary(digits, records) if point.best]
    assert best == [3]


def test_interval_over_trials_is_students(digits):
    values = [0.80, 0.83, 0.85, 0.79]
    (point,) = summary(digits, [record(1e3, 3, k, 0.8, v) for k, v in enumerate(values)])
    low, high = stats.t.interval(0.95, 3, loc=np.mean(values), scale=stats.sem(values))
    assert (point.low, point.high) == pytest.approx((low, high))
    assert "4 trials" in point.covers


def test_interval_of_one_trial_is_that_of_its_images(digits):
    (point,) = summary(digits, [record(1e3, 3, 0, 0.8, 0.5)])
    assert (point.low, point.high) == (0.1, 0.9)
    assert "images" in point.covers


def test_trials_of_different_training_noise_are_different_points(digits):
    records = [record(1e3, 3, 0, 0.8, 0.5, noise) for noise in ("ml_gauss", "gaussian")]
    points = summary(digits, records)
    assert [(point.trained_under, point.trials) for point in points] == [
        ("ml_gauss", 1),
        ("gaussian", 1),
    ]


@pytest.mark.parametrize("loss", ["record", "design", "damage"])
def test_what_is_lost_is_made_again(digits, tmp_path, loss):
    trials = plan(small(designs="pca", masks=3, photons=1e3), digits)
    train_trials(trials, digits, tmp_path)
    (path,) = (tmp_path / ("designs" if loss == "design" else "trials")).iterdir()
    path.write_text('{"key":') if loss == "damage" else path.unlink()
    (again,) = train_trials(trials, digits, tmp_path)
    assert again["key"] == trials[0].key
    assert len(list(tmp_path.glob("*/*"))) == 2


def test_repeated_values_of_an_axis_count_once(digits):
    assert len(plan(small(designs="pca", masks=(3, 3), photons=(1e3, 1e3)), digits)) == 1


def test_impulse_imaging_is_one_reference_for_every_constraint(digits):
    recipe = small(designs="impulse", light=("column", "free-dwell"), rails=("dual", "single"))
    assert len(plan(recipe, digits)) == len(recipe.photons)


def test_designs_that_a_constraint_rules_out_are_left_out(digits):
    designs = ("raster", "pca", "hadamard", "impulse")
    two_arm = plan(small(designs=designs, light="two-arm"), digits)
    single = plan(small(designs=designs, rails="single"), digits)
    assert {trial.job.design for trial in two_arm} == {"pca", "hadamard", "impulse"}
    assert {trial.job.design for trial in single} == {"raster", "pca", "impulse"}


def test_more_masks_than_pixels_are_refused(digits):
    with pytest.raises(InputError, match="64"):
        plan(small(masks=(4, 100)), digits)


def test_without_validation_nothing_is_chosen(digits):
    records = [record(1e3, 3, 0, 0.8, 0.5), record(1e3, 6, 0, 0.7, 0.9)]
    for entry in records:
        entry["validation"] = []
    assert all(point.best for point in summary(digits, records, validation=0))


def test_validation_scenes_are_not_trained_on(digits, tmp_path, monkeypatch):
    seen = []
    real = context.TrainingSet
    monkeypatch.setattr(context, "TrainingSet", lambda data, *_: seen.append(data) or real(data))
    train_trials(plan(small(designs="pca", masks=3, validation=200), digits), digits, tmp_path)
    (parts,) = seen
    assert len(parts.x_train) == len(digits.x_train) - 200
    assert np.array_equal(parts.x_test, digits.x_train[-200:])


def test_a_matrix_of_ones_own_is_compared(digits, tmp_path):
    matrix = np.eye(64)[:5] / 5
    trials = plan(small(designs=("custom", "pca"), masks=5), digits, matrix)
    assert {trial.job.design: trial.job.masks for trial in trials} == {"custom": 5, "pca": 5}
    assert len(train_trials(trials, digits, tmp_path, matrix=matrix)) == len(trials)


def test_the_control_group_is_for_photon_noise(digits):
    both = plan(small(designs=("control", "pca"), noise=("poisson", "gaussian")), digits)
    noises = {trial.test_noise for trial in both if trial.job.design == "control"}
    assert noises == {("poisson",)}
    with pytest.raises(InputError, match="photon noise"):
        plan(small(designs="control", noise="gaussian"), digits)


def test_a_design_that_cannot_be_had_is_refused_before_any_work(digits):
    with pytest.raises(InputError, match="two-arm"):
        plan(small(light="two-arm", rails="single"), digits)


@pytest.mark.parametrize("settings", RECIPES.values(), ids=RECIPES)
def test_every_recipe_runs_small(settings, digits, tmp_path):
    Recipe(**settings)
    nested = settings.get("training", {}).get("nested", 0)
    tiny = {
        "data": "digits",
        "masks": max(4, *nested) if isinstance(nested, list) else max(4, nested),
        "ratios": (),
        "photons": 1e3,
        "trials": 1,
        "training": {**settings.get("training", {}), "epochs": 1},
    }
    recipe = Recipe(**{**settings, **tiny})
    results, _ = compare(recipe, digits, tmp_path, command="deepfsi")
    assert {point.design for point in results.points} == set(recipe.designs)

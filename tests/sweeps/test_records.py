"""Records on disk, and their table."""

import json

import polars
import pytest

from deepfsi.base import InputError
from deepfsi.sweeps import plan_trials, write_table
from shared.trials import small, train_trials


def test_a_table_has_a_row_for_each_test(digits, tmp_path):
    recipe = small(test_photons=(1e2, 1e4), test_levels=(0, 769))
    records = train_trials(plan_trials(recipe, digits), digits, tmp_path)
    csv = polars.read_csv(write_table(records, tmp_path / "all.csv"))
    parquet = polars.read_parquet(write_table(records, tmp_path / "all.parquet"))
    assert csv.shape == parquet.shape
    assert len(csv) == len(records) * 4
    assert csv["counts"].to_list() == [t["counts"] for r in records for t in r["test"]]
    assert csv["accuracy"].to_list() == [t["accuracy"] for r in records for t in r["test"]]
    for measure in ("accuracy", "balanced"):
        held = [t[measure] for r in records for t in r["validation"]]
        assert csv[f"validation_{measure}"].to_list() == held
    assert set(csv["levels"]) == {0, 769}
    with pytest.raises(InputError, match=r"\.csv or \.parquet"):
        write_table(records, tmp_path / "all.xls")


def test_records_of_another_schema_are_tested_anew_and_not_trained(digits, tmp_path):
    trials = plan_trials(small(designs="pca", masks=3, photons=1e3), digits)
    [first] = train_trials(trials, digits, tmp_path)
    [path] = (tmp_path / "trials").iterdir()
    [design] = (tmp_path / "designs").iterdir()
    trained = design.stat().st_mtime_ns
    path.write_text(json.dumps({**first, "schema": first["schema"] - 1, "test": []}))
    [again] = train_trials(trials, digits, tmp_path)
    assert again["test"] == first["test"]
    assert design.stat().st_mtime_ns == trained


@pytest.mark.parametrize(
    "damage",
    [
        {"test": [{}]},
        {"test": 1},
        {"info": {}},
        {"validation": [None]},
        {"design": None},
        {"key": "0" * 24},
    ],
)
def test_a_record_without_its_numbers_or_of_another_trial_is_none(digits, tmp_path, damage):
    trials = plan_trials(small(designs="pca", masks=3, photons=1e3), digits)
    [first] = train_trials(trials, digits, tmp_path)
    [path] = (tmp_path / "trials").iterdir()
    path.write_text(json.dumps({**first, **damage}))
    [again] = train_trials(trials, digits, tmp_path)
    assert (again["key"], again["test"]) == (first["key"], first["test"])


@pytest.mark.parametrize(
    ("folder", "left"),
    [("trials", None), ("designs", None), ("trials", '{"key":'), ("trials", "null")],
)
def test_what_is_lost_or_damaged_is_made_again(digits, tmp_path, folder, left):
    trials = plan_trials(small(designs="pca", masks=3, photons=1e3), digits)
    train_trials(trials, digits, tmp_path)
    (path,) = (tmp_path / folder).iterdir()
    path.write_text(left) if left else path.unlink()
    (again,) = train_trials(trials, digits, tmp_path)
    assert again["key"] == trials[0].key
    assert len(list(tmp_path.glob("*/*"))) == 2

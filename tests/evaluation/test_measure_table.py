"""A measure is one entry of the table: results, records, tables and points have it."""

import numpy as np
import pytest

from conftest import quick
from deepfsi import evaluate
from deepfsi.evaluation.measures import MEASURES, ClassAnswers, Measure
from deepfsi.evaluation.results import results_lines
from deepfsi.sweeps.plan import plan_trials
from deepfsi.sweeps.results import read_results, write_results
from deepfsi.sweeps.summary import summarise_records
from shared.trials import small, train_trials


def among_two(answers):
    """Share of exposures whose true class is one of the two most probable ones."""
    first = np.argsort(-answers.probabilities, axis=1)[:, :2]
    return float((first == answers.true[:, None]).any(axis=1).mean())


TOP_2 = Measure(
    key="top_2", title="top-2 accuracy", of=ClassAnswers, compute=among_two, column="top 2",
    averaged=True,
)  # fmt: skip


@pytest.mark.usefixtures("uncharacterised")
def test_a_new_measure_is_one_entry(digits, tmp_path, monkeypatch):
    monkeypatch.setitem(MEASURES, "top_2", TOP_2)
    design = quick(digits, "pca", masks=3, epochs=2)
    [result] = evaluate(design, digits, 1e3, draws=1)
    assert result.accuracy < result.further["top_2"] < 1
    assert list(result.as_dict())[-1] == "top_2"
    table = str([*results_lines([result], title="", classes=digits.classes)])
    assert "top 2" in table
    assert f"{result.score('top_2'):.3f}" in table
    recipe = small(designs=("pca",), photons=(1e3,), masks=(3,))
    records = train_trials(plan_trials(recipe, digits), digits, tmp_path / "runs")
    [held_out], [test] = records[0]["validation"], records[0]["test"]
    assert held_out["top_2"] > held_out["accuracy"]
    results = summarise_records(recipe, digits, [digits], [records], command="deepfsi", seconds=1.0)
    write_results(tmp_path / "results.json", results)
    [point] = read_results(tmp_path / "results.json").points
    assert point.further == {"top_2": test["top_2"]}

"""Sweeps over classifiers of one's own, named in a recipe."""

import numpy as np
import pytest

from conftest import same
from deepfsi import Design, InputError
from deepfsi.sweeps.plan import plan_trials
from deepfsi.sweeps.recipe import Recipe
from shared.jobs import learn
from shared.trials import small, train_trials

CNN = "shared.networks:Cnn"


def recipe(**changes) -> Recipe:
    training = {"epochs": 1, "classifier": ["mlp", CNN], **changes.pop("training", {})}
    settings = {"designs": "pca", "photons": [1e3, 1e4], "masks": 4, **changes}
    return small(training=training, **settings)


def test_a_recipe_names_classifiers_of_ones_own(digits, tmp_path):
    trials = plan_trials(recipe(), digits)
    assert {trial.variant for trial in trials} == {"classifier mlp", f"classifier {CNN}"}
    records = train_trials(trials, digits, tmp_path, device="cpu")
    for trial, record in zip(trials, records, strict=True):
        if trial.job.training.is_custom:
            design = Design.load(tmp_path / f"designs/{record['design']}.safetensors", trust=True)
            alone = learn(
                digits.hold_out(trial.validation), photons=trial.job.photons, masks=4,
                design="pca", epochs=1, classifier=CNN, device="cpu",
            )  # fmt: skip
            assert same(design, alone)
    named = {record["trial"]["job"]["training"]["classifier"] for record in records}
    assert named == {"mlp", CNN}
    # tested again, otherwise, without being trained again
    again = train_trials(plan_trials(recipe(draws=2), digits), digits, tmp_path)
    assert [record["design"] for record in again] == [record["design"] for record in records]
    assert all(record["test"][0]["draws"] == 2 for record in again)


def test_records_depend_on_the_file_of_the_classifier(digits, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    file = tmp_path / "edited_nets.py"
    keys = []
    for bias in (True, False):
        made = f"nn.Linear(i, c, bias={bias})"
        file.write_text(f"from torch import nn\ndef make(i, c): return {made}\n")
        trials = plan_trials(recipe(training={"classifier": "edited_nets:make"}), digits)
        keys.append({trial.design_key for trial in trials})
    assert not keys[0] & keys[1]


def test_an_unknown_classifier_is_refused_before_any_work(digits):
    with pytest.raises(InputError, match="has no attribute 'Rnn'"):
        plan_trials(recipe(training={"classifier": ["mlp", "shared.networks:Rnn"]}), digits)


def test_a_matrix_of_ones_own_is_compared(digits, tmp_path):
    matrix = np.eye(64)[:5] / 5
    trials = plan_trials(small(designs=("custom", "pca"), masks=5), digits, matrix)
    assert {trial.job.design: trial.job.masks for trial in trials} == {"custom": 5, "pca": 5}
    assert len(train_trials(trials, digits, tmp_path, matrix=matrix)) == len(trials)

"""Comparisons of recipes, those of the experiments among them."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from deepfsi.base.numeric import unpack_values
from deepfsi.cli.studies import shipped_recipes
from deepfsi.sweeps.recipe import Recipe, parts
from deepfsi.sweeps.records import rows
from deepfsi.sweeps.run import compare
from deepfsi.sweeps.trial import Trial, plan
from shared.trials import small, train_trials

FILES = {name: tomllib.loads(file.read_text()) for name, file in sorted(shipped_recipes().items())}


RECIPES = {
    f"{name} {part}".strip(): settings
    for name, file in FILES.items()
    for part, settings in parts(file).items()
}


def tiny(settings):
    """Settings of a recipe that trains each of its designs for a moment on digits."""
    camera, exposure = settings.get("camera", {}), settings.get("exposure", {})
    nested = exposure.get("nested", 0)
    detectors = camera.get("detectors", "1x1")
    training = {**settings.get("training", {}), "epochs": 1, "batch": 500}
    if "clusters" in training:
        training["clusters"] = 5
    if "patch" in exposure:
        exposure = {**exposure, "patch": 4}
        training["classifier_arguments"] = {"width": 8, "depth": 1, "heads": 2, "hidden": 8}
    return {
        **settings,
        "data": "digits",
        "images": None,
        "masks": max(4, *nested) if isinstance(nested, list) else max(4, nested),
        "ratios": (),
        "camera": {
            **camera,
            "detectors": detectors if isinstance(detectors, str) else detectors[:2],
        },
        "exposure": exposure,
        "photons": 1e3,
        "gaussian_photons": 1e3 if "gaussian_photons" in settings else (),
        "trials": 1,
        "validation": min(settings.get("validation", 200), 200),
        "training": training,
    }


UNLIKE = dict(
    {
        json.dumps(tiny(settings), sort_keys=True): (name, tiny(settings))
        for name, settings in reversed(RECIPES.items())
    }.values()
)
"""Tiny recipes that differ."""


def test_levels_are_an_axis_and_a_column(digits, tmp_path):
    recipe = small(designs="deepfsi", masks=3, levels=[0, 2, 769], training={"epochs": 1})
    trials = plan(recipe, digits)
    levels = [trial.job.camera.levels for trial in trials]
    assert set(levels) == {0, 2, 769}
    assert {Trial.model_validate_json(t.model_dump_json()).key for t in trials} == {
        t.key for t in trials
    }
    table = rows(train_trials(trials, digits, tmp_path))
    assert [row["training_levels"] for row in table] == levels
    assert {row["levels"] for row in table} == {0}


@pytest.mark.usefixtures("uncharacterised")
@pytest.mark.parametrize("settings", UNLIKE.values(), ids=UNLIKE)
def test_every_recipe_runs_small(settings, digits, tmp_path):
    recipe = Recipe(**settings)
    results, _ = compare(recipe, digits, tmp_path, command="deepfsi")
    assert {point.design for point in results.points} == set(recipe.designs)


def test_a_test_scene_that_was_trained_on_is_in_no_interval(digits, tmp_path):
    data = replace(
        digits,
        x_test=np.concatenate([digits.x_train[:1], digits.x_test]),
        y_test=np.concatenate([digits.y_train[:1], digits.y_test]),
    )
    recipe = small(designs="pca", masks=3, photons=1e3, training={"epochs": 1})
    results, _ = compare(recipe, data, tmp_path, command="deepfsi")
    (point,) = results.points
    assert len(unpack_values(point.terms[0])) == len(digits.x_test)
    np.testing.assert_array_equal(
        np.sum(point.confusion, axis=1), np.bincount(digits.y_test, minlength=10)
    )

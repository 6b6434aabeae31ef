"""Parts of a recipe file, its coarse versions, and adaptive masks in a recipe."""

from dataclasses import replace

import numpy as np
import pytest

from conftest import synthetic
from deepfsi import InputError, from_arrays
from deepfsi.sweeps.plan import check_settings, plan_trials, with_adaptive
from deepfsi.sweeps.recipe import Recipe, only

FILE = {
    "data": "mnist",
    "training": {"epochs": 40, "batch": 500},
    "quick": {"trials": 3, "training": {"epochs": 8}},
    "parts": {
        "one": {"training": {"decay": 2.0}},
        "two": {"data": "digits", "quick": {"training": {"epochs": 4}}},
    },
}
ONE = {"data": "mnist", "training": {"epochs": 40, "batch": 500, "decay": 2.0}}


@pytest.mark.parametrize(
    ("file", "asked", "words"),
    [
        (FILE, {}, "one, two"),
        (FILE, {"part": "tow"}, "one, two, and tow is asked for"),
        (ONE, {"part": "one"}, "no parts"),
        (ONE, {"quick": True}, "no .quick. table"),
        ({"parts": 3}, {}, r"write \[parts\]"),
        ({"parts": {"one": 3}}, {}, r"write \[one\]"),
        ({"quick": [1]}, {}, r"write \[quick\]"),
    ],
)
def test_what_a_file_does_not_have_is_refused(file, asked, words):
    with pytest.raises(InputError, match=words):
        only(file, **asked)


@pytest.mark.parametrize(
    ("asked", "looks"),
    [
        ({"ratios": (0.06, 0.16, 0.36)}, [23]),
        ({"ratios": (0.25, 0.5, 1.0)}, [32]),
        ({"ratios": 1.0}, [64]),
        ({}, [31]),
        ({"masks": (4, 40)}, [4, 40]),
    ],
    ids=str,
)
def test_ratios_ask_for_one_number_of_looks_of_adaptive_masks(digits, asked, looks):
    trials = plan_trials(Recipe(designs="adaptive", photons=1e3, **asked), digits)
    assert [trial.job.masks for trial in trials] == looks


@pytest.mark.parametrize(
    ("settings", "had"),
    [
        ({}, True),
        ({"camera": "two-arm", "masks": 8}, True),
        ({"camera": "paper"}, False),  # no look shows masks under the law column
        ({"camera": {"noise": "gaussian", "sigma": 1.0}}, False),
        ({"test_noise": "gaussian", "camera": {"sigma": 1.0}}, False),
        ({"exposure": {"span": 2}, "designs": "deepfsi"}, False),
    ],
    ids=str,
)
def test_adaptive_masks_are_compared_unasked_where_they_can_be_had(digits, settings, had):
    recipe, _ = check_settings({"designs": ("pca", "deepfsi"), **settings}, lambda _: digits)
    more = with_adaptive(recipe, digits)
    assert more.designs == (*recipe.designs, *("adaptive",) * had)


def test_adaptive_masks_are_left_out_where_they_take_long_or_have_no_classes(monkeypatch):
    monkeypatch.setattr("deepfsi.sweeps.plan.ADAPTIVE_SCENES", 300)
    recipe, many = Recipe(masks=4), synthetic((4, 4), scenes=300)
    assert "adaptive" in with_adaptive(recipe, many).designs
    more = replace(many, x_test=many.x_test[[0, *range(len(many.x_test))]])
    assert "adaptive" not in with_adaptive(recipe, more).designs
    x = np.random.default_rng(0).random((60, 9))
    values = from_arrays(x, x[:, :2].astype(float), values=["row", "column"])
    assert "adaptive" not in with_adaptive(Recipe(designs="pca", masks=4), values).designs

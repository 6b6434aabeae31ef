"""Expected cost of a sweep."""

import math

import pytest

from deepfsi.sweeps.forecast import forecast_cost
from deepfsi.sweeps.trial import plan
from shared.trials import small, train_trials


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

"""Expected cost of a sweep."""

import math

import pytest

from deepfsi.progress import Report
from deepfsi.sweeps import forecast
from deepfsi.sweeps.forecast import forecast_cost, slowdown
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


def test_processes_share_the_cores_with_other_programs():
    """Two of ours on two cores: alone at full speed, beside two others at half of it."""
    assert slowdown(0.0, 2, 2) == 1
    assert slowdown(2.0, 2, 2) == 2
    assert slowdown(2.0, 1, 2) == 1.5
    assert slowdown(3.0, 1, 16) == 1


@pytest.mark.parametrize(("others", "slower"), [(0.0, 1.0), (2.0, 2 / 1.5)])
def test_a_forecast_says_the_load_it_assumes(digits, tmp_path, monkeypatch, others, slower):
    """What one process was timed with takes two of them longer, where others want the cores."""
    monkeypatch.setattr(forecast._Load, "of_others", lambda _: others)
    monkeypatch.setattr(forecast, "cores", lambda: 2)
    seen = []
    report = Report(lambda share, what: seen.append((share, what)))
    found = forecast_cost(small(trials=2), digits, tmp_path, workers=2, report=report)
    assert (found.others, found.cores) == (others, 2)
    assert found.seconds / found.seconds_free == pytest.approx(slowdown(others, 2, 2))
    timed = found.seconds_free * slowdown(others, 1, 2)
    assert found.seconds / timed == pytest.approx(slower)
    assert [share for share, _ in seen] == sorted(share for share, _ in seen)
    assert len({what for _, what in seen}) > 1

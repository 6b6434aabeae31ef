"""Expected cost of a sweep."""

import math
from types import SimpleNamespace

import pytest

from deepfsi.base import Progress
from deepfsi.sweeps import forecast
from deepfsi.sweeps.context import SweepContext
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
    report = Progress(lambda share, what: seen.append((share, what)))
    found = forecast_cost(small(trials=2), digits, tmp_path, workers=2, report=report)
    assert (found.others, found.cores) == (others, 2)
    assert found.seconds / found.seconds_free == pytest.approx(slowdown(others, 2, 2))
    timed = found.seconds_free * slowdown(others, 1, 2)
    assert found.seconds / timed == pytest.approx(slower)
    assert [share for share, _ in seen] == sorted(share for share, _ in seen)
    assert len({what for _, what in seen}) > 1


def test_trainings_that_differ_in_seed_budget_and_masks_are_timed_as_one_kind(digits, tmp_path):
    seen = []
    recipe = small(masks=(3, 4, 6), trials=3)
    forecast_cost(recipe, digits, tmp_path, report=Progress(lambda share, what: seen.append(what)))
    assert {what.split(",")[0] for what in seen} == {"pca", "deepfsi"}
    assert len(seen) == 2


def test_a_test_is_counted_for_all_scenes_it_takes_at_each_budget_noise_and_level(
    digits, monkeypatch
):
    """On a clock that stands but for the tests: a millisecond for each of their scenes."""
    now = [0.0]
    clock = SimpleNamespace(perf_counter=lambda: now[0], process_time=lambda: 0.0)
    monkeypatch.setattr(forecast, "time", clock)

    def evaluate(design, data, *_, **how):
        now[0] += 1e-3 * len(data.x_test)

    monkeypatch.setattr(forecast, "evaluate", evaluate)
    recipe = small(
        designs="pca", masks=3, photons=1e3, validation=200, test_photons=(1e2, 1e3, 1e4),
        test_noise=("ml_gauss", "poisson"), test_levels=(0, 8),
    )  # fmt: skip
    sweep = SweepContext(digits, 200, "cpu")
    step, tests = forecast._probe(plan(recipe, digits), sweep)
    assert tests == pytest.approx(1e-3 * (len(digits.x_test) + 200) * 3 * 2 * 2)
    assert step > 0

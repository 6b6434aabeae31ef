"""Expected cost of a sweep, and photons that a target needs: crossings lie in the interval."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from deepfsi.base import InputError, Progress
from deepfsi.base.numeric import Crossing, find_crossing
from deepfsi.sweeps import Recipe, check_plan, forecast, forecast_cost, photons_needed, plan_trials
from deepfsi.sweeps.batch import BatchTrainer
from deepfsi.sweeps.forecast import next_budget, slowdown
from shared.trials import small, train_trials


def test_a_forecast_counts_what_is_left(digits, tmp_path):
    recipe = small(trials=2)
    before = forecast_cost(recipe, digits, tmp_path)
    first = plan_trials(small(), digits)
    train_trials(first, digits, tmp_path)
    after = forecast_cost(recipe, digits, tmp_path)
    assert (before.trials, before.done, after.done) == (16, 0, len(first))
    assert before.operations == pytest.approx(2 * after.operations)
    assert 0 < after.seconds < math.inf
    train_trials(plan_trials(recipe, digits), digits, tmp_path)
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

    monkeypatch.setattr("deepfsi.evaluation.evaluate", evaluate)
    recipe = small(
        designs="pca", masks=3, photons=1e3, validation=200, test_photons=(1e2, 1e3, 1e4),
        test_noise=("ml_gauss", "poisson"), test_levels=(0, 8),
    )  # fmt: skip
    sweep = BatchTrainer(digits, 200, "cpu")
    step, tests = forecast._probe(plan_trials(recipe, digits), sweep)
    assert tests == pytest.approx(1e-3 * (len(digits.x_test) + 200) * 3 * 2 * 2)
    assert step > 0


DECADES = (1e2, 1e3, 1e4, 1e5, 1e6)
TARGET, REPEATS = 0.9, 100


class MadeUp:
    """Accuracy that rises with log Φ in an S from chance to a ceiling, tested on the same images.

    An image is classified right where the accuracy exceeds its own threshold, so that all budgets
    err together; each training is off by some more.
    """

    def __init__(self, rng: np.random.Generator, width: float, ceiling: float, images: int) -> None:
        self.rng, self.width, self.ceiling = rng, width, ceiling
        self.middle = rng.uniform(3.2, 4.8)
        self.test, self.held_out = np.sort(rng.random((2, images)), axis=1)

    def accuracy(self, photons: float) -> float:
        steps = (np.log10(photons) - self.middle) / self.width
        return 0.1 + (self.ceiling - 0.1) / (1 + np.exp(-steps))

    @property
    def crossing(self) -> float:
        odds = (TARGET - 0.1) / (self.ceiling - TARGET)
        return 10 ** (self.middle + self.width * np.log(odds))

    def tested(self, photons: float, thresholds: np.ndarray) -> float:
        true = self.accuracy(photons) + 0.004 * self.rng.standard_normal()
        return float(np.searchsorted(thresholds, true)) / len(thresholds)


def planned(curve: MadeUp, trials: int, rounds: int) -> Crossing:
    """As `photons_needed` does."""
    tried = {budget: curve.tested(budget, curve.held_out) for budget in DECADES}
    for _ in range(rounds):
        budgets = sorted(tried)
        more = next_budget(budgets, [tried[budget] for budget in budgets], TARGET)
        if more is None:
            break
        tried[more] = curve.tested(more, curve.held_out)
    budgets = sorted(tried)
    tests = [[curve.tested(budget, curve.test) for _ in range(trials)] for budget in budgets]
    return find_crossing(budgets, tests, len(curve.test), TARGET)


@pytest.mark.parametrize("rounds", [0, 2])
@pytest.mark.parametrize("images", [300, 10_000])
@pytest.mark.parametrize(("width", "ceiling"), [(0.15, 0.95), (0.3, 0.97), (0.5, 1.0)])
def test_the_crossing_is_in_the_interval_at_the_stated_rate(width, ceiling, images, rounds):
    rng = np.random.default_rng(images)
    inside, decades = 0, []
    for _ in range(REPEATS):
        curve = MadeUp(rng, width, ceiling, images)
        found = planned(curve, 3, rounds)
        low, high = found.low or 0.0, found.high or np.inf
        inside += low <= curve.crossing <= high
        decades.append(np.log10(high) - np.log10(low or 1e-9))
    assert inside / REPEATS >= 0.95 - 5 * np.sqrt(0.95 * 0.05 / REPEATS)
    if rounds and images == 10_000:
        assert np.median(decades) < 0.3  # within a factor of 1.4 either way


def test_the_estimate_is_near_where_nothing_errs():
    rng = np.random.default_rng(1)
    for _ in range(20):
        curve = MadeUp(rng, 0.4, 0.98, 1)
        budgets = np.geomspace(1e2, 1e7, 11)
        exact = [[curve.accuracy(budget)] for budget in budgets]
        found = find_crossing(budgets, exact, 10**9, TARGET)
        assert found.found == "within"
        assert found.photons == pytest.approx(curve.crossing, rel=0.1)


def test_a_budget_that_is_tried_at_the_crossing_is_it():
    found = find_crossing([1e2, 1e3, 1e4], [[0.2], [0.9], [0.95]], 10**12, 0.9)
    assert found.photons == pytest.approx(1e3)
    assert found.low == pytest.approx(1e3, rel=0.02)
    assert found.high == pytest.approx(1e3, rel=0.02)


def test_more_seeds_that_differ_more_widen_the_interval():
    means = (0.2, 0.6, 0.85, 0.95, 0.97)
    calm, wild = (
        find_crossing(DECADES, [[p - off, p + off] for p in means], 10**6, 0.9)
        for off in (0.001, 0.02)
    )
    assert calm.photons == pytest.approx(wild.photons)
    assert wild.low < calm.low < calm.high < wild.high


@pytest.mark.parametrize(
    ("accuracies", "target", "wanted"),
    [
        ((0.5, 0.6, 0.7), 0.9, Crossing(None, 1e4, None, "beyond")),
        ((0.5, 0.6, 0.899), 0.9, ("beyond", 1e3, 1e4, None)),
        ((0.95, 0.96, 0.97), 0.9, Crossing(None, None, 1e2, "below")),
        ((0.901, 0.96, 0.97), 0.9, ("below", None, 1e2, 1e3)),
    ],
    ids=["surely beyond", "perhaps beyond", "surely below", "perhaps below"],
)
def test_targets_beyond_what_was_tried(accuracies, target, wanted):
    """An interval's end that is not known is None, and what is known of it is kept."""
    found = find_crossing([1e2, 1e3, 1e4], [[accuracy] for accuracy in accuracies], 300, target)
    if isinstance(wanted, Crossing):
        assert found == wanted
        return
    kind, open_end, *within = wanted
    assert (found.photons, found.found) == (None, kind)
    if kind == "beyond":
        assert found.high is None
        assert open_end <= found.low < within[0]
    else:
        assert found.low is None
        assert within[0] < found.high <= within[1]


def test_accuracies_out_of_order_are_brought_to_order():
    found = find_crossing(DECADES, [[0.2], [0.9], [0.86], [0.95], [0.97]], 1000, 0.9)
    assert found.found == "within"
    assert 1e4 < found.photons < 1e5
    assert 1e2 < found.low < 1e3


def test_budgets_are_added_at_the_crossing_and_apart_from_those_tried():
    assert next_budget([1e2, 1e3, 1e4], [0.2, 0.5, 0.7], 0.9) is None
    assert next_budget([1e2, 1e3, 1e4], [0.91, 0.95, 0.97], 0.9) is None
    assert next_budget([1e2, 1e3, 1e4], [0.2, 0.899, 0.95], 0.9) == pytest.approx(1585, rel=0.01)
    assert next_budget([1e2, 1e3, 1e4], [0.2, 0.5, 0.901], 0.9) == pytest.approx(6310, rel=0.01)
    assert 2e3 < next_budget([1e2, 1e3, 1e4], [0.2, 0.8, 0.95], 0.9) < 6e3
    assert next_budget([1e2, 1e3, 2e3], [0.2, 0.8, 0.95], 0.9) is None


QUICK = Recipe(
    designs=("pca", "raster"),
    photons=(1e3, 1e4, 1e6),
    masks=(2, 8),
    camera="paper",
    trials=2,
    training={"epochs": 6, "lr": 2e-2},
)


@pytest.fixture(scope="module")
def answer(digits, tmp_path_factory):
    folder = tmp_path_factory.mktemp("plan")
    return folder, photons_needed(QUICK, digits, 0.8, folder, command="ours")


def test_a_plan_on_digits(digits, answer):
    _, (plan, results) = answer
    assert plan["data"]["name"] == "digits"
    needs = {need["design"]: need for need in plan["needs"]}
    assert list(needs) == ["pca", "raster"]
    for need in needs.values():
        assert need["found"] == "within"
        assert need["low"] < need["photons"] < need["high"]
        budgets = [point["photons"] for point in need["tried"]]
        assert budgets == sorted(budgets)
        assert 3 < len(budgets) <= 5
        first = [point for point in need["tried"] if point["photons"] in QUICK.photons]
        more = next_budget(QUICK.photons, [point["validation"] for point in first], 0.8)
        assert more in budgets
    assert needs["pca"]["photons"] < needs["raster"]["photons"]
    assert needs["pca"]["masks"] == 8
    assert needs["raster"]["masks"] == digits.pixels
    json.dumps((plan, results.as_dict()))


def test_masks_are_chosen_on_validation_data(answer):
    _, (plan, results) = answer
    for need in plan["needs"]:
        for point in need["tried"]:
            rivals = [
                rival.validation
                for rival in results.points
                if (rival.design, rival.photons) == (need["design"], point["photons"])
            ]
            assert point["validation"] == max(rivals)


def test_a_plan_goes_on_where_it_was(digits, answer, monkeypatch):
    folder, first = answer
    monkeypatch.setattr("deepfsi.sweeps.batch.train", lambda *_, **__: pytest.fail("trained again"))
    assert photons_needed(QUICK, digits, 0.8, folder, command="ours")[0] == first[0]


@pytest.mark.parametrize(
    ("target", "changed", "words"),
    [
        (1.0, {}, "below 1"),
        (float("nan"), {}, "below 1"),
        (0.05, {}, "guessing"),
        (0.8, {"photons": (1e3, 1e4)}, "three budgets"),
        (0.8, {"validation": 0}, "held out"),
        (0.8, {"camera": {"light": "column", "noise": ("poisson", "gaussian")}}, "one noise"),
        (0.8, {"training": {"lr": (1e-2, 1e-3)}}, "one training"),
        (0.8, {"test_photons": (1e3,)}, "budget of the training"),
    ],
)
def test_what_cannot_be_planned(digits, target, changed, words):
    recipe = Recipe.model_validate({**QUICK.model_dump(exclude={"training"}), **changed})
    with pytest.raises(InputError, match=words):
        check_plan(recipe, digits, target)


def test_a_plan_has_a_curve_for_each_number_of_detectors(done, tmp_path):
    """Tiles need fewer photons, by masks of which each is read by all; the table says them."""
    words = ["plan", "--target", "0.75", "--designs", "pca,impulse", "--detectors", "1x1,2x2"]
    words += ["--light", "free-dwell", "--rails", "single", "--photons", "1e3,1e4,1e6"]
    words += [
        "--ratios",
        "0.2",
        "--trials",
        "1",
        "--epochs",
        "10",
        "--workers",
        "1",
        "-o",
        tmp_path,
    ]
    printed = done(*words)
    rows = [line.split() for line in printed.splitlines() if line.startswith((" PCA", " impulse"))]
    assert sorted(row[-1] for row in rows) == ["1x1", "2x2", "pixel"]
    needs = {(n["design"], n["detectors"]): n for n in json.loads(done(*words, "--json"))["needs"]}
    one, four = needs["pca", "1x1"], needs["pca", "2x2"]
    assert (one["masks"], four["masks"]) == (13, 3)
    assert four["found"] == "within"
    assert one["found"] == "beyond" or four["photons"] < one["photons"]


@pytest.mark.parametrize("target", ["2", "many"])
def test_a_bad_target_ends_before_any_work(call, tmp_path, monkeypatch, target):
    monkeypatch.setattr(forecast.SweepRun, "finish", None)
    code, _, errors = call("plan", "--target", target, "-o", tmp_path / "p")
    assert code == 2
    assert "target" in errors
    assert not (tmp_path / "p").exists()

"""Expected cost of a sweep, and photons that a target needs: crossings lie in the interval."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi.base.numeric.intervals import Crossing, find_crossing
from deepfsi.base.progress import Progress
from deepfsi.sweeps import batch, forecast
from deepfsi.sweeps.forecast import check_plan, forecast_cost, photons_needed
from deepfsi.sweeps.recipe import Recipe
from deepfsi.training import learning
from shared.trials import planned, small, train_trials


def test_a_forecast_counts_what_is_left(digits, tmp_path):
    recipe = small(trials=2)
    before = forecast_cost(recipe, digits, tmp_path)
    first = planned(digits)
    train_trials(first, digits, tmp_path)
    after = forecast_cost(recipe, digits, tmp_path)
    assert (before.trials, before.done, after.done) == (16, 0, len(first))
    assert before.operations == pytest.approx(2 * after.operations)
    assert 0 < after.seconds < math.inf
    train_trials(planned(digits, trials=2), digits, tmp_path)
    assert forecast_cost(recipe, digits, tmp_path).seconds == 0


@pytest.mark.parametrize(("others", "slower"), [(0.0, 1.0), (2.0, 2 / 1.5)])
def test_a_forecast_says_the_load_it_assumes(digits, tmp_path, monkeypatch, others, slower):
    """What one process was timed with takes two of them longer, where others want the cores."""
    monkeypatch.setattr(forecast._Load, "of_others", lambda _: others)
    monkeypatch.setattr(forecast, "cores", lambda: 2)
    seen = []
    report = Progress(lambda share, what: seen.append((share, what)))
    found = forecast_cost(small(trials=2), digits, tmp_path, workers=2, report=report)
    assert (found.others, found.cores) == (others, 2)
    slowdown = forecast.slowdown
    assert (slowdown(0.0, 2, 2), slowdown(2.0, 2, 2)) == (1, 2)  # alone, and beside two others
    assert (slowdown(2.0, 1, 2), slowdown(3.0, 1, 16)) == (1.5, 1)
    assert found.seconds / found.seconds_free == pytest.approx(slowdown(others, 2, 2))
    timed = found.seconds_free * slowdown(others, 1, 2)
    assert found.seconds / timed == pytest.approx(slower)
    assert [share for share, _ in seen] == sorted(share for share, _ in seen)


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

    monkeypatch.setattr("deepfsi.evaluation.accuracy.evaluate", evaluate)
    trials = planned(
        digits, designs="pca", masks=3, photons=1e3, validation=200, test_photons=(1e2, 1e3, 1e4),
        test_noise=("ml_gauss", "poisson"), test_levels=(0, 8),
    )  # fmt: skip
    sweep = batch.BatchTrainer(digits, 200, "cpu")
    step, tests = forecast._probe(trials, sweep)
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


def found_on(curve: MadeUp, trials: int, rounds: int) -> Crossing:
    """As `photons_needed` finds it."""
    budgets, tried = list(DECADES), [curve.tested(each, curve.held_out) for each in DECADES]
    for _ in range(rounds):
        more = forecast.next_budget(budgets, tried, TARGET)
        if more is None:
            break
        budgets = sorted([*budgets, more])
        tried.insert(budgets.index(more), curve.tested(more, curve.held_out))
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
        found = found_on(curve, 3, rounds)
        low, high = found.low or 0.0, found.high or np.inf
        inside += low <= curve.crossing <= high
        decades.append(np.log10(high) - np.log10(low or 1e-9))
    assert inside / REPEATS >= 0.95 - 5 * np.sqrt(0.95 * 0.05 / REPEATS)
    if rounds and images == 10_000:
        assert np.median(decades) < 0.3  # within a factor of 1.4 either way


def test_a_budget_that_is_tried_at_the_crossing_is_it():
    found = find_crossing([1e2, 1e3, 1e4], [[0.2], [0.9], [0.95]], 10**12, 0.9)
    assert found.photons == pytest.approx(1e3)
    assert (found.low, found.high) == pytest.approx((1e3, 1e3), rel=0.02)


def test_more_seeds_that_differ_more_widen_the_interval():
    means = (0.2, 0.6, 0.85, 0.95, 0.97)
    calm, wild = (
        find_crossing(DECADES, [[p - off, p + off] for p in means], 10**6, 0.9)
        for off in (0.001, 0.02)
    )
    assert calm.photons == pytest.approx(wild.photons)
    assert wild.low < calm.low < calm.high < wild.high


@pytest.mark.parametrize(
    ("accuracies", "found", "low", "high"),
    [
        ((0.5, 0.6, 0.7), "beyond", (1e4, 1e4), None),
        ((0.5, 0.6, 0.899), "beyond", (1e3, 0.999e4), None),
        ((0.95, 0.96, 0.97), "below", None, (1e2, 1e2)),
        ((0.901, 0.96, 0.97), "below", None, (1.001e2, 1e3)),
    ],
    ids=["surely beyond", "perhaps beyond", "surely below", "perhaps below"],
)
def test_targets_beyond_what_was_tried(accuracies, found, low, high):
    """An interval's end that is not known is None, and what is known of it lies within bounds."""
    crossing = find_crossing([1e2, 1e3, 1e4], [[accuracy] for accuracy in accuracies], 300, 0.9)
    assert (crossing.photons, crossing.found) == (None, found)
    for end, bounds in ((crossing.low, low), (crossing.high, high)):
        assert end is None if bounds is None else bounds[0] <= end <= bounds[1]


def test_accuracies_out_of_order_are_brought_to_order():
    found = find_crossing(DECADES, [[0.2], [0.9], [0.86], [0.95], [0.97]], 1000, 0.9)
    assert found.found == "within"
    assert 1e4 < found.photons < 1e5
    assert 1e2 < found.low < 1e3


@pytest.mark.parametrize(
    ("last", "accuracies", "low", "high"),
    [
        (1e4, (0.2, 0.5, 0.7), None, None),
        (1e4, (0.91, 0.95, 0.97), None, None),
        (1e4, (0.2, 0.899, 0.95), 1570, 1600),
        (1e4, (0.2, 0.5, 0.901), 6250, 6370),
        (1e4, (0.2, 0.8, 0.95), 2e3, 6e3),
        (2e3, (0.2, 0.8, 0.95), None, None),
    ],
)
def test_budgets_are_added_at_the_crossing_and_apart_from_those_tried(last, accuracies, low, high):
    more = forecast.next_budget([1e2, 1e3, last], accuracies, 0.9)
    assert more is low is None or low < more < high


QUICK = Recipe(
    designs=("pca", "raster"),
    photons=(1e3, 1e4, 1e6),
    masks=(2, 8),
    camera="paper",
    trials=2,
    training={"epochs": 6, "lr": 4e-2, "batch": 100},
)


@pytest.fixture(scope="module")
def answer(digits, tmp_path_factory):
    folder = tmp_path_factory.mktemp("plan")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learning, "characterise", lambda *_: None)  # a plan reads accuracies alone
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
        tried = [point["validation"] for point in first]
        assert forecast.next_budget(QUICK.photons, tried, 0.8) in budgets
    assert needs["pca"]["photons"] < needs["raster"]["photons"]
    assert needs["pca"]["masks"] == 8
    assert needs["raster"]["masks"] == digits.pixels
    json.dumps((plan, results.as_dict()))


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


@pytest.mark.usefixtures("uncharacterised")
def test_a_plan_has_a_curve_for_each_number_of_detectors(done, tmp_path):
    """Tiles need fewer photons, by masks of which each is read by all; the table says them."""
    line = "plan --target 0.75 --designs pca,impulse --detectors 1x1,2x2 --light free-dwell"
    line += " --rails single --photons 1e3,1e4,1e6 --ratios 0.2 --trials 1 --epochs 10"
    words = [*line.split(), "--workers", "1", "-o", tmp_path]
    printed = done(*words)
    rows = [line.split() for line in printed.splitlines() if line.startswith((" PCA", " impulse"))]
    assert sorted(row[-1] for row in rows) == ["1x1", "2x2", "pixel"]
    needs = {(n["design"], n["detectors"]): n for n in json.loads(done(*words, "--json"))["needs"]}
    one, four = needs["pca", "1x1"], needs["pca", "2x2"]
    assert (one["masks"], four["masks"]) == (13, 3)
    assert four["found"] == "within"
    assert one["found"] == "beyond" or four["photons"] < one["photons"]

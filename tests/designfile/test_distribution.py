"""Counts are tested for what a design was trained for: sound ones pass as often as stated."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from conftest import quick
from deepfsi import Design
from deepfsi.base import InputError
from deepfsi.datasets import Dataset, from_arrays
from deepfsi.designfile import REFUSED, UNSURE, FrameLight
from deepfsi.evaluation import distribution_fit, find_distribution
from shared.design_files import refused, rewrite

READOUTS = (2, 9)
CLASSES = 5


def scenes_of(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Shares of the budget of readouts (n, 2, m) of random scenes, heavy-tailed, with classes."""
    fixed, rng = np.random.default_rng(1), np.random.default_rng(seed)
    means = fixed.gamma(8.0, size=(CLASSES, *READOUTS)) / 8
    axes = 0.15 * fixed.normal(size=(4, *READOUTS))
    labels = rng.integers(CLASSES, size=count)
    along = rng.standard_t(5, size=(count, 4))
    rates = means[labels] * np.exp(np.tensordot(along, axes, axes=1).clip(-1, 1))
    rates *= np.exp(0.1 * rng.normal(size=(count, 1, 1)))
    rates[:, 1, 3] = 0  # a rail that is dark
    return 0.02 * rates, labels


@pytest.fixture(scope="module")
def known():
    rates, labels = scenes_of(distribution_fit.MOST_SCENES, seed=2)
    return find_distribution(torch.from_numpy(rates), labels, CLASSES)


@pytest.mark.parametrize(
    ("photons", "dark"), [((1e3, 1e5, 1e3), (0, 0, 0)), ((1e3, 1e3, 1e3), (0, 40, 0))]
)
def test_exposures_of_other_light_or_background_are_compared_each_with_its_own(
    known, photons, dark
):
    rng = np.random.default_rng(5)
    photons, dark = np.array(photons), np.array(dark)
    background = dark[:, None, None] * np.ones(READOUTS)
    rates, _ = scenes_of(len(photons), seed=6)
    counts = rng.poisson(rates * photons[:, None, None] + background) - background
    counts[:, 1, 3] = 0
    each = zip(counts, photons, background, strict=True)
    alone = [known.test(*(part[None] for part in one)).exposures[0] for one in each]
    assert known.test(counts, photons, background).exposures == pytest.approx(alone, rel=1e-9)


@pytest.mark.parametrize("dark", [0.0, 0.3, 3.0])
@pytest.mark.parametrize("photons", [30.0, 1e3, 2e4, 5e5, 1e9])
def test_sound_exposures_are_unsure_as_often_as_stated(known, photons, dark):
    """Within five sigma of this sample and of the one that calibrates."""
    rng = np.random.default_rng(3)
    rates, _ = scenes_of(8000, seed=4)
    background = dark * 0.01 * photons * rng.random(READOUTS)
    counts = rng.poisson(rates * photons + background) - background
    counts[:, 1, 3] = 0
    found = known.test(counts, np.full(len(counts), photons), background)
    error = 5 * np.sqrt(UNSURE * (1 / len(counts) + 1 / distribution_fit.MOST_SCENES))
    # counts of one or two take few values, so that fewer may be unsure
    least = UNSURE - error if photons > 100 else 0.0
    assert least <= found.unsure.mean() <= UNSURE + error


FRAMES = {
    "one after another": np.arange(18).reshape(READOUTS),
    "two arms": np.tile(np.arange(9), (2, 1)),
    "three detectors": np.tile(np.arange(6), 3).reshape(READOUTS) // 2,
}


@pytest.mark.parametrize("frames", FRAMES)
def test_sound_exposures_of_fluctuating_light_are_unsure_as_often_as_stated(frames):
    """All together they are refused by a distribution that takes the light for steady."""
    light = FrameLight(0.1, FRAMES[frames])
    rates, labels = scenes_of(distribution_fit.MOST_SCENES, seed=2)
    aware, unaware = (
        find_distribution(torch.from_numpy(rates), labels, CLASSES, light=each)
        for each in (light, None)
    )
    rng = np.random.default_rng(3)
    rates, _ = scenes_of(8000, seed=4)
    error = 5 * np.sqrt(UNSURE * (1 / len(rates) + 1 / distribution_fit.MOST_SCENES))
    for photons in (30.0, 1e3, 2e4, 1e9):
        sigma = np.sqrt(np.log1p(0.1**2))
        level = rng.lognormal(-(sigma**2) / 2, sigma, (len(rates), 18))[:, light.frame]
        counts = rng.poisson(rates * photons * level)
        budgets = np.full(len(rates), photons)
        unsure = aware.test(counts, budgets, 0.0).unsure.mean()
        assert (UNSURE - error if photons > 100 else 0.0) <= unsure <= UNSURE + error
    assert not aware.test(counts, budgets, 0.0).refused
    assert unaware.test(counts, budgets, 0.0).refused
    wrong = counts[:20, :, ::-1], budgets[:20], 0.0
    assert aware.test(*wrong).refused


def test_scenes_that_are_alike_are_told_under_fluctuating_light():
    light = FrameLight(0.03, FRAMES["one after another"])
    rates, labels = scenes_of(distribution_fit.MOST_SCENES, seed=2)
    known = find_distribution(torch.from_numpy(rates), labels, CLASSES, light=light)
    rng = np.random.default_rng(8)
    sigma = np.sqrt(np.log1p(0.03**2))
    level = rng.lognormal(-(sigma**2) / 2, sigma, (40, *READOUTS))
    one = rng.poisson(np.repeat(rates[:1], 40, axis=0) * 1e6 * level)
    others = rng.poisson(rates[:40] * 1e6 * level)
    assert known.test(one, np.full(40, 1e6), 0.0).alike < REFUSED
    assert known.test(others, np.full(40, 1e6), 0.0).alike == 1


@pytest.mark.parametrize("mixture", ["as trained", "one class", "two classes"])
def test_sound_acquisitions_are_refused_as_seldom_as_stated(known, mixture):
    """Of any size, budgets scene by scene, background and classes."""
    rng = np.random.default_rng(5)
    rates, labels = scenes_of(20_000, seed=6)
    trials, alarms, alike = 300, 0, 0
    for _ in range(trials):
        some = {"as trained": CLASSES, "one class": 1, "two classes": 2}[mixture]
        there = np.flatnonzero(np.isin(labels, rng.choice(CLASSES, some, replace=False)))
        chosen = rates[rng.choice(there, rng.choice([1, 2, 5, 20, 60]), replace=False)]
        photons = 10 ** rng.uniform(2, 7) * rng.uniform(0.7, 1.4, size=len(chosen))
        background = np.full(READOUTS, photons.mean() * 10 ** rng.uniform(-5, -2))
        background[1, 3] = 0
        counts = rng.poisson(chosen * photons[:, None, None] + background) - background
        found = known.test(counts, photons, background)
        alarms += found.refused
        alike += found.alike < REFUSED
    most = trials * REFUSED + 5 * np.sqrt(trials * REFUSED)
    assert alarms <= most
    assert alike <= most


WIDTH = 24


def shapes(kind: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """Pictures (count, pixels) of a disc, a frame or a cross, at any place, as bright as may be."""
    y, x = np.mgrid[:WIDTH, :WIDTH]
    shown = []
    for across, down in rng.normal(WIDTH / 2, 2, size=(count, 2)):
        off, up = abs(x - across), abs(y - down)
        far = np.maximum(off, up)
        lit = [off**2 + up**2 < 36, (far >= 3) & (far < 6), np.minimum(off, up) < 2][kind]
        shown.append(200 + lit * rng.uniform(2000, 3600) + rng.normal(0, 40, size=lit.shape))
    return np.array(shown).reshape(count, -1) / 4095


def shape_rates(kinds: list[int], counts: list[int], rng: np.random.Generator) -> np.ndarray:
    """Shares of the budget (n, 2, 8) of shapes, by random masks and their complements."""
    masks = np.random.default_rng(14).random((8, WIDTH**2))
    x = np.concatenate([shapes(k, n, rng) for k, n in zip(kinds, counts, strict=True)])
    return np.stack([x @ masks.T, x @ (1 - masks).T], axis=1) / masks.size


@pytest.mark.parametrize("sizes", [[200, 15, 12], [200, 50, 50], [200, 80, 60]])
def test_unbalanced_classes_refuse_no_more_sound_acquisitions(sizes):
    """New scenes of any classes; classes that are too few to tell are not tested."""
    trials = alarms = 0
    for seed in range(6):
        rng = np.random.default_rng([15, seed])
        rates, labels = shape_rates([0, 1, 2], sizes, rng), np.repeat(range(3), sizes)
        found = find_distribution(torch.from_numpy(rates), labels, 3)
        assert find_distribution(torch.from_numpy(rates), labels, 4) is None  # one has no scenes
        assert (found is None) == (min(sizes) < distribution_fit.FEWEST_OF_A_CLASS)
        for kinds in ([0], [1], [2], [0, 1, 2]) if found else ():
            fresh = shape_rates(kinds, [36 // len(kinds)] * len(kinds), rng)
            for photons in (1e4, 1e6):
                alarms += found.test(rng.poisson(fresh * photons), [photons] * 36, 0.0).refused
                trials += 1
    assert alarms <= trials * REFUSED + 5 * np.sqrt(trials * REFUSED)


def split(digits: Dataset) -> Dataset:
    """Digits in another order, 800 of them to test with: the test part has other writers."""
    x = np.concatenate([digits.x_train, digits.x_test])
    y = np.concatenate([digits.y_train, digits.y_test])
    order = np.random.default_rng(0).permutation(len(x))
    x, y, n = x[order], y[order], len(x) - 800
    return replace(digits, x_train=x[:n], y_train=y[:n], x_test=x[n:], y_test=y[n:])


@pytest.fixture(scope="module")
def data(digits) -> Dataset:
    return split(digits)


@pytest.fixture(scope="module")
def design(data) -> Design:
    return quick(data, masks=16, light="equal-dwell")


def rates_of(design: Design, x: np.ndarray) -> np.ndarray:
    with torch.no_grad():
        return design.rates(design.scanner(), torch.from_numpy(x).float()).double().numpy()


def whole(design: Design, rates: np.ndarray, photons: float) -> list[bool]:
    """Verdicts of acquisitions of 40 scenes."""
    counts = np.random.default_rng(7).poisson(rates * photons)
    parts = np.split(counts, len(counts) // 40)
    return [design.consistency(part, photons).refused for part in parts]


@pytest.mark.parametrize(
    ("fault", "photons"),
    [
        ("another design", 1e4),
        ("half the light", 1e3),
        ("twice the light", 1e2),
        ("a frame late", 1e4),
        ("two frames swapped", 3e5),
        ("inverted scenes", 1e5),
        ("rails swapped", 1e4),
    ],
)
def test_what_is_not_trained_for_is_refused(design, data, fault, photons):
    rates = rates_of(design, data.x_test)
    flat = rates.reshape(len(rates), -1)
    if fault == "another design":
        rates = rates_of(quick(data, "random", masks=16, light="equal-dwell"), data.x_test)
    elif fault == "inverted scenes":
        rates = rates_of(design, 1 - data.x_test)
    elif fault == "a frame late":
        rates = np.roll(flat, 1, axis=1).reshape(rates.shape)
    elif fault == "two frames swapped":
        order = np.arange(flat.shape[1])
        order[[3, 20]] = order[[20, 3]]
        rates = flat[:, order].reshape(rates.shape)
    elif fault == "rails swapped":
        rates = rates[:, ::-1]
    else:
        rates = rates * {"half the light": 0.5, "twice the light": 2.0}[fault]
    assert all(whole(design, rates, photons))


def test_a_scene_with_stray_light_in_some_frames_is_unsure(design, data):
    """All-ON and all-OFF frames do not see light that comes and goes with other frames."""
    rates = rates_of(design, data.x_test)[:40]
    rates[7, :, :4] += rates.mean()
    found = design.consistency(np.random.default_rng(13).poisson(rates * 1e4), 1e4)
    assert found.unsure[7]
    assert found.unsure.sum() <= 1 + 4  # of 39 sound ones, more by chance once in 15 000
    assert not found.refused


@pytest.mark.parametrize(
    "change",
    [
        lambda held: held.pop("distribution.tails"),
        lambda held: held.update({"distribution.mean": torch.zeros(2, 16)}),
        lambda held: held.update({"distribution.mean": torch.ones(2, 15)}),
        lambda held: held.update({"distribution.rest": -torch.ones(2, 16)}),
        lambda held: held.update({"distribution.pairs": held["distribution.pairs"].flip(-1)}),
        lambda held: held.update({"distribution.more": torch.ones(1)}),
        lambda held: held.pop("distribution.directions"),
    ],
)
def test_a_damaged_distribution_is_refused(design, tmp_path, change):
    path = design.save(tmp_path / "design.safetensors")
    rewrite(path, lambda header, held: change(held))
    refused(path)


def test_what_has_no_distribution_says_so(data, design):
    few = from_arrays(data.x_train[:60].reshape(-1, 8, 8), data.y_train[:60] % 2)
    small = quick(few, masks=4, batch=32)
    looks = quick(data, masks=4, light="free-dwell", rails="single", looks=2)
    for each in (small, design.quantised(3)):
        assert each.distribution is None
        with pytest.raises(InputError, match="no distribution"):
            each.consistency(np.ones((1, *each.rails.stacked.shape[:2])), 1e3)
    with pytest.raises(InputError, match="live run"):  # which has the all-ON frames, too
        looks.consistency(np.ones((1, 4)), 1e3)


@pytest.mark.parametrize(
    ("counts", "photons", "said"),
    [
        (np.ones((3, 2, 15)), 1e3, "do not fit"),
        (np.ones((0, 2, 16)), 1e3, "no exposures"),
        (np.full((1, 2, 16), np.nan), 1e3, "finite"),
        (np.ones((1, 2, 16)), 0.0, "photons"),
    ],
)
def test_bad_counts_are_named(design, counts, photons, said):
    with pytest.raises(InputError, match=said):
        design.consistency(counts, photons)


def test_two_tests_of_an_acquisition_share_its_chance():
    """Of one exposure of a single class both are the same test: its own chance counts twice."""
    rng = np.random.default_rng(8)
    rates, labels = scenes_of(2000, seed=2)
    known = find_distribution(torch.from_numpy(rates), 0 * labels, 1)
    rates, _ = scenes_of(40, seed=9)
    for counts in rng.poisson(rates * 1e4):
        found = known.test(counts[None], np.array([1e4]), 0.0)
        assert found.whole == pytest.approx(min(1.0, 2 * found.exposures[0]), rel=1e-6)

"""Rail sums: Poisson counts pass, and an excess that was put in is measured and placed."""

import numpy as np
import pytest
from scipy.stats import binom

from deepfsi.base.errors import InputError
from deepfsi.hardware.light.curves import FALSE_ALARMS
from deepfsi.hardware.pictures import rail_sums
from deepfsi.jobs.designs import formula_masks

SHAPE = (16, 16)
FINE = rail_sums.fineness(formula_masks("hadamard-natural", SHAPE), SHAPE)[1:]
PAIRS = len(FINE)
TRIALS = 120


def counts(light: np.ndarray, mean: float, rng: np.random.Generator) -> np.ndarray:
    """Poisson counts (runs, 2, m) of pairs that share the light (runs, m) unevenly."""
    share = rng.uniform(0.4, 0.6, light.shape[-1])
    return rng.poisson(mean * light[:, None] * np.stack([share, 1 - share])).astype(float)


def lognormal(spread: float, size: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    sigma = np.sqrt(np.log1p(spread**2))
    return np.exp(sigma * rng.standard_normal(size) - sigma**2 / 2)


def assert_mean(measured, truth) -> None:
    """Means of measured values (n, ...) are the truth (...), to four standard errors."""
    found = np.array(measured)
    error = found.std(axis=0, ddof=1) / np.sqrt(len(found))
    assert (abs(found.mean(axis=0) - truth) < 4 * error).all()


@pytest.mark.parametrize(("runs", "mean"), [(1, 600.0), (3, 40.0)])
def test_poisson_counts_are_called_poisson(runs, mean):
    rng = np.random.default_rng(1)
    wide = np.ones((runs, PAIRS)) * np.arange(1, runs + 1)[:, None]
    found = [rail_sums.check_rail_sums(counts(wide, mean, rng), FINE) for _ in range(TRIALS)]
    alarms = sum(not one.poisson for one in found)
    assert alarms <= binom.ppf(0.999, TRIALS, FALSE_ALARMS)
    # intervals of the excess hold 0 in 95 %, the runs' in common too
    intervals = [one.runs[0].excess if runs == 1 else one.common for one in found]
    covered = sum(each.low <= 0 <= each.high for each in intervals)
    assert covered >= binom.ppf(1e-4, TRIALS, 0.95)
    assert not any(one.causes for one in found if one.poisson)


def test_an_excess_that_was_put_in_is_measured():
    rng, spread = np.random.default_rng(2), 0.06
    found = [
        rail_sums.check_rail_sums(counts(lognormal(spread, (1, PAIRS), rng), 600, rng), FINE)
        for _ in range(16)
    ]
    assert not any(one.poisson for one in found)
    excess = [one.runs[0].excess for one in found]
    assert_mean([one.variance for one in excess], spread**2)
    held = [one.low <= spread**2 <= one.high for one in excess]
    assert sum(held) >= binom.ppf(1e-3, len(held), 0.93)  # a skew statistic: 93 % are enough


def test_what_runs_share_is_told_from_what_each_has_of_its_own():
    rng, own = np.random.default_rng(3), np.array([0.05, 0.02, 0.0])
    measured = []
    for _ in range(20):
        shared = lognormal(0.1, (PAIRS,), rng)
        light = shared * np.stack([lognormal(one, (PAIRS,), rng) for one in own])
        found = rail_sums.check_rail_sums(counts(light, 2000, rng), FINE)
        measured.append([one.variance for one in (found.common, *found.own)])
    assert_mean(measured, [0.1**2, *own**2])


@pytest.mark.parametrize("own", [(0.1, 0.05, 0.0), (0.08, 0.04)])
def test_law_the_excess_of_single_pictures_is_that_of_the_virtual_camera(own):
    rng, spread = np.random.default_rng(10), np.array(own)
    share, times = rng.uniform(0.4, 0.6, PAIRS), np.array([300, 600, 1200])[: len(own)]
    pictures, sums = [], []
    for _ in range(20):
        light = np.stack([lognormal(one, (2, PAIRS), rng) for one in own])
        mean = times[:, None, None] * np.stack([share, 1 - share]) * light
        found = rail_sums.check_rail_sums(rng.poisson(mean).astype(float), FINE)
        pictures.append([one.variance for one in found.pictures])
        sums.append([one.variance for one in found.own])
    truth = spread**2 if len(own) > 2 else np.full(2, (spread**2).mean())
    assert_mean(pictures, truth)
    # light of two pictures: sums of a pair have half of it, and a little more as shares are uneven
    assert_mean(sums, truth * (share**2 + (1 - share) ** 2).mean())


@pytest.mark.parametrize("cause", ["fineness", "block", "place in block", "sequence"])
def test_the_place_of_an_excess_in_the_sequence_is_named(cause):
    rng, block = np.random.default_rng(5), 64
    order = rng.permutation(PAIRS)  # of the masks, so that fineness and time differ
    fine, place = FINE[order], np.arange(PAIRS)
    effect = {
        "fineness": np.exp(-fine.sum(axis=1) / 4),
        "block": rng.standard_normal(8)[place // (block // 2)],
        "place in block": rng.standard_normal(block // 2)[place % (block // 2)],
        "sequence": np.sin(place / 3),
    }[cause]
    effect = 1 + 0.1 * (effect - effect.mean()) / effect.std()
    rails = counts(effect[None], 4000, rng)
    found = rail_sums.check_rail_sums(rails, fine, block=block)
    shares = {name: one.share for name, one in found.causes.items()}
    assert max(shares, key=shares.get) == cause
    assert shares[cause] > 0.5
    assert found.causes[cause].chance == 0.001
    others = [one.chance for name, one in found.causes.items() if name == "fineness" != cause]
    assert all(chance > 0.001 for chance in others)


@pytest.mark.parametrize(
    ("shape", "layout", "masks", "said"),
    [
        ((5, 3), None, 5, "5 rows and 3 columns"),
        ((128, 1), None, 64, "say `rails` turns or halves"),
        ((128, 1), None, None, "say `rails`"),
        ((127, 1), "turns", None, "an even number"),
        ((64, 2), "turns", 64, "give a column of masks"),
        ((64, 2), "columns", 32, "64 masks, and 32 are needed"),
        ((64, 2), "rows", 64, "rows"),
    ],
)
def test_a_table_that_is_none_of_these_masks_is_refused(shape, layout, masks, said):
    with pytest.raises(InputError, match=said):
        rail_sums.split_rails(np.ones(shape), layout, masks, "t.npy")


@pytest.mark.parametrize("layout", [None, *rail_sums.LAYOUTS])
def test_a_table_of_rails_is_read_in_every_layout(layout):
    rails = np.random.default_rng(9).poisson(100, (1 if layout == "single" else 2, 64))
    tables = {
        None: rails.T,
        "columns": rails,
        "turns": rails.T.reshape(-1, 1),
        "halves": rails.reshape(1, -1),
        "single": rails,
    }
    found = rail_sums.split_rails(tables[layout], layout, 64, "t.npy")
    assert np.array_equal(found, rails)
    assert np.array_equal(rail_sums.split_rails(tables[layout].T, layout, None, "t.npy"), rails)

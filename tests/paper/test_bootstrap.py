"""The paper's rule gives the paper's figures, and intervals cover what they are said to cover."""

import numpy as np
import pytest

from deepfsi_paper import bootstrap

UNTIED = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]
"""Sizes of differences, in tenths, so that each is its own rank."""


def differences(sizes: list[float], losses: tuple[int, ...]) -> np.ndarray:
    """Differences in tenths, negative where the place (1, 2, …) is among `losses`."""
    signs = [-1 if place in losses else 1 for place in range(1, len(sizes) + 1)]
    return np.array(sizes) * signs / 10


SIX_TIED = [0, 1, 1, 2, 10, 10, 10, 10, 10, 10]
"""One class alike, and six where one side is always right and the other never."""

PAPER = {  # statistic, p, rank-biserial; sizes of the differences, and which of them are losses
    "0.1 FSI": (1.0, 0.017, 0.944, [0, 0, *UNTIED[:8]], (3,)),
    "0.1 TH": (0.0, 0.012, 1.0, [0, 0, *UNTIED[:8]], ()),
    "0.1 RS": (1.5, 0.010, 0.933, SIX_TIED, (2,)),
    "0.1 HB": (0.0, 0.002, 1.0, UNTIED, ()),
    "0.01 FSI": (0.0, 0.002, 1.0, UNTIED, ()),
    "0.01 TH": (0.0, 0.012, 1.0, [0, 0, *UNTIED[:8]], ()),
    "0.01 RS": (1.0, 0.004, 0.964, UNTIED, (1,)),
    "0.01 HB": (0.0, 0.002, 1.0, UNTIED, ()),
    "0.001 FSI": (3.0, 0.010, 0.891, UNTIED, (3,)),
    "0.001 TH": (5.5, 0.027, 0.800, [1, 2, 3, 4, 5, 5, 7, 8, 9, 10], (6,)),
    "0.001 RS": (0.0, 0.008, 1.0, [0, *UNTIED[:9]], ()),
    "0.001 HB": (2.5, 0.010, 0.909, [1, 2, 2, 4, 5, 6, 7, 8, 9, 10], (3,)),
    "0.0001 FSI": (2.0, 0.006, 0.927, UNTIED, (2,)),
    "0.0001 TH": (24.0, 0.770, 0.127, UNTIED, (10, 9, 5)),
    "0.0001 RS": (0.0, 0.002, 1.0, UNTIED, ()),
    "0.0001 HB": (9.0, 0.064, 0.673, UNTIED, (9,)),
}


@pytest.mark.parametrize("cell", PAPER)
@pytest.mark.parametrize("side", [1, -1])
def test_every_cell_of_the_papers_table_follows_the_rule(cell, side):
    statistic, pvalue, rank_biserial, sizes, losses = PAPER[cell]
    found = bootstrap.wilcoxon_signed_rank(side * differences(sizes, losses), np.zeros(10))
    assert found.statistic == statistic
    assert round(found.pvalue, 3) == pvalue
    assert round(found.rank_biserial, 3) == rank_biserial


def test_the_papers_intervals_follow_from_rates_that_have_its_mean():
    """DeepFSI in the brightest light: seven digits always right, three in nine of ten."""
    rates = [1.0] * 7 + [0.9] * 3
    low, high = bootstrap.cluster_bootstrap(rates, 0)
    assert (round(low, 3), round(high, 3)) == (0.940, 1.000)
    low, high = bootstrap.studentised_bootstrap(rates, 0)
    assert (low, high) == (pytest.approx(0.939, abs=2e-3), pytest.approx(0.998, abs=2e-3))


def test_the_studentised_interval_covers_what_it_says(monkeypatch):
    """Of 800 trials with ten normal rates, to five sigma."""
    monkeypatch.setattr(bootstrap, "RESAMPLES", 2000)  # a quantile's own error: 0.003 of the draws
    rng, trials, share = np.random.default_rng(3), 800, bootstrap.CONFIDENCE
    found = [
        bootstrap.studentised_bootstrap(rng.normal(0.6, 0.1, 10), trial) for trial in range(trials)
    ]
    covered = np.mean([low <= 0.6 <= high for low, high in found])
    assert covered == pytest.approx(share, abs=5 * (share * (1 - share) / trials) ** 0.5)

"""The fit of published rates: the law of their covariance, and settings that it finds again."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy import special

from deepfsi_paper.camera import rate_fit

CLASSES, CONDITIONS = 10, 6
PARAMETERS = [
    rate_fit.Parameter("gain", "gain", 1.0, 100.0),
    rate_fit.Parameter("level", "level", 0.0, 1.0, log=False),
]
SPREAD = 0.8
"""Standard deviation of the logits of pictures of one class."""


def logits(shares):
    """Logits (T, C) of conditions at settings (T, 2)."""
    slope = np.linspace(-2, 2, CONDITIONS)
    return slope * (shares[:, :1] * 2 - 1) + 2 * np.cos(3 * slope) * (shares[:, 1:] - 0.5)


def right_answers(rng, shares, pictures, exposures):
    """Right answers (T, C, J, K); a picture that is hard in one condition is so in all."""
    hard = SPREAD * rng.standard_normal((pictures, CLASSES))
    easy = np.linspace(-1, 1, CLASSES)
    chance = special.expit(logits(shares)[:, :, None, None] + hard + easy)
    return rng.binomial(exposures, chance)


@pytest.fixture(scope="module")
def emulated():
    rng = np.random.default_rng(0)
    shares = rng.random((80, 2))
    return shares, rate_fit.moments(right_answers(rng, shares, 20, 4), 4)


def test_the_covariance_is_that_of_many_experiments_of_ten_pictures():
    """Each experiment draws one picture of each class, and ten exposures of it."""
    rng = np.random.default_rng(1)
    at = np.array([[0.7, 0.4]])
    exposures, experiments = 10, 20_000
    right = right_answers(rng, at, experiments, exposures)[0]  # (C, J, K)
    rates = right.mean(axis=-1) / exposures
    found = np.cov(rates)
    few = [rate_fit.moments(right_answers(rng, at, 10, 4), 4) for _ in range(300)]
    picture = np.mean([each.pictures[0] for each in few], axis=0)
    exposure = np.mean([each.exposure[0] for each in few], axis=0)
    expected = picture + np.diag(exposure) / exposures
    scale = np.sqrt(np.outer(found.diagonal(), found.diagonal()))
    # 300 tables of 90 degrees of freedom: covariances to 1 / √27000 of the scale, times 5
    assert np.abs(expected - found).max() < 0.03 * scale.max()
    assert (
        expected - np.diag(expected.diagonal())
    ).max() > 0.2 * scale.max()  # they share pictures


def table_at(rng, at, exposures=10):
    return right_answers(rng, np.array([at]), 1, exposures)[0].mean(axis=(1, 2)) / exposures


def fitted(emulated, table, parameters=PARAMETERS, tables=2):
    """The emulator of a table of ten exposures, and the fit of the parameters to it."""
    emulator = rate_fit.Emulator(*emulated, table, np.full(CONDITIONS, 10))
    conditions = [("a", float(k)) for k in range(CONDITIONS)]
    start = {"gain": 10.0, "level": 0.5}
    return emulator, rate_fit.fit_rates(emulator, parameters, conditions, start, tables=tables)


def test_a_setting_is_found_again_and_its_table_is_likely(emulated):
    rng = np.random.default_rng(2)
    at, inside = (0.35, 0.6), []
    for _ in range(12):
        _, fit = fitted(emulated, table_at(rng, at))
        for profile, parameter, true in zip(fit.profiles, PARAMETERS, at, strict=True):
            assert min(profile.deviance) == pytest.approx(0, abs=1e-3)
            assert profile.low <= profile.best <= profile.high
            inside.append(profile.low <= parameter.value(true) <= profile.high)
    assert sum(inside) >= 18  # of 24; fewer happens in 1 of 1000, if each holds with 0.95
    assert fit.freedom == CONDITIONS - 2


def test_a_table_that_no_setting_gives_is_unlikely(emulated):
    table = np.where(np.arange(CONDITIONS) % 2, 0.9, 0.1)
    _, fit = fitted(emulated, table, tables=40)
    assert fit.p < 0.05
    assert fit.deviance > 30
    assert max(abs(each.pull) for each in fit.conditions) > 3


def test_a_parameter_with_levels_has_no_other_values(emulated):
    stepped = replace(PARAMETERS[1], levels=(0.0, 0.25, 0.75, 1.0))
    table = table_at(np.random.default_rng(5), (0.35, 0.75))
    _, fit = fitted(emulated, table, [PARAMETERS[0], stepped])
    level = fit.profiles[1]
    assert level.values == [0.0, 0.25, 0.75, 1.0]
    assert level.best == 0.75
    assert {level.low, level.high} <= set(level.values)
    assert min(level.deviance) == pytest.approx(0, abs=0.02)
    assert json.loads(json.dumps(asdict(fit)))["p"] == fit.p  # as results keep it


def test_a_rate_is_expected_given_the_others(emulated):
    """By the normal law of one coordinate given all others."""
    table = np.linspace(0.2, 0.8, CONDITIONS)
    emulator, fit = fitted(emulated, table)
    at = np.array([[float(p.share(q.best)) for p, q in zip(PARAMETERS, fit.profiles, strict=True)]])
    mean, covariance = emulator.means(at)[0], emulator.covariance(at)[0]
    for place, each in enumerate(fit.conditions):
        rest = np.arange(CONDITIONS) != place
        gain = np.linalg.solve(covariance[np.ix_(rest, rest)], covariance[rest, place])
        assert each.expected == pytest.approx(mean[place] + gain @ (table - mean)[rest], abs=1e-3)
        variance = covariance[place, place] - gain @ covariance[rest, place]
        assert each.error == pytest.approx(np.sqrt(variance), rel=1e-3)
        assert each.pull == pytest.approx((each.published - each.expected) / each.error)

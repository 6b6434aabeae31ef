"""The fit of published rates: the law of their covariance, and settings that it finds again."""

import json
from dataclasses import asdict

import numpy as np
import pytest
from scipy import special

from deepfsi.base import InputError
from deepfsi_paper.camera.published import PUBLISHED, exposures_of
from deepfsi_paper.camera.rate_fit import (
    LIMIT,
    Emulator,
    Parameter,
    fit_rates,
    minimise,
    moments,
)
from deepfsi_paper.camera.rate_simulations import displayed

CLASSES, CONDITIONS = 10, 6
PARAMETERS = [
    Parameter("gain", "gain", 1.0, 100.0),
    Parameter("level", "level", 0.0, 1.0, log=False),
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
    return shares, moments(right_answers(rng, shares, 20, 4), 4)


def test_the_covariance_is_that_of_many_experiments_of_ten_pictures():
    """Each experiment draws one picture of each class, and ten exposures of it."""
    rng = np.random.default_rng(1)
    at = np.array([[0.7, 0.4]])
    exposures, experiments = 10, 20_000
    right = right_answers(rng, at, experiments, exposures)[0]  # (C, J, K)
    rates = right.mean(axis=-1) / exposures
    found = np.cov(rates)
    few = [moments(right_answers(rng, at, 10, 4), 4) for _ in range(300)]
    picture = np.mean([each.pictures[0] for each in few], axis=0)
    exposure = np.mean([each.exposure[0] for each in few], axis=0)
    expected = picture + np.diag(exposure) / exposures
    scale = np.sqrt(np.outer(found.diagonal(), found.diagonal()))
    # 300 tables of 90 degrees of freedom: covariances to 1 / √27000 of the scale, times 5
    assert np.abs(expected - found).max() < 0.03 * scale.max()
    assert (
        expected - np.diag(expected.diagonal())
    ).max() > 0.2 * scale.max()  # they share pictures


def test_classes_that_differ_make_the_rate_no_wider():
    """A design that answers one class always has a rate of 0.1 without any scatter."""
    right = np.zeros((1, 1, 5, CLASSES), dtype=int)
    right[..., 1] = 4
    made = moments(right, 4)
    assert made.means == pytest.approx(0.1)
    assert made.exposure == pytest.approx(0)
    assert made.pictures == pytest.approx(0)


def table_at(rng, at, exposures=10):
    return right_answers(rng, at, 1, exposures)[0].mean(axis=(1, 2)) / exposures


def test_a_setting_is_found_again_and_its_table_is_likely(emulated):
    rng = np.random.default_rng(2)
    at = np.array([[0.35, 0.6]])
    inside = []
    for _ in range(12):
        table = table_at(rng, at)
        emulator = Emulator(*emulated, table, np.full(CONDITIONS, 10))
        fit = fit_rates(
            emulator,
            PARAMETERS,
            [("a", float(k)) for k in range(CONDITIONS)],
            {"gain": 10.0, "level": 0.5},
            tables=2,
        )
        for profile, parameter, true in zip(fit.profiles, PARAMETERS, at[0], strict=True):
            assert min(profile.deviance) == pytest.approx(0, abs=1e-3)
            assert profile.low <= profile.best <= profile.high
            inside.append(profile.low <= parameter.value(true) <= profile.high)
    assert sum(inside) >= 18  # of 24; fewer happens in 1 of 1000, if each holds with 0.95
    assert fit.freedom == CONDITIONS - 2


def test_a_table_that_no_setting_gives_is_unlikely(emulated):
    table = np.where(np.arange(CONDITIONS) % 2, 0.9, 0.1)
    emulator = Emulator(*emulated, table, np.full(CONDITIONS, 10))
    conditions = [("a", float(k)) for k in range(CONDITIONS)]
    fit = fit_rates(emulator, PARAMETERS, conditions, {"gain": 10.0, "level": 0.5}, tables=40)
    assert fit.p < 0.05
    assert fit.deviance > 30
    assert max(abs(each.pull) for each in fit.conditions) > 3


def test_the_emulator_gives_the_rates_between_its_settings(emulated):
    emulator = Emulator(*emulated, np.full(CONDITIONS, 0.5), np.full(CONDITIONS, 10))
    between = np.random.default_rng(3).random((50, 2))
    rng = np.random.default_rng(0)
    rng.random((80, 2))
    hard = SPREAD * rng.standard_normal((20, CLASSES))  # the pictures of the simulated settings
    easy = np.linspace(-1, 1, CLASSES)
    true = special.expit(logits(between)[:, :, None, None] + hard + easy).mean(axis=(2, 3))
    assert np.abs(emulator.means(between) - true).max() < 0.06
    assert np.linalg.eigvalsh(emulator.covariance(between)).min() > 0


def test_the_least_of_several_valleys_is_found():
    def loss(at):
        return np.cos(12 * at[:, 0]) + np.square(at[:, 0] - 0.8) + np.square(at[:, 1] - 0.25)

    found = minimise(loss, np.random.default_rng(0).random((100, 2)))
    assert found == pytest.approx([0.7865, 0.25], abs=2e-3)
    fixed = np.random.default_rng(0).random((100, 2))
    fixed[:, 1] = 0.9
    assert minimise(loss, fixed, np.array([True, False]))[1] == 0.9


def test_parameters_keep_their_ranges():
    for parameter in PARAMETERS:
        assert parameter.value(0) == pytest.approx(parameter.low)
        assert parameter.value(1) == pytest.approx(parameter.high)
        assert parameter.share(parameter.value(0.3)) == pytest.approx(0.3)
    assert pytest.approx(3.8415, abs=1e-3) == LIMIT


def test_as_many_parameters_as_settings_have(emulated):
    emulator = Emulator(*emulated, np.full(CONDITIONS, 0.5), np.full(CONDITIONS, 10))
    with pytest.raises(InputError, match="3 parameters for settings of 2"):
        fit_rates(emulator, [*PARAMETERS, PARAMETERS[0]], [], {})


def test_the_monitor_keeps_its_flux_and_changes_its_black():
    """Of one pixel that is black and one that is white, seen through a mask on each of them."""
    reflectance = np.array([[0.3, 1.0], [1.0, 1.0]])  # a scene, and a white one
    frames = np.array([[1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])  # all ON, first, second
    rates = (reflectance @ frames.T * 1e7 / 1.3)[..., None]
    shown = displayed(rates, 2e6, 0.1)
    assert shown.shape == (1, 3, 1)
    np.testing.assert_allclose(shown[0, :, 0], 2e6 / 1.1 * np.array([1.1, 0.1, 1.0]))
    np.testing.assert_allclose(displayed(rates, 1e7, 0.3)[0], rates[0])


def test_published_rates_are_shares_of_their_exposures():
    for rates in PUBLISHED.values():
        for rate, *_ in rates.values():
            answers = rate * 10 * exposures_of(rate)
            assert answers == pytest.approx(round(answers), abs=0.06)


def test_a_parameter_with_levels_has_no_other_values(emulated):
    rng = np.random.default_rng(5)
    table = table_at(rng, np.array([[0.35, 0.75]]))
    emulator = Emulator(*emulated, table, np.full(CONDITIONS, 10))
    stepped = Parameter("level", "level", 0.0, 1.0, log=False, levels=(0.0, 0.25, 0.75, 1.0))
    conditions = [("a", float(k)) for k in range(CONDITIONS)]
    fit = fit_rates(
        emulator, [PARAMETERS[0], stepped], conditions, {"gain": 10.0, "level": 0.5}, tables=2
    )
    level = fit.profiles[1]
    assert level.values == [0.0, 0.25, 0.75, 1.0]
    assert level.best == 0.75
    assert {level.low, level.high} <= set(level.values)
    assert min(level.deviance) == pytest.approx(0, abs=0.02)
    assert json.loads(json.dumps(asdict(fit)))["p"] == fit.p  # as results keep it


def test_a_rate_is_expected_given_the_others(emulated):
    """By the normal law of one coordinate given all others."""
    table = np.linspace(0.2, 0.8, CONDITIONS)
    emulator = Emulator(*emulated, table, np.full(CONDITIONS, 10))
    conditions = [("a", float(k)) for k in range(CONDITIONS)]
    fit = fit_rates(emulator, PARAMETERS, conditions, {"gain": 10.0, "level": 0.5}, tables=2)
    at = np.array([[float(p.share(q.best)) for p, q in zip(PARAMETERS, fit.profiles, strict=True)]])
    mean, covariance = emulator.means(at)[0], emulator.covariance(at)[0]
    for place, each in enumerate(fit.conditions):
        rest = np.arange(CONDITIONS) != place
        gain = np.linalg.solve(covariance[np.ix_(rest, rest)], covariance[rest, place])
        assert each.expected == pytest.approx(mean[place] + gain @ (table - mean)[rest], abs=1e-3)
        variance = covariance[place, place] - gain @ covariance[rest, place]
        assert each.error == pytest.approx(np.sqrt(variance), rel=1e-3)
        assert each.pull == pytest.approx((each.published - each.expected) / each.error)

"""Adaptive masks of a detector that clicks: what a look tells, its price, and their ends."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

import deepfsi
from deepfsi import Design, InputError
from deepfsi.jobs.exposures import AdaptiveMasks
from deepfsi_clicks import clicking

CAMERA = {"light": "free-dwell", "rails": "single", "noise": "click"}
LOOKS, PHOTONS, CLICKS = 16, 600.0, 3.0
SCENES = 128
"""Training scenes by which prices are found, and test scenes that are read."""


@pytest.fixture(scope="module")
def data():
    digits = deepfsi.load_dataset("digits", rescale=(0.0, 1.0))
    return replace(digits, x_test=digits.x_test[:SCENES], y_test=digits.y_test[:SCENES])


@pytest.fixture(scope="module", autouse=True)
def few_scenes():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(clicking, "PRICING_SCENES", SCENES)
        yield


@pytest.fixture(scope="module")
def training(data):
    return clicking.ClickTraining(data, AdaptiveMasks(looks=LOOKS))


@pytest.fixture(scope="module")
def made(data):
    """Design for three clicks in the mean."""
    return deepfsi.learn(
        data, design="adaptive", masks=LOOKS, photons=PHOTONS, counts=CLICKS, camera=CAMERA
    )


@pytest.fixture(scope="module")
def tested(made, data):
    [result] = deepfsi.evaluate(made, data, PHOTONS, draws=1)
    return result


LIGHT_PRICE = CLICKS / PHOTONS
"""Of a design for these clicks, clicks a photon."""


def run(training, x, price, photons=PHOTONS, seed=0, light_price=LIGHT_PRICE):
    update = {"price": price, "light_price": light_price}
    settings = training.settings.model_copy(update=update)
    generator = torch.Generator().manual_seed(seed)
    looks = clicking.ClickLooks(training.prior, settings, photons)
    return looks.run(torch.from_numpy(x), generator)


def test_no_click_has_the_probability_of_gamma_distributed_light():
    draws = 200_000
    light, variance, gain = 3.0, 0.25, 0.4
    size = light**2 / variance
    drawn = np.random.default_rng(0).gamma(size, light / size, draws)
    dark = np.exp(-gain * drawn)
    tensors = (torch.tensor(number) for number in (light, variance, gain))
    expected = math.exp(float(clicking.log_no_click(*tensors)))
    assert expected == pytest.approx(dark.mean(), abs=5 * dark.std() / draws**0.5)
    assert expected > math.exp(-gain * light)  # Jensen: light that varies leaves more dark


def test_a_look_tells_the_mutual_information_of_its_outcome_and_the_class():
    rng = np.random.default_rng(1)
    chances = rng.random((1, 3, 5))
    classes = np.array([0, 0, 1, 2, 2])
    weights = rng.random(5)
    weights /= weights.sum()
    members = np.eye(3)[classes] * weights[:, None]
    told, clicks = clicking.click_information(
        torch.from_numpy(chances), torch.from_numpy(members)[None]
    )
    for look in range(3):
        joint = np.zeros((2, 3))
        for scene, label in enumerate(classes):
            joint[1, label] += weights[scene] * chances[0, look, scene]
            joint[0, label] += weights[scene] * (1 - chances[0, look, scene])
        apart = joint.sum(axis=1, keepdims=True) * joint.sum(axis=0)
        assert float(told[0, look]) == pytest.approx((joint * np.log(joint / apart)).sum())
        assert float(clicks[0, look]) == pytest.approx(joint[1].sum())


def test_a_click_and_none_are_taken_in_by_bayes_rule(training):
    state = clicking.ClickPosterior(training.prior, 2, clicking.LookOptics(PHOTONS))
    dwells = torch.tensor([0.1, 0.1])
    mask = torch.zeros(64)
    mask[20:44] = 1
    look = clicking.ClickLook(mask.expand(2, -1), dwells, torch.ones(2))
    prior = training.prior
    light = prior.mean @ mask + prior.coefficients @ (prior.components @ mask)
    light = light + clicking.FLOOR * mask.sum()
    gain = torch.tensor(PHOTONS / prior.summed_reflectance * 0.1)
    # coefficients of neighbours differ by a standard deviation of 1 in each component
    deviation = (prior.components @ mask).norm()
    variance = deviation**2 + (clicking.VARIATION * (prior.mean @ mask)) ** 2
    dark = clicking.log_no_click(light, variance, gain).exp().double()
    state.take(look, torch.tensor([0, 1]))
    for row, likelihood in enumerate((dark, 1 - dark)):
        expected = (likelihood / likelihood.sum()).numpy()
        assert state.weights[row].numpy() == pytest.approx(expected, rel=2e-3, abs=1e-8)


def test_a_detector_that_stays_dark_in_a_bright_look_gives_no_answer(training, data):
    """Scenes send 20 photons to the bright look in the mean, and a dead detector sees none."""
    price = 0.1
    dead = run(training, 0 * data.x_test[:8], price)
    shares = training.prior.class_shares.expand(len(data.x_test), -1)
    assert torch.equal(dead.probabilities, shares[:8])
    assert dead.clicks.sum() == dead.arriving.sum() == 0
    seen = run(training, data.x_test, price)
    assert not (seen.probabilities == shares).all(dim=1).any()  # one of 128 by a chance of 1e-4
    assert (seen.used <= 1 + 1e-5).all()


def test_the_price_of_mean_clicks_is_the_lowest_that_costs_no_more():
    rng = np.random.default_rng(3)
    looks = 12
    drawn = [torch.from_numpy(rng.random((50, looks))) for _ in range(2)]
    dark = torch.from_numpy(rng.random((50, looks)) < 0.6).long().cumprod(dim=1).bool()
    dark = torch.nn.functional.pad(dark, (1, 0))
    priced = clicking.PricedLooks(*drawn, drawn[1], torch.zeros(50, looks + 1, 2), dark)
    for asked in (0.1, 0.5, 1.0, 2.0):
        price = priced.price(asked)

        def mean_clicks(at):
            total = 0.0
            for worth, clicks, silent in zip(*drawn, dark, strict=True):
                end = 0
                for value, cost in zip(worth, clicks, strict=True):
                    if value <= at:
                        break
                    total += float(cost) / 50
                    end += 1
                total += float(silent[end]) / 50  # a look with all mirrors ON
            return total

        assert mean_clicks(price) <= asked + 1e-9
        assert mean_clicks(price - 1e-6) > asked
    assert priced.price(1e6) == 0


def test_test_scenes_click_as_often_as_was_asked_for(made, tested, training, data):
    settings = made.exposure.settings
    assert settings.price > 0
    assert settings.light_price == pytest.approx(LIGHT_PRICE)  # all light costs these clicks, too
    clicks = run(training, data.x_test[:60], settings.price).clicks
    # the price is known by some training scenes, and the mean by these test scenes
    error = float(clicks.std()) * (1 / len(data.x_test) + 1 / clicking.PRICING_SCENES) ** 0.5
    assert tested.counts == pytest.approx(CLICKS, abs=4 * error)
    assert tested.counts < tested.arriving
    assert tested.score("mean_light") <= 1
    assert tested.accuracy > 4 / 10  # fixed masks read less of so few clicks; chance is 1/10


def test_probabilities_are_those_of_being_right(tested, data):
    # binned over 10 groups; each has a binomial error of at most 1 / (2 sqrt(n / 10))
    assert tested.calibration_error < 0.03 + 0.5 / (len(data.x_test) / 10) ** 0.5


def test_a_file_gives_the_same_exposures(made, data, tmp_path):
    path = made.save(tmp_path / "clicks.safetensors")
    again = Design.load(path)
    few = replace(data, x_test=data.x_test[:50], y_test=data.y_test[:50])
    twice = Design.load(again.save(tmp_path / "again.safetensors"))
    results = [deepfsi.evaluate(design, few, PHOTONS, draws=1)[0] for design in (again, twice)]
    assert results[0] == results[1]
    assert again.exposure.settings == made.exposure.settings
    [before] = deepfsi.evaluate(made, few, PHOTONS, draws=1)
    # components of the prior are stored in 8 bits
    assert results[0].counts == pytest.approx(before.counts, rel=0.2)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera": {**CAMERA, "gates": 4}}, "at most once a look"),
        ({"camera": {**CAMERA, "detectors": "2x2"}}, "one detector"),
        ({"camera": {**CAMERA, "light": "column"}}, "one device"),
        ({"exposure": {"cap": 2}}, "end by themselves"),
        ({"photons": None}, "photons"),
    ],
)
def test_what_clicks_cannot_have_is_refused_in_a_line(data, changes, words):
    asked = {
        "design": "adaptive", "masks": 8, "photons": PHOTONS, "counts": 4, "camera": CAMERA
    }  # fmt: skip
    with pytest.raises(InputError, match=words) as refused:
        deepfsi.learn(data, **{**asked, **changes})
    assert "\n" not in str(refused.value)


def test_few_scenes_are_refused(data):
    few = replace(data, x_train=data.x_train[:300], y_train=data.y_train[:300])
    with pytest.raises(InputError, match="300 training scenes"):
        deepfsi.learn(few, design="adaptive", masks=8, photons=PHOTONS, counts=4, camera=CAMERA)


def test_other_detectors_and_live_runs_are_refused(made, data):
    with pytest.raises(InputError, match="detector that clicks"):
        deepfsi.evaluate(made, data, PHOTONS, noise="poisson")
    with pytest.raises(InputError, match="simulation alone"):
        made.exposure.optics_at(PHOTONS)
    counting = deepfsi.learn(data, design="adaptive", masks=4, photons=PHOTONS, camera="dmd")
    with pytest.raises(InputError, match="photon counts"):
        deepfsi.evaluate(counting, data, PHOTONS, noise="click")

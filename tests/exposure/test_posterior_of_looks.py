"""Laws of exposures whose dwells are chosen while they run."""

import numpy as np
import pytest
import torch

from conftest import RECIPE, exposing, generator
from deepfsi import Design, evaluate
from deepfsi.base.errors import InputError
from deepfsi.datasets.arrays import from_arrays
from deepfsi.evaluation import stopping
from deepfsi.exposure.looks import Dwells, LooksExposure
from deepfsi.physics.laws import ROUNDING_SLACK, light_law
from shared.jobs import learn

LOOKS = 3
ONE_DMD = {"light": "free-dwell", "rails": "single"}


def seeing(digits, photons=1e3, **settings) -> Design:
    """A design of several looks, from a training of a moment."""
    words = {**RECIPE, **ONE_DMD, "looks": LOOKS, "scale": "common", "device": "cpu", **settings}
    return learn(digits, photons=photons, masks=words.pop("masks", 6), **words)


@pytest.fixture(scope="module")
def design(digits) -> Design:
    return seeing(digits)


def exposures(design: Design, x: np.ndarray, photons: float):
    """Exposures of scenes: their rates, dwells and features."""
    scanner = design.scanner()
    with torch.no_grad():
        rates = scanner.rates(torch.from_numpy(x) / design.summed_reflectance)
        *_, seen = design.observe(scanner, rates, generator(1), photons)
    return rates, seen


@pytest.mark.parametrize("levels", [0, 2])
@pytest.mark.parametrize("name", ["deepfsi", "truncated-hadamard", "s-matrix"])
def test_each_exposure_takes_its_time_and_no_more(digits, name, levels):
    masks = 67 if name == "s-matrix" else 6
    design = seeing(digits, design=name, levels=levels, masks=masks)
    dwell = exposures(design, digits.x_test, 1e3)[1].dwell
    assert torch.allclose(dwell.sum(dim=-1), torch.ones(len(dwell)), atol=1e-5)
    assert (dwell >= 0).all()
    peaks = design.rails.stacked.amax(dim=-1)
    assert torch.allclose(peaks, torch.full_like(peaks, 1 / masks), rtol=1e-5)
    assert light_law("free-dwell").excess(design.rails.stacked) <= ROUNDING_SLACK


def test_counts_at_known_dwells_are_poisson(digits, design):
    """Of (y − r)² / r the mean is 1 and the variance 2 + 1/r. Later dwells follow from counts."""
    one_look = exposing(design, looks=1)
    light, seen = exposures(one_look, digits.x_test.repeat(20, axis=0), 1e5)
    rates = (1e5 * 6 * seen.dwell * light[..., 0, :]).double()
    chi = ((seen.features * 1e5 - rates).square() / rates)[rates > 20]
    assert len(chi) > 1e4
    assert abs(float(chi.mean()) - 1) < 5 * (2.05 / len(chi)) ** 0.5


def test_dwells_follow_the_counts_and_only_from_the_second_look(design):
    shown: list[np.ndarray] = []

    def camera(level):
        def read(dwell):
            shown.append(dwell)
            return level * 1e3 * dwell * np.arange(6)

        return read

    dark, bright = design.classify_live(camera(0), 1e3), design.classify_live(camera(1), 1e3)
    assert dark.sum() == pytest.approx(1)
    assert len(shown) == 2 * LOOKS
    assert np.array_equal(shown[0], shown[LOOKS])
    assert not np.allclose(shown[1], shown[LOOKS + 1])
    assert not np.allclose(dark, bright)
    for dwell in shown:
        assert dwell.sum() == pytest.approx(1 / LOOKS, rel=1e-5)


def test_gradients_through_all_looks_are_those_of_finite_differences():
    """Of the mean and of the variance, since the draws are fixed and rates move both."""
    random = {"generator": generator(), "dtype": torch.float64}
    weight = (0.3 * torch.randn(4, 9, **random)).requires_grad_()
    light = (1 + torch.randn(5, 4, **random).abs()).requires_grad_()
    noise = torch.randn(LOOKS, 5, 4, **random)
    mean, std = torch.randn(4, **random).abs(), torch.ones(4, dtype=torch.float64)

    def exposed(weight, light):
        draws = iter(noise)

        def read(dwell):
            rates = dwell * light
            return rates + 0.1 * rates.sqrt() * next(draws), dwell

        exposure = LooksExposure(
            Dwells(4, each_rail=False), lambda inputs: inputs @ weight.T, LOOKS
        )
        looks = exposure.expose_live(read, mean.expand(5, -1), std)
        return torch.cat([seen.inputs(mean, std) for seen in looks]).square().sum()

    assert torch.autograd.gradcheck(exposed, (weight, light))


def test_two_looks_tell_what_one_cannot():
    """One of 4 doors is lit and says which of 4 windows to look at; who cannot look again sees all.

    Of each window the left or the right half is lit; at the lit door's that is the class.
    """
    doors, photons, rng = 4, 100.0, np.random.default_rng(0)

    def scenes(count):
        every = np.arange(count)
        door, label = rng.integers(doors, size=count), rng.integers(2, size=count)
        left = rng.random((count, doors)) < 0.5
        left[every, door] = label == 0
        x = np.zeros((count, 3 * doors), dtype=np.float32)
        x[every, door], x[:, doors::2], x[:, doors + 1 :: 2] = 1, left, ~left
        return x, label

    data = from_arrays(*scenes(4000), *scenes(12000), classes=("left", "right"))
    accuracy = {}
    for looks in (1, 2):
        made = learn(
            data, photons=photons, masks=3 * doors, looks=looks, start="raster", noise="poisson",
            epochs=20, batch=200, mask_lr=0.02, hidden=(64, 64), **ONE_DMD,
        )  # fmt: skip
        (result,) = evaluate(made, data, photons)
        accuracy[looks] = result.accuracy
    noise = sum(share * (1 - share) / 12000 for share in accuracy.values()) ** 0.5
    assert accuracy[2] - accuracy[1] > 5 * noise


def test_what_a_fixed_sequence_is_for_is_refused(digits, design):
    dark = np.zeros(6)
    rule = stopping.StoppingRule(after=(3, 4), threshold=0.5, photons=1e3)
    fixed = seeing(digits, looks=1)
    refused = {
        "photon noise": lambda: evaluate(design, digits, 1e3, noise="gaussian"),
        "give dwell": lambda: design.classify(dark, 1e3),
        "dwells of shape": lambda: design.classify(dark, 1e3, dwell=np.zeros(5)),
        "leave dwell out": lambda: fixed.classify(dark, 1e3, dwell=np.ones(6) / 6),
        "`looks`": lambda: fixed.classify_live(lambda dwell: dark, 1e3),
        "not judged after 1: this rule is for 3 to 4": lambda: design.classify_live(
            lambda dwell: dark, 1e3, rule.decide
        ),
    }
    for match, use in refused.items():
        with pytest.raises(InputError, match=match):
            use()
    for answer, match in (
        *((wrong, "a look does not fit") for wrong in (np.zeros(5), tuple(range(6)), "six")),
        ((dark, np.zeros(5)), "a look does not fit"),
        ((dark, np.ones(6)), "was to take"),
        (np.full(6, np.nan), "finite"),
    ):
        with pytest.raises(InputError, match=match):
            design.classify_live(lambda dwell, answer=answer: answer, 1e3)


@pytest.mark.parametrize("before", [(), (5,), (5, 2)])
def test_the_dwells_of_two_rails_follow_one_another(before):
    """Of one exposure, of several, and of the looks of several."""
    dwells = Dwells(masks=3, each_rail=True)
    given = np.arange(np.prod((*before, 6))).reshape(*before, 6)
    apart = dwells.by_rail(given)
    assert apart.shape == (*before, *dwells.shape)
    assert (apart[..., 0, :] == given[..., ::2]).all()
    assert (apart[..., 1, :] == given[..., 1::2]).all()
    assert (dwells.by_mask(apart) == given).all()

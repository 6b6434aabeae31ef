"""Laws of exposures whose dwells are chosen while they run."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from conftest import RECIPE
from deepfsi import Design, evaluate
from deepfsi.base import InputError
from deepfsi.datasets import Dataset, from_arrays
from deepfsi.evaluation import stopping
from deepfsi.exposure import LooksExposure
from deepfsi.exposure.looks import Dwells
from deepfsi.physics import ROUNDING_SLACK, light_law
from shared.design_files import refused, rewrite
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


def exposures(design: Design, data: Dataset, photons: float, draws: int = 1, noise="poisson"):
    """Exposures of test scenes, each drawn several times: dwells and features."""
    scanner, generator = design.scanner(noise), torch.Generator().manual_seed(1)
    x = torch.from_numpy(data.x_test).repeat_interleave(draws, dim=0)
    with torch.no_grad():
        rates = scanner.rates(x / design.summed_reflectance)
        *_, seen = design.observe(scanner, rates, generator, photons)
    return seen


@pytest.mark.parametrize("levels", [0, 2])
@pytest.mark.parametrize("name", ["deepfsi", "truncated-hadamard", "s-matrix"])
def test_each_exposure_takes_its_time_and_no_more(digits, name, levels):
    masks = 67 if name == "s-matrix" else 6
    design = seeing(digits, design=name, levels=levels, masks=masks)
    dwell = exposures(design, digits, 1e3).dwell
    assert torch.allclose(dwell.sum(dim=-1), torch.ones(len(dwell)), atol=1e-5)
    assert (dwell >= 0).all()
    peaks = design.rails.stacked.amax(dim=-1)
    assert torch.allclose(peaks, torch.full_like(peaks, 1 / masks), rtol=1e-5)
    assert light_law("free-dwell").excess(design.rails.stacked) <= ROUNDING_SLACK


def test_counts_at_known_dwells_are_poisson(digits, design):
    """Of (y − r)² / r the mean is 1 and the variance 2 + 1/r. Later dwells follow from counts."""
    photons, generator = 1e5, torch.Generator().manual_seed(1)
    design = replace(design, exposure=replace(design.exposure, looks=1))
    scanner = design.scanner()
    x = torch.from_numpy(digits.x_test).repeat_interleave(20, dim=0) / design.summed_reflectance
    with torch.no_grad():
        [seen] = design.observe(scanner, scanner.rates(x), generator, photons)
    rates = (photons * 6 * seen.dwell * (x @ design.rails.plus.T)).double()
    chi = ((seen.features * photons - rates).square() / rates)[rates > 20]
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
    generator = torch.Generator().manual_seed(0)
    draw = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64)  # noqa: E731
    weight = (0.3 * draw(4, 9)).requires_grad_()
    light = (1 + draw(5, 4).abs()).requires_grad_()
    noise = draw(LOOKS, 5, 4)
    mean, std = draw(4).abs(), torch.ones(4, dtype=torch.float64)

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


@pytest.mark.parametrize(
    "damage",
    [
        {"exposure": {"kind": "adaptive", "looks": 2.5, "hidden": [8], "shortest": 0.0}},
        {"exposure": {"kind": "adaptive", "looks": 10**9, "hidden": [8], "shortest": 0.0}},
        {"exposure": {"kind": "adaptive", "looks": True, "hidden": [8], "shortest": 0.0}},
        {"exposure": {"kind": "adaptive", "looks": 3, "hidden": [9], "shortest": 0.0}},
        {"exposure": {"kind": "fixed"}},
        {"light": "column"},
    ],
)
def test_damaged_looks_are_refused(design, tmp_path, damage):
    path = design.save(tmp_path / "looks.safetensors")
    rewrite(path, lambda header, _: header.update(damage))
    refused(path)


def test_what_a_fixed_sequence_is_for_is_refused(digits, design):
    with pytest.raises(InputError, match="photon noise"):
        evaluate(design, digits, 1e3, noise="gaussian")
    with pytest.raises(InputError, match="give dwell"):
        design.classify(np.zeros(6), 1e3)
    with pytest.raises(InputError, match="dwells of shape"):
        design.classify(np.zeros(6), 1e3, dwell=np.zeros(5))
    for wrong in (np.zeros(5), tuple(range(6)), "six", (np.zeros(6), np.zeros(5))):
        with pytest.raises(InputError, match="a look does not fit"):
            design.classify_live(lambda dwell, wrong=wrong: wrong, 1e3)
    with pytest.raises(InputError, match="was to take"):
        design.classify_live(lambda dwell: (np.zeros(6), 2 * dwell), 1e3)
    with pytest.raises(InputError, match="not judged after 1: this rule is for 3 to 4"):
        design.classify_live(
            lambda dwell: np.zeros(6),
            1e3,
            stopping.StoppingRule(after=(3, 4), threshold=0.5, photons=1e3).decide,
        )
    with pytest.raises(InputError, match="finite"):
        design.classify_live(lambda dwell: np.full(6, np.nan), 1e3)
    fixed = seeing(digits, looks=1)
    with pytest.raises(InputError, match="`looks`"):
        fixed.classify_live(lambda dwell: np.zeros(6), 1e3)
    with pytest.raises(InputError, match="leave dwell out"):
        fixed.classify(np.zeros(6), 1e3, dwell=np.ones(6) / 6)


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

"""Laws of designs that know the shortest dwell of their device."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from conftest import RECIPE
from deepfsi import Design
from deepfsi.base import InputError
from deepfsi.physics import SLACK, LearnedMasks, light_law
from shared.jobs import job, learn

SHORTEST = 0.06
"""Share of the exposure: five frames of a look of three, of ten masks."""

ONE_DMD = {"light": "free-dwell", "rails": "single"}
ROUNDING = 1e-5


@pytest.fixture(scope="module")
def looking(digits) -> Design:
    words = {**RECIPE, **ONE_DMD, "looks": 3, "scale": "common", "device": "cpu"}
    return learn(digits, photons=1e3, masks=10, shortest_dwell=SHORTEST, **words)


def dwells_of(design: Design) -> list[np.ndarray]:
    """Dwells of the looks of one exposure, as a camera is told them."""
    told: list[np.ndarray] = []
    rng = np.random.default_rng(0)

    def read(dwell):
        told.append(dwell)
        return rng.poisson(1e3 * dwell * np.arange(dwell.size).reshape(dwell.shape))

    design.classify_live(read, 1e3)
    return told


def check_dwells(dwells: np.ndarray, total: float) -> None:
    lit = dwells[dwells > 0]
    assert lit.min() >= SHORTEST * (1 - ROUNDING)
    assert lit.size <= total / SHORTEST
    assert dwells.sum() == pytest.approx(total, rel=ROUNDING)


def test_no_look_has_a_frame_below_the_shortest(looking):
    told = dwells_of(looking)
    assert len(told) == 3
    for dwell in told:
        check_dwells(dwell, 1 / 3)
    free = replace(looking, exposure=replace(looking.exposure, shortest=0.0))
    assert min(dwell.min() for dwell in dwells_of(free)) < SHORTEST / 2


@pytest.mark.parametrize("levels", [0, 2])
@pytest.mark.parametrize(
    "optics", [ONE_DMD, {"light": "free-dwell"}, {"light": "two-arm"}], ids=str
)
def test_no_frame_of_a_sequence_is_below_the_shortest(digits, optics, levels):
    words = {**RECIPE, **optics, "levels": levels, "device": "cpu"}
    design = learn(digits, photons=1e3, masks=20, shortest_dwell=SHORTEST, **words)
    rails = design.rails.total[None] if "two-arm" in optics.values() else design.rails.stacked
    dwells = rails.amax(dim=-1).numpy()
    check_dwells(dwells, float(dwells.sum()))
    assert light_law(optics["light"]).excess(design.rails.stacked) <= SLACK


def test_a_frame_that_is_left_out_may_come_back():
    """Its dwell has a gradient, though it is not shown."""
    start = torch.rand(1, 4, 5, generator=torch.Generator().manual_seed(0))
    masks = LearnedMasks(start, "free-dwell", "single", shortest=0.25)
    with torch.no_grad():
        masks.dwell.copy_(torch.tensor([0.3, 0.2, 0.1, 0.0]))
    matrix = masks().difference
    assert (matrix.amax(dim=-1) > 0).tolist() == [[True, True, True, False]]
    matrix[..., 3, :].sum().backward()
    assert float(masks.dwell.grad[..., 3]) > 0


def test_a_look_is_longer_than_a_frame(digits):
    words = {**ONE_DMD, "photons": 1e3, "masks": 4}
    job(looks=16, shortest_dwell=SHORTEST, **words).check(digits)
    with pytest.raises(InputError, match=r"a look 0\.05: give fewer looks, or a longer"):
        job(looks=20, shortest_dwell=SHORTEST, **words).check(digits)
    job(looks=20, shortest_dwell=SHORTEST, exposure=2.0, **words).check(digits)


def test_dwells_of_masks_are_those_of_the_first_look(looking):
    first = dwells_of(looking)[0]
    shown = looking.exposure.mask_dwells()
    by_mask = first.reshape(-1, looking.masks).sum(axis=0)
    np.testing.assert_allclose(shown.detach(), by_mask, rtol=1e-5, atol=1e-7)
    assert by_mask.sum() == pytest.approx(1 / 3)

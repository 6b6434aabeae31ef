"""Laws of designs that know the shortest dwell of their device."""

import numpy as np
import pytest

from conftest import RECIPE, exposing
from deepfsi import Design
from deepfsi.physics.laws import ROUNDING_SLACK, light_law
from shared.jobs import learn

SHORTEST = 0.06
"""Share of the exposure: five frames of a look of three, of ten masks."""

ONE_DMD = {"light": "free-dwell", "rails": "single"}


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
    assert lit.min() >= SHORTEST * (1 - 1e-5)
    assert lit.size <= total / SHORTEST
    assert dwells.sum() == pytest.approx(total, rel=1e-5)


def test_no_look_has_a_frame_below_the_shortest(looking):
    told = dwells_of(looking)
    assert len(told) == 3
    for dwell in told:
        check_dwells(dwell, 1 / 3)
    free = dwells_of(exposing(looking, shortest=0.0))
    assert min(dwell.min() for dwell in free) < SHORTEST / 2


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
    assert light_law(optics["light"]).excess(design.rails.stacked) <= ROUNDING_SLACK

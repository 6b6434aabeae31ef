"""Laws of designs that know the shortest dwell of their device."""

import numpy as np
import pytest

from conftest import RECIPE
from deepfsi.physics.laws import ROUNDING_SLACK, light_law
from shared.jobs import learn

SHORTEST = 0.06
"""Share of the exposure: sixteen frames."""

ONE_DMD = {"light": "free-dwell", "rails": "single"}


def check_dwells(dwells: np.ndarray, total: float) -> None:
    lit = dwells[dwells > 0]
    assert lit.min() >= SHORTEST * (1 - 1e-5)
    assert lit.size <= total / SHORTEST
    assert dwells.sum() == pytest.approx(total, rel=1e-5)


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

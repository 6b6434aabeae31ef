"""A design for a budget of counts counts that many, whatever it learns."""

import numpy as np
import pytest

from conftest import RECIPE, every_design, own_matrix
from deepfsi.base import SILENT
from deepfsi.training import learning
from shared.jobs import learn

BRIEF = {**RECIPE, "masks": 6, "device": "cpu"}


def counted(design) -> float:
    """Counts in the mean over training scenes, at the budget of the training."""
    return design.info["job"]["photons"] * float(design.shares.sum())


@pytest.mark.usefixtures("uncharacterised")
@every_design
def test_counts_in_the_mean_are_those_asked_for(digits, design, light, rails):
    masks = {"impulse": 64, "raster": 64, "hadamard": 64, "s-matrix": 67}.get(design, 6)
    own = {"matrix": own_matrix(masks, 64, light, rails)} if design == "custom" else {}
    settings = {**BRIEF, "masks": masks, "light": light, "rails": rails, **own}
    made = learn(digits, counts=40.0, design=design, **settings)
    learned = design in ("deepfsi", "control")
    assert counted(made) == pytest.approx(40, rel=learning.NEAR if learned else 1e-4)


class Told:
    """Stands for a design whose shares follow from its budget."""

    def __init__(self, share: float) -> None:
        self.shares = np.array([share])


def test_trainings_end_when_counts_are_near_and_anyhow():
    budgets = []

    def settles(photons, _):
        budgets.append(photons)
        return Told(0.4 + 0.1 * 100 / (100 + photons))

    found = learning.train_for_counts(50, 1.0, settles, SILENT)
    assert 1 < len(budgets) < learning.MOST_TRAININGS
    assert budgets[-1] * found.shares.sum() == pytest.approx(50, rel=learning.NEAR)

    tried = []

    def never(photons, _):
        tried.append(photons)
        return Told(1.0 if len(tried) % 2 else 0.5)

    learning.train_for_counts(50, 0.5, never, SILENT)
    assert len(tried) == learning.MOST_TRAININGS

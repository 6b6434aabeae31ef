"""A design for a budget of counts counts that many, whatever it learns."""

import numpy as np
import pytest

from conftest import RECIPE, every_design, own_matrix
from deepfsi import evaluate
from deepfsi.base import SILENT, InputError
from deepfsi.training.learning import MOST_TRAININGS, NEAR, train_for_counts
from shared.jobs import job, learn

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
    assert counted(made) == pytest.approx(40, rel=NEAR if learned else 1e-4)


def test_counts_of_test_scenes_are_near_those_of_training(digits):
    """They differ by the brightness of the two parts of the data alone."""
    made = learn(digits, counts=40.0, **BRIEF)
    [result] = evaluate(made, digits, made.info["job"]["photons"], draws=1)
    brighter = digits.x_test.sum(axis=1).mean() / digits.x_train.sum(axis=1).mean()
    assert result.counts == pytest.approx(40 * brighter, rel=NEAR + 0.02)


def test_several_looks_count_as_many(digits):
    settings = {**BRIEF, "light": "free-dwell", "rails": "single", "noise": "poisson"}
    assert counted(learn(digits, counts=40.0, looks=2, **settings)) == pytest.approx(40, rel=NEAR)


@pytest.mark.parametrize(
    "optics",
    [
        {"detectors": "2x2", "light": "free-dwell", "rails": "single"},
        {"detectors": "2x2", "light": "two-arm", "readout": "both"},
    ],
)
@pytest.mark.parametrize("design", ["deepfsi", "pca"])
def test_detectors_count_as_many_together(digits, design, optics):
    made = learn(digits, counts=40.0, design=design, **{**BRIEF, **optics})
    assert counted(made) == pytest.approx(40, rel=NEAR)
    [result] = evaluate(made, digits, made.info["job"]["photons"], draws=1)
    assert result.counts == pytest.approx(40, rel=0.06)


def test_a_named_design_is_trained_once_and_as_at_its_budget(digits):
    made = learn(digits, counts=40.0, design="pca", **BRIEF)
    again = learn(digits, photons=made.info["job"]["photons"], design="pca", **BRIEF)
    for one, other in zip(made.classifier.parameters(), again.classifier.parameters(), strict=True):
        assert np.array_equal(one.detach(), other.detach())


class Told:
    """Stands for a design whose shares follow from its budget."""

    def __init__(self, share: float) -> None:
        self.shares = np.array([share])


def test_trainings_end_when_counts_are_near_and_anyhow():
    budgets = []

    def settles(photons, _):
        budgets.append(photons)
        return Told(0.4 + 0.1 * 100 / (100 + photons))

    found = train_for_counts(50, 1.0, settles, SILENT)
    assert 1 < len(budgets) < MOST_TRAININGS
    assert budgets[-1] * found.shares.sum() == pytest.approx(50, rel=NEAR)

    tried = []

    def never(photons, _):
        tried.append(photons)
        return Told(1.0 if len(tried) % 2 else 0.5)

    train_for_counts(50, 0.5, never, SILENT)
    assert len(tried) == MOST_TRAININGS


def test_light_is_told_once(digits):
    with pytest.raises(InputError, match="told once"):
        learn(digits, masks=4)
    with pytest.raises(InputError, match="one budget"):
        learn(digits, masks=4, counts=30, span=10)
    for bad in (-3.0, float("nan"), 1e16):
        with pytest.raises(InputError):
            learn(digits, masks=4, counts=bad)
    assert job(masks=4, photons=30).photons == 30

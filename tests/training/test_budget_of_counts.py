"""A design for a budget of counts, or for counts within a budget of photons, counts that many."""

from types import SimpleNamespace

import numpy as np
import pytest

from conftest import RECIPE, every_design, own_matrix
from deepfsi import evaluate
from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT
from deepfsi.physics.laws import light_law
from deepfsi.training import learning
from shared.jobs import learn

FEW = {"masks": 16, "photons": 200.0, "epochs": 10, "hidden": (32,), "device": "cpu"}


@pytest.mark.usefixtures("uncharacterised")
@every_design
def test_counts_in_the_mean_are_those_asked_for(digits, design, light, rails):
    masks = {"impulse": 64, "raster": 64, "hadamard": 64, "s-matrix": 67}.get(design, 6)
    own = {"matrix": own_matrix(masks, 64, light, rails)} if design == "custom" else {}
    settings = {**RECIPE, "masks": masks, "light": light, "rails": rails, "device": "cpu", **own}
    made = learn(digits, counts=40.0, design=design, **settings)
    near = learning.NEAR if design in ("deepfsi", "control") else 1e-4
    assert made.info["job"]["photons"] * float(made.shares.sum()) == pytest.approx(40, rel=near)


def of_shares(*shares: float) -> SimpleNamespace:
    """Stands for a design that has these."""
    return SimpleNamespace(shares=np.array(shares))


def test_trainings_end_when_counts_are_near_and_anyhow():
    budgets: list[float] = []

    def settles(photons, _):
        budgets.append(photons)
        return of_shares(0.4 + 0.1 * 100 / (100 + photons))

    def never(photons, _):
        budgets.append(photons)
        return of_shares(1.0 if len(budgets) % 2 else 0.5)

    found = learning.train_for_counts(50, 1.0, settles, SILENT)
    assert 1 < len(budgets) < learning.MOST_TRAININGS
    assert budgets[-1] * found.shares.sum() == pytest.approx(50, rel=learning.NEAR)
    budgets.clear()
    learning.train_for_counts(50, 0.5, never, SILENT)
    assert len(budgets) == learning.MOST_TRAININGS


@pytest.mark.usefixtures("uncharacterised")
@pytest.mark.parametrize(
    ("noise", "light", "rails"),
    [("click", "free-dwell", "single"), ("camera", "column", "dual")],
)
def test_a_training_counts_what_was_asked_for_within_its_light_law(digits, noise, light, rails):
    """A tenth: the counts of test scenes differ by their brightness, and the training is brief."""
    made = learn(digits, counts=6.0, noise=noise, light=light, rails=rails, **FEW)
    [result] = evaluate(made, digits, FEW["photons"], draws=1)
    assert result.counts == pytest.approx(6.0, rel=0.1)
    assert result.photons == made.info["job"]["photons"] == FEW["photons"]
    light_law(light).check(made.rails.stacked)


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"counts": None, "start_counts": 2.0}, "`start_counts` is of few counts within a budget"),
        ({"design": "pca"}, "are of learned masks"),
        ({"camera": "dmd", "span": 2}, "counts are of one budget"),
        ({"train_noise": "ml_gauss"}, "not under ml_gauss noise"),
        ({"counts": 300.0}, "300 counts are not fewer than 200, the photons"),
        ({"noise": "click", "counts": 40.0}, "not fewer than 32, the clicks of all its gates"),
        ({"noise": "click", "photons": None}, "give `photons`, too"),
        ({"counts": -1.0}, "counts"),
    ],
)
def test_what_cannot_be_had_is_refused(digits, settings, match):
    given = {**FEW, "counts": 6.0, **settings}
    with pytest.raises(InputError, match=match):
        learn(digits, **{name: value for name, value in given.items() if value is not None})

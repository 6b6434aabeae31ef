"""Counts within a budget: a training counts as many as were asked for, of no more light."""

import pytest

from deepfsi import evaluate
from deepfsi.base import InputError
from deepfsi.physics import light_law
from shared.jobs import learn

BRIEF = {"masks": 16, "photons": 200.0, "epochs": 20, "hidden": (32,), "device": "cpu"}


@pytest.mark.usefixtures("uncharacterised")
@pytest.mark.parametrize(
    ("noise", "light", "rails"),
    [
        ("click", "free-dwell", "single"),
        ("camera", "column", "dual"),
    ],
)
def test_a_training_counts_what_was_asked_for_within_its_light_law(digits, noise, light, rails):
    """A tenth: the counts of test scenes differ by their brightness, and the training is brief."""
    made = learn(digits, counts=6.0, noise=noise, light=light, rails=rails, **BRIEF)
    [result] = evaluate(made, digits, BRIEF["photons"], draws=1)
    assert result.counts == pytest.approx(6.0, rel=0.1)
    assert result.photons == made.info["job"]["photons"] == BRIEF["photons"]
    light_law(light).check(made.rails.stacked)


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"design": "pca"}, "counts within a budget are of learned masks"),
        ({"camera": "dmd", "looks": 2}, "counts within a budget are of learned masks"),
        ({"train_noise": "ml_gauss"}, "not under ml_gauss noise: give one of poisson"),
        ({"counts": 300.0}, "300 counts are not fewer than 200, the photons of its budget"),
        ({"noise": "click", "counts": 40.0}, "not fewer than 32, the clicks of all its gates"),
        ({"noise": "click", "photons": None}, "they tell no budget: give `photons`, too"),
        ({"counts": -1.0}, "counts"),
    ],
)
def test_what_cannot_be_had_is_refused(digits, settings, match):
    given = {**BRIEF, "counts": 6.0, **settings}
    given = {name: value for name, value in given.items() if value is not None}
    with pytest.raises(InputError, match=match):
        learn(digits, **given)

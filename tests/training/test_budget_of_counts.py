"""A design for counts within a budget of photons counts that many."""

import pytest

from deepfsi import InputError, evaluate
from deepfsi.physics.laws import light_law
from shared.jobs import learn

FEW = {"masks": 16, "photons": 200.0, "epochs": 10, "hidden": (32,), "device": "cpu"}


@pytest.mark.usefixtures("uncharacterised")
@pytest.mark.parametrize(
    ("noise", "light", "rails"), [("click", "free-dwell", "single"), ("camera", "column", "dual")]
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
        ({"design": "pca"}, "are of learned masks"),
        ({"train_noise": "ml_gauss"}, "trained under poisson, camera, click noise"),
        ({"counts": 300.0}, "300 counts are not fewer than 200, the photons"),
        ({"noise": "click", "counts": 40.0}, "not fewer than 32, the clicks of all its gates"),
    ],
)
def test_what_cannot_be_had_is_refused(digits, settings, match):
    with pytest.raises(InputError, match=match):
        learn(digits, **{**FEW, "counts": 6.0, **settings})

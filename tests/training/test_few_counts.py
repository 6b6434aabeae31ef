"""Counts within a budget: a training counts as many as were asked for, of no more light."""

import pytest
import torch

from deepfsi import evaluate
from deepfsi.base import InputError
from deepfsi.physics import LearnedMasks, light_law
from deepfsi.training.losses import CountsCost
from shared.jobs import learn

BRIEF = {"masks": 16, "photons": 200.0, "epochs": 20, "hidden": (32,), "device": "cpu"}


@pytest.fixture(scope="module")
def few(digits):
    return learn(digits, counts=6.0, noise="click", light="column", rails="single", **BRIEF)


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


def test_masks_choose_what_they_detect(few, digits):
    """At as many clicks, of a small budget, all light is taken; five sigma of the noise draws."""
    [chosen] = evaluate(few, digits, BRIEF["photons"], draws=20)
    how = {**BRIEF, "noise": "click", "light": "column", "rails": "single"}
    plain = learn(digits, **{**how, "photons": 8.0})
    [taken] = evaluate(plain, digits, 8.0, draws=20)
    assert taken.counts == pytest.approx(chosen.counts, rel=0.25)
    error = (2 * 0.25 / (20 * len(digits.x_test))) ** 0.5
    assert chosen.accuracy - taken.accuracy > 5 * error


def test_the_counts_end_at_those_asked_for():
    """Of a loss −a log(c), whose minimum the cost must move to c = 5: it takes a weight of a."""
    cost, light = CountsCost(5.0, 4000), torch.tensor([50.0, 20.0]).log().requires_grad_()
    worth = torch.tensor([0.3, 0.8])
    for _ in range(4000):
        (slope,) = torch.autograd.grad((cost(light.exp()) - worth * light).sum(), light)
        with torch.no_grad():
            light -= 0.05 * slope
    assert torch.allclose(light.exp(), torch.tensor(5.0), rtol=0.06)
    assert (cost.weight > 0.9 * worth).all()


@pytest.mark.parametrize(
    ("light", "rails"), [("column", "dual"), ("free-dwell", "single"), ("equal-dwell", "dual")]
)
def test_dim_masks_pass_that_part_of_the_light(light, rails):
    start = torch.rand(2, 5, 9, generator=torch.Generator().manual_seed(0))
    masks = LearnedMasks(start, light, rails)
    before = masks().total.detach()
    masks.dim(torch.tensor([0.1, 0.5]))
    wanted = before * torch.tensor([0.1, 0.5])[:, None, None]
    assert torch.allclose(masks().total, wanted, atol=1e-6)


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

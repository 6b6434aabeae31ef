"""Losses: the usual ones against torch's, and those of a user's own."""

import pytest
import torch

from deepfsi import evaluate, learn
from deepfsi.base.errors import InputError
from deepfsi.training import losses
from shared.values import placed_digits


def test_a_loss_of_ones_own_that_is_the_usual_one_trains_the_same_design():
    data, name = placed_digits(), "deepfsi.training.losses:squared_error"

    def made(**loss):
        training = {"epochs": 2, **loss}
        return learn(data, camera="dmd", photons=1e4, masks=4, training=training)

    usual, own, named = made(), made(loss=losses.squared_error), made(loss=name)
    assert torch.equal(usual.rails.stacked, own.rails.stacked)
    assert torch.equal(usual.rails.stacked, named.rails.stacked)
    assert own.info["job"]["training"]["loss"] == name
    other = made(loss=lambda outputs, truth: (outputs - truth).abs().mean(dim=-1))
    assert not torch.equal(usual.rails.stacked, other.rails.stacked)
    assert evaluate(other, data, 1e4, draws=1)[0].r2 > 0.3


@pytest.mark.parametrize(
    ("loss", "told"),
    [
        (lambda outputs, truth: outputs.mean(), r"gives \(\) of"),
        (lambda outputs, truth: outputs.detach()[:, 0], "no gradient"),
        ("no.such:loss", "cannot be imported"),
    ],
)
def test_a_bad_loss_is_refused_in_one_line(digits, loss, told):
    with pytest.raises(InputError, match=told) as error:
        learn(digits, camera="dmd", photons=1e4, masks=2, training={"epochs": 1, "loss": loss})
    assert "\n" not in str(error.value)

"""The paper's classifier."""

import math

import pytest
import torch

from conftest import generator
from deepfsi import Mlp


@pytest.mark.parametrize("dropout", [0.1, 0.25, 0.5, 0.9])
def test_dropout_drops_its_share_and_keeps_the_mean(dropout):
    """Logits are the units of the one hidden layer, all 1 before dropout."""
    net = Mlp(3, 20, (20,), dropout, generator()).train()
    with torch.no_grad():
        net.layers[0].weight.zero_()
        net.layers[0].bias.fill_(1)
        net.layers[1].weight.copy_(torch.eye(20))
        net.layers[1].bias.zero_()
    units = net(torch.zeros(5000, 3))
    assert units.unique().tolist() == pytest.approx([0.0, 1 / (1 - dropout)])
    dropped = (units == 0).double()
    one = math.sqrt(dropout * (1 - dropout))
    assert abs(dropped.mean() - dropout) <= 5 * one / math.sqrt(units.numel()) + 2**-16
    assert ((dropped.mean(dim=0) - dropout).abs() <= 5 * one / math.sqrt(5000)).all()

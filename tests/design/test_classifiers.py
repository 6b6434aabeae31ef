"""The paper's classifier."""

import math

import pytest
import torch

from conftest import generator
from deepfsi import Mlp
from deepfsi.design.networks import Replicas


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


def test_products_in_bfloat16_round_logits_and_gradients():
    """Both are those of float32, but for the rounding; the logits are returned as float32."""
    features, exact, rounded = torch.randn(64, 2, 30, generator=generator()), [], []
    for found, dtype in ((exact, torch.float32), (rounded, torch.bfloat16)):
        networks = [Mlp(30, 4, (48, 32), 0.0, generator(seed)) for seed in range(2)]
        replicas = Replicas(networks, False, dtype)
        logits = replicas(features)
        logits.square().sum().backward()
        found += [logits.detach(), *(each.grad for each in replicas.parameters())]
    # a rounding to 8 bits is wrong by 2⁻⁹ at most; as large a share of units changes between 0 and
    # on, and a share s of the terms of a gradient is √s of its norm
    limits = [8 * 2**-9] + [2 * 2**-4.5] * (len(exact) - 1)
    assert rounded[0].dtype == torch.float32
    for one, other, limit in zip(exact, rounded, limits, strict=True):
        assert 0 < (one - other).norm() / one.norm() < limit

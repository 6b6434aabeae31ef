"""The paper's classifier."""

import math

import pytest
import torch
from torch import Tensor, nn

from conftest import generator
from deepfsi import Mlp
from deepfsi.networks import Replicas, Vit


def probe(units: int, dropout: float, seed: int = 0) -> Mlp:
    """A classifier whose logits are the units of its one hidden layer, all 1 before dropout."""
    net = Mlp(3, units, (units,), dropout, generator(seed))
    with torch.no_grad():
        net.layers[0].weight.zero_()
        net.layers[0].bias.fill_(1)
        net.layers[1].weight.copy_(torch.eye(units))
        net.layers[1].bias.zero_()
    return net.train()


def test_weights_start_uniform_as_torch_linear():
    net = Mlp(100, 10, (400,), generator=generator())
    weight = net.layers[0].weight.detach()
    assert weight.abs().max() <= 0.1
    deviation = 0.1 / math.sqrt(3)
    assert abs(weight.std() - deviation) <= 5 * deviation * math.sqrt(0.2 / weight.numel())
    assert abs(weight.mean()) <= 5 * deviation / math.sqrt(weight.numel())


@pytest.mark.parametrize("dropout", [0.1, 0.25, 0.5, 0.9])
def test_dropout_drops_its_share_and_keeps_the_mean(dropout):
    units = probe(20, dropout)(torch.zeros(5000, 3))
    assert units.unique().tolist() == pytest.approx([0.0, 1 / (1 - dropout)])
    dropped = float((units == 0).double().mean())
    five_sigma = 5 * math.sqrt(dropout * (1 - dropout) / units.numel())
    assert abs(dropped - dropout) <= five_sigma + 2**-16
    per_unit = (units == 0).double().mean(dim=0)
    assert (abs(per_unit - dropout) <= 5 * math.sqrt(dropout * (1 - dropout) / 5000)).all()


@pytest.mark.parametrize("dropout", [0.0, 0.3])
def test_stacked_networks_are_as_those_alone(dropout):
    """Logits, and what a step of descent makes of the weights."""
    features, alone, stacked = torch.randn(5, 3, 4, generator=generator()), [], []
    for networks, stacks in ((alone, False), (stacked, True)):
        networks += [Mlp(4, 2, (6, 5), dropout, generator(seed)) for seed in range(3)]
        replicas = Replicas(networks, stacked=stacks)
        logits = replicas(features)
        optimiser = torch.optim.SGD(replicas.parameters(), lr=0.1)
        logits.square().sum().backward()
        optimiser.step()
        replicas.hand_back()
    for one, other in zip(alone, stacked, strict=True):
        for first, second in zip(one.parameters(), other.parameters(), strict=True):
            assert torch.allclose(first, second, atol=1e-6)
    assert not torch.equal(
        alone[0].layers[0].weight, Mlp(4, 2, (6, 5), 0, generator()).layers[0].weight
    )


def vit(generator_: torch.Generator | None = None, **size: int) -> Vit:
    given = {"width": 8, "depth": 2, "heads": 2, "hidden": 12, **size}
    return Vit(5, 6, 3, **given, generator=generator_ or generator())


def by_hand(net: Vit, features: Tensor) -> Tensor:
    """The same logits from attention written out."""
    h = features @ net.embedding.weight.T + net.embedding.bias + net.position
    for layer in net.encoder.layers:
        attention, heads = layer.self_attn, layer.self_attn.num_heads
        normed = nn.functional.layer_norm(h, h.shape[-1:], layer.norm1.weight, layer.norm1.bias)
        parts = normed @ attention.in_proj_weight.T + attention.in_proj_bias
        query, key, value = parts.unflatten(-1, (3, heads, -1)).permute(2, 0, 3, 1, 4)
        likeness = (query @ key.transpose(-1, -2) / query.shape[-1] ** 0.5).softmax(dim=-1)
        h = h + attention.out_proj((likeness @ value).transpose(1, 2).flatten(-2))
        normed = nn.functional.layer_norm(h, h.shape[-1:], layer.norm2.weight, layer.norm2.bias)
        h = h + layer.linear2(nn.functional.gelu(layer.linear1(normed)))
    last = net.encoder.norm
    return net.head(nn.functional.layer_norm(h, h.shape[-1:], last.weight, last.bias).mean(dim=1))


@pytest.mark.parametrize("training", [False, True])
def test_the_transformer_attends_over_patches(training):
    net = vit().train(training)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter += 0.1 * torch.randn(parameter.shape, generator=generator(1))
        features = torch.randn(4, 6, 5, generator=generator(2))
        assert torch.allclose(net(features), by_hand(net, features), atol=1e-5)


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

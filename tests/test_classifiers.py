"""The paper's classifier, alone and in replicas."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor, nn

from conftest import generator
from deepfsi.classifiers import Mlp


def probe(units: int, dropout: float, seed: int = 0, replicas: int | None = None) -> Mlp:
    """A classifier whose logits are the units of its one hidden layer, all 1 before dropout."""
    net = Mlp(3, units, (units,), dropout, replicas, generator(seed))
    with torch.no_grad():
        net.weights[0].zero_()
        net.biases[0].fill_(1)
        net.weights[1].copy_(torch.eye(units))
        net.biases[1].zero_()
    return net.train()


def test_layers_are_linear_then_rectified():
    net = Mlp(5, 3, (4, 6), generator=generator()).eval()
    x = torch.randn(8, 5, generator=generator(1))
    h = x
    for weight, bias in list(zip(net.weights, net.biases, strict=True))[:-1]:
        h = nn.functional.linear(h, weight.T, bias).relu()
    expected = nn.functional.linear(h, net.weights[-1].T, net.biases[-1])
    assert torch.allclose(net(x), expected, atol=1e-6)


def test_the_default_has_the_papers_layers():
    widths = [tuple(w.shape) for w in Mlp(10, 7, generator=generator()).weights]
    assert widths == [(10, 40), (40, 128), (128, 7)]


def test_no_hidden_layer_is_a_linear_classifier():
    net = Mlp(4, 2, (), generator=generator())
    x = torch.randn(3, 4, generator=generator(1))
    assert torch.allclose(net(x), x @ net.weights[0] + net.biases[0])


@pytest.mark.parametrize("lead", [(), (6,), (2, 6)])
def test_features_may_have_any_leading_shape(lead):
    assert Mlp(4, 3, (5,), 0.2, generator=generator())(torch.ones(*lead, 4)).shape == (*lead, 3)


def test_weights_start_uniform_as_torch_linear():
    net = Mlp(100, 10, (400,), generator=generator())
    weight = net.weights[0].detach()
    assert weight.abs().max() <= 0.1
    deviation = 0.1 / math.sqrt(3)
    assert abs(weight.std() - deviation) <= 5 * deviation * math.sqrt(0.2 / weight.numel())
    assert abs(weight.mean()) <= 5 * deviation / math.sqrt(weight.numel())


def test_a_seed_repeats_and_another_differs():
    first, again, other = (Mlp(5, 3, generator=generator(seed)) for seed in (1, 1, 2))
    assert torch.equal(first.weights[0], again.weights[0])
    assert not torch.equal(first.weights[0], other.weights[0])


@pytest.mark.parametrize("dropout", [0.1, 0.25, 0.5, 0.9])
def test_dropout_drops_its_share_and_keeps_the_mean(dropout):
    units = probe(20, dropout)(torch.zeros(5000, 3))
    assert units.unique().tolist() == pytest.approx([0.0, 1 / (1 - dropout)])
    dropped = float((units == 0).double().mean())
    five_sigma = 5 * math.sqrt(dropout * (1 - dropout) / units.numel())
    assert abs(dropped - dropout) <= five_sigma + 2**-16
    per_unit = (units == 0).double().mean(dim=0)
    assert (abs(per_unit - dropout) <= 5 * math.sqrt(dropout * (1 - dropout) / 5000)).all()


def test_dropout_is_independent_from_unit_to_unit_and_scene_to_scene():
    units = (probe(20, 0.5)(torch.zeros(5000, 3)) == 0).double()
    bound = 5 / math.sqrt(5000)
    assert (torch.corrcoef(units.T) - torch.eye(20)).abs().max() <= bound
    assert abs(torch.corrcoef(torch.stack([units[:-1, 0], units[1:, 0]]))[0, 1]) <= bound


def test_dropout_is_independent_along_every_leading_axis():
    units = probe(20, 0.5)(torch.zeros(2, 500, 3))
    assert not torch.equal(units[0], units[1])


def test_dropout_follows_the_generator_not_the_global_state():
    def draw(seed: int) -> Tensor:
        net = probe(20, 0.5, seed)
        torch.manual_seed(seed + 10)
        return net(torch.zeros(50, 3))

    first, other = draw(1), draw(2)
    torch.manual_seed(99)
    assert torch.equal(probe(20, 0.5, 1)(torch.zeros(50, 3)), first)
    assert not torch.equal(first, other)


def test_dropout_rests_in_evaluation_and_at_zero():
    x = torch.zeros(50, 3)
    assert (probe(20, 0.5).eval()(x) == 1).all()
    assert (probe(20, 0.0)(x) == 1).all()


def test_replicas_start_alike_and_share_their_dropout():
    net = Mlp(4, 3, (30,), 0.5, replicas=3, generator=generator()).train()
    logits = net(torch.ones(3, 40, 4))
    assert torch.equal(logits[0], logits[1])
    assert torch.equal(logits[0], logits[2])


def test_a_replica_is_its_slice():
    net = Mlp(4, 3, (8, 5), replicas=3, generator=generator()).eval()
    with torch.no_grad():
        for parameter in net.parameters():
            parameter += torch.randn(parameter.shape, generator=generator(4))
    x = torch.randn(3, 40, 4, generator=generator(1))
    for index in range(3):
        single = net.replica(index)
        assert not single.training
        assert [w.shape for w in single.weights] == [w.shape[1:] for w in net.weights]
        assert [b.shape for b in single.biases] == [b.shape[2:] for b in net.biases]
        assert torch.allclose(single(x[index]), net(x)[index], atol=1e-6)


def test_a_single_classifier_starts_as_a_replica_does():
    single = Mlp(4, 3, generator=generator())
    many = Mlp(4, 3, replicas=2, generator=generator())
    for one, all_ in zip(single.parameters(), many.parameters(), strict=True):
        assert torch.equal(one, all_[1].view_as(one))

"""A noise, a network and a loss as users write them, importable as `golden.parts:NAME`."""

import torch


def shot(rates, generator=None):
    """Photon noise of a normal law."""
    root = rates.clamp(min=0).sqrt()
    return rates + root * torch.randn(rates.shape, generator=generator, device=rates.device)


def network(inputs, classes, hidden=5):
    """A network of one narrow layer."""
    layers = torch.nn.Linear(inputs, hidden), torch.nn.Tanh(), torch.nn.Linear(hidden, classes)
    return torch.nn.Sequential(*layers)


def absolute(outputs, truth):
    """Absolute distance of values, of each scene."""
    return (outputs - truth).abs().sum(dim=-1)

"""Classifiers as users write them, importable as `shared.networks:NAME`."""

import torch
from torch import Tensor, nn


class Cnn(nn.Module):
    """One convolution over the features, with dropout and a batch norm."""

    def __init__(self, inputs: int, classes: int, width: int = 4) -> None:
        super().__init__()
        self.width = width
        self.layers = nn.Sequential(
            nn.Unflatten(1, (1, inputs)),
            nn.Conv1d(1, width, 3, padding=1),
            nn.BatchNorm1d(width),
            nn.GELU(),
            nn.Dropout(0.1),
            nn.Flatten(),
            nn.Linear(width * inputs, classes),
        )

    def forward(self, features: Tensor) -> Tensor:
        return self.layers(features)


class Tied(nn.Module):
    """Two layers of one weight."""

    def __init__(self, inputs: int, classes: int) -> None:
        super().__init__()
        self.first, self.second = nn.Linear(inputs, inputs), nn.Linear(inputs, inputs)
        self.second.weight = self.first.weight
        self.last = nn.Linear(inputs, classes)

    def forward(self, features: Tensor) -> Tensor:
        return self.last(torch.relu(self.second(torch.relu(self.first(features)))))


def linear(inputs: int, classes: int) -> nn.Module:
    return nn.Linear(inputs, classes)

"""Balanced training: every class counts alike, however few scenes it has."""

import numpy as np
import pytest
import torch
from torch.nn.functional import cross_entropy

from conftest import generator
from deepfsi.datasets.arrays import from_arrays
from deepfsi.exposure.training_set import TrainingSet


def test_the_weighted_loss_is_that_of_scenes_repeated():
    """Scenes of two rare classes, shown two and four times: what weights 1, 2 and 4 are for."""
    labels = torch.tensor([0] * 8 + [1] * 4 + [2] * 2)
    logits = torch.randn(len(labels), 3, generator=generator())
    often = torch.tensor([1, 2, 4])[labels]
    repeated = cross_entropy(logits.repeat_interleave(often, 0), labels.repeat_interleave(often))
    pixels = np.random.default_rng(0).random((len(labels), 2, 2))
    data = from_arrays(pixels, labels.numpy(), pixels, labels.numpy())
    weights = TrainingSet(data, "cpu").class_weights
    weighted = cross_entropy(logits, labels, weights, reduction="sum") / len(labels)
    assert weighted.item() == pytest.approx(repeated.item(), rel=1e-6)

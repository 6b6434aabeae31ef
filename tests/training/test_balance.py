"""Balanced training: every class counts alike, however few scenes it has."""

import numpy as np
import pytest
import torch
from torch.nn import functional

from deepfsi.datasets import from_arrays
from deepfsi.exposure import TrainingSet

pytestmark = pytest.mark.usefixtures("trained_once")


def unbalanced(counts=(300, 6, 5)):
    """Classes of bright quarters under strong noise; the first has nearly all training scenes."""
    rng = np.random.default_rng(1)

    def scenes(sizes):
        labels = np.repeat(np.arange(len(sizes)), sizes)
        x = 0.6 * rng.random((len(labels), 4, 4))
        for place, label in enumerate(labels):
            row, column = divmod(int(label), 2)
            x[place, 2 * row : 2 * row + 2, 2 * column : 2 * column + 2] += 0.25
        return x, labels

    x, y = scenes(counts)
    return from_arrays(x, y, *scenes([60] * len(counts)), name="unbalanced")


def test_the_weighted_loss_is_that_of_scenes_repeated():
    """Scenes of two rare classes, shown two and four times: what weights 1, 2 and 4 are for."""
    labels = torch.tensor([0] * 8 + [1] * 4 + [2] * 2)
    logits = torch.randn(len(labels), 3, generator=torch.Generator().manual_seed(0))
    often = torch.tensor([1, 2, 4])[labels]
    repeated = functional.cross_entropy(
        logits.repeat_interleave(often, dim=0), labels.repeat_interleave(often)
    )
    pixels = np.random.default_rng(0).random((len(labels), 2, 2))
    data = from_arrays(pixels, labels.numpy(), pixels, labels.numpy())
    weights = TrainingSet(data, "cpu").class_weights
    weighted = functional.cross_entropy(logits, labels, weights, reduction="sum") / len(labels)
    assert weighted.item() == pytest.approx(repeated.item(), rel=1e-6)

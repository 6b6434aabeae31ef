"""Answers at each stop are those of the masks shown so far, and their confidence is measured."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from conftest import generator, quick
from deepfsi.design import answers
from deepfsi.optics.scanner import subtract


def test_logits_at_stops_are_those_of_the_first_masks(digits):
    """Over more scenes than are exposed at once; the last are those of `evaluate`."""
    nested = quick(digits, masks=10, nested=2, rails="single", light="free-dwell")
    x = np.tile(digits.x_test, (4, 1))
    logits = answers.logits_at_stops(nested, x, 1e3, 2, 3)
    draw, scanner = generator(3), nested.scanner()
    head = scanner.rates(torch.from_numpy(x)[:1024] / nested.summed_reflectance) * 1e3
    for place in range(2):
        features = subtract(scanner.read(head, draw))
        mine = logits[:, place:2048:2]
        with torch.no_grad():
            assert np.array_equal(mine[-1], nested.logits(features, 1e3).numpy())
            for masks in (2, 7):
                part = nested.first(masks)
                alone = part.logits(features[:, :masks], 1e3 * part.used).numpy()
                np.testing.assert_allclose(mine[masks - 2], alone, rtol=1e-4, atol=1e-4)
    assert logits.shape == (9, 8 * len(digits.x_test), 10)


def test_calibration_error_is_that_of_groups_written_out():
    confidence = np.repeat([0.5, 0.7, 1.0], 20 * answers.BINS)
    right = np.concatenate([np.tile([1, 0], 10 * answers.BINS), np.ones(40 * answers.BINS)])
    error = answers.calibration_error(answers.confidence_groups(confidence, right))
    assert error == pytest.approx((0 + 0.3 + 0) / 3)

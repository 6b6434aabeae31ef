"""Features are divided by their deviation in the batch."""

import pytest
import torch

from deepfsi.exposure.fixed import standardised
from deepfsi.exposure.training import standardise

of_a_batch = pytest.mark.parametrize("divided", [standardise, standardised])


@of_a_batch
@pytest.mark.parametrize("scale", ["each", "common"])
def test_features_that_do_not_vary_in_a_batch_are_0_and_have_finite_gradients(scale, divided):
    """As of detectors whose gates all click."""
    features = torch.zeros(50, 1, 3, requires_grad=True)
    scaled = divided(features, scale)
    scaled.sum().backward()
    assert (scaled == 0).all()
    assert features.grad.isfinite().all()

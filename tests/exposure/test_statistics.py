"""Features are divided by their deviation in the batch."""

import pytest
import torch

from deepfsi.exposure.fixed import standardised
from deepfsi.exposure.training import standardise

of_a_batch = pytest.mark.parametrize("divided", [standardise, standardised])


@of_a_batch
@pytest.mark.parametrize("scale", ["each", "common"])
def test_features_of_each_job_are_brought_to_a_mean_square_of_one_in_their_batch(scale, divided):
    """Each mask by itself, or all masks of a job by one factor."""
    features = torch.randn(50, 2, 3, generator=torch.Generator().manual_seed(1))
    features *= torch.tensor([[1.0, 2.0, 4.0], [30.0, 20.0, 10.0]])
    features -= features.mean(dim=0)
    over = 0 if scale == "each" else (0, 2)
    expected = features / features.square().mean(dim=over, keepdim=True).sqrt()
    assert torch.allclose(divided(features, scale), expected, rtol=1e-5, atol=1e-6)


@of_a_batch
@pytest.mark.parametrize("scale", ["each", "common"])
def test_features_that_do_not_vary_in_a_batch_are_0_and_have_finite_gradients(scale, divided):
    """As of detectors whose gates all click."""
    features = torch.zeros(50, 1, 3, requires_grad=True)
    scaled = divided(features, scale)
    scaled.sum().backward()
    assert (scaled == 0).all()
    assert features.grad.isfinite().all()

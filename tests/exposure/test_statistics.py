"""Features are divided by their deviation in the batch."""

import pytest
import torch

from deepfsi.exposure import training


@pytest.mark.parametrize("scale", ["each", "common"])
def test_features_of_each_job_are_brought_to_a_mean_square_of_one_in_their_batch(scale):
    """Each mask by itself, or all masks of a job by one factor; masks not shown count for none."""
    features = torch.randn(50, 2, 3, generator=torch.Generator().manual_seed(1))
    features *= torch.tensor([[1.0, 2.0, 4.0], [30.0, 20.0, 10.0]])
    features -= features.mean(dim=0)
    shown = torch.arange(3) < torch.arange(50).remainder(3).add(1)[:, None, None]
    for found, seen in (
        (training.standardise(features, scale), torch.ones(50, 1, 3)),
        (training.standardise(features, scale, shown), shown),
    ):
        over = 0 if scale == "each" else (0, 2)
        power = (features.square() * seen).sum(dim=over, keepdim=True)
        expected = features / (power / seen.sum(dim=over, keepdim=True)).sqrt()
        assert torch.allclose(found, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("scale", ["each", "common"])
@pytest.mark.parametrize("some", [False, True])
def test_features_that_do_not_vary_in_a_batch_are_0_and_have_finite_gradients(scale, some):
    """As of detectors whose gates all click."""
    features = torch.zeros(50, 1, 3, requires_grad=True)
    shown = torch.ones(50, 1, 3) if some else None
    scaled = training.standardise(features, scale, shown)
    scaled.sum().backward()
    assert (scaled == 0).all()
    assert features.grad.isfinite().all()

"""Inputs of an exposure, and images cut in blocks, row by row."""

import pytest
import torch

from deepfsi.base import InputError
from deepfsi.jobs import cut_patches
from deepfsi.physics import light_law


def test_an_image_that_cannot_be_cut_so_is_refused():
    with pytest.raises(InputError, match="divides both"):
        cut_patches(torch.zeros(1, 48), (6, 8), 4)


@pytest.mark.parametrize(
    ("light", "rails"), [("free-dwell", "single"), ("equal-dwell", "dual"), ("two-arm", "dual")]
)
def test_dwells_of_masks_share_the_exposure(made, light, rails):
    design = made("deepfsi", light, rails)
    dwells = design.exposure.mask_dwells()
    assert dwells.shape == (design.masks,)
    assert float(dwells.sum()) == pytest.approx(
        float(light_law(light).used(design.rails.stacked)[-1])
    )
    if light != "equal-dwell":
        brightest = design.rails.total.amax(dim=-1)
        expected = brightest if light == "two-arm" else design.rails.stacked.amax(dim=-1).sum(dim=0)
        torch.testing.assert_close(dwells, expected)

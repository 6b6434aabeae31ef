"""Inputs of an exposure, and images cut in blocks, row by row."""

import numpy as np
import pytest
import torch

from deepfsi.base import InputError
from deepfsi.design.exposure.trained import Observation, cut
from deepfsi.optics import constraints


def test_patches_are_the_blocks_of_the_image():
    image = np.arange(6 * 8).reshape(6, 8)
    blocks = [image[i : i + 2, j : j + 2].ravel() for i in range(0, 6, 2) for j in range(0, 8, 2)]
    scenes = torch.from_numpy(np.stack([image.ravel(), image.ravel()[::-1].copy()]))
    found = cut(scenes, (6, 8), 2)
    assert found.shape == (2, 12, 4)
    assert np.array_equal(found[0], np.stack(blocks))


def test_an_image_that_cannot_be_cut_so_is_refused():
    with pytest.raises(InputError, match="divides both"):
        cut(torch.zeros(1, 48), (6, 8), 4)


def test_an_exposure_says_what_it_has_seen():
    seen = Observation(torch.tensor([2.0, 0.0]), torch.tensor([0.75, 0.25]))
    inputs = seen.inputs(torch.tensor([1.0, 2.0]), torch.tensor([0.5, 0.5]))
    assert inputs.tolist() == [1.0, -2.0, 0.5, pytest.approx(0.5 / 3)]


@pytest.mark.parametrize(
    ("light", "rails"), [("free-dwell", "single"), ("equal-dwell", "dual"), ("two-arm", "dual")]
)
def test_dwells_of_masks_share_the_exposure(made, light, rails):
    design = made("deepfsi", light, rails)
    dwells = design.exposure.mask_dwells(design.rails, light, design.mean, design.std)
    assert dwells.shape == (design.masks,)
    assert float(dwells.sum()) == pytest.approx(
        float(constraints.used(design.rails.stacked, light)[-1])
    )
    if light != "equal-dwell":
        brightest = design.rails.total.amax(dim=-1)
        expected = brightest if light == "two-arm" else design.rails.stacked.amax(dim=-1).sum(dim=0)
        torch.testing.assert_close(dwells, expected)


def test_masks_of_split_light_have_no_dwells(made):
    design = made("deepfsi", "column", "dual")
    assert design.exposure.mask_dwells(design.rails, "column", design.mean, design.std) is None

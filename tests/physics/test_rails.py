"""Rails of masks: what difference, total and the rails themselves are of one another."""

import pytest
import torch

from conftest import generator
from deepfsi.physics.detection import Rails
from deepfsi.physics.laws import FixedMasks


@pytest.fixture(params=[1, 2])
def stacked(request) -> torch.Tensor:
    """Rails (3, 1 or 2, 4, 6) of three replicas, as two arms have them: no entry is 0."""
    return torch.rand(3, request.param, 4, 6, dtype=torch.float64, generator=generator())


def test_rails_come_back(stacked):
    """As they were given, to the last digit; of the sums alone but for rounding."""
    given = Rails.of(stacked)
    assert torch.equal(given.stacked, stacked)
    assert torch.equal(given.to("cpu").stacked, stacked)
    again = Rails(given.difference, given.total if given.count == 2 else None)
    assert torch.allclose(again.stacked, stacked, rtol=0, atol=1e-15)
    assert again.count == stacked.shape[1]


def test_a_change_is_one_of_difference_and_total(stacked):
    rails = Rails.of(stacked)
    part = rails.map(lambda masks: masks[1:])
    assert torch.equal(part.difference, rails.difference[1:])
    assert torch.equal(part.total, rails.total[1:])
    assert part.stacked.shape == (2, *stacked.shape[1:])
    summed = rails.map(torch.add, Rails.of(2 * stacked))
    assert torch.equal(summed.difference, 3 * rails.difference)
    assert torch.equal(summed.total, 3 * rails.total)


def test_rails_apart_are_frames_mask_by_mask(stacked):
    rails, count = Rails.of(stacked), stacked.shape[1]
    frames = rails.apart
    assert (frames.count, frames.masks) == (1, 4 * count)
    for rail, one in enumerate((rails.plus, rails.minus)[:count]):
        assert torch.equal(frames.difference[:, rail::count], one)


def test_fixed_masks_keep_their_rails(stacked):
    rails = FixedMasks(stacked).float()()
    assert rails.count == stacked.shape[1]
    assert rails.difference.dtype == torch.float32
    assert torch.allclose(rails.stacked, stacked.float(), rtol=0, atol=1e-6)

"""Rails of masks: what difference, total and the rails themselves are of one another."""

import pytest
import torch

from conftest import generator
from deepfsi.physics import FixedMasks, Rails

FLOAT64 = 1e-15


def rails_of(count: int) -> torch.Tensor:
    """Rails (3, count, 4, 6) of three replicas, as two arms have them: no entry is 0."""
    return torch.rand(3, count, 4, 6, dtype=torch.float64, generator=generator())


@pytest.mark.parametrize("count", [1, 2])
def test_rails_come_back(count):
    """As they were given, to the last digit; of the sums alone but for rounding."""
    stacked = rails_of(count)
    given = Rails.of(stacked)
    assert torch.equal(given.stacked, stacked)
    assert torch.equal(given.to("cpu").stacked, stacked)
    again = Rails(given.difference, given.total if count == 2 else None)
    assert torch.allclose(again.stacked, stacked, rtol=0, atol=FLOAT64)
    assert again.count == count


@pytest.mark.parametrize("count", [1, 2])
def test_a_change_is_one_of_difference_and_total(count):
    rails, other = Rails.of(rails_of(count)), Rails.of(2 * rails_of(count))
    part = rails.map(lambda masks: masks[1:])
    assert torch.equal(part.difference, rails.difference[1:])
    assert torch.equal(part.total, rails.total[1:])
    assert part.stacked.shape == (2, count, 4, 6)
    summed = rails.map(torch.add, other)
    assert torch.equal(summed.difference, 3 * rails.difference)
    assert torch.equal(summed.total, 3 * rails.total)


@pytest.mark.parametrize("count", [1, 2])
def test_rails_apart_are_frames_mask_by_mask(count):
    rails = Rails.of(rails_of(count))
    frames = rails.apart
    assert frames.count == 1
    assert frames.masks == 4 * count
    assert torch.equal(frames.difference[:, ::count], rails.plus)
    if count == 2:
        assert torch.equal(frames.difference[:, 1::2], rails.minus)


@pytest.mark.parametrize("count", [1, 2])
def test_fixed_masks_keep_their_rails(count):
    stacked = rails_of(count)
    rails = FixedMasks(stacked).float()()
    assert rails.count == count
    assert rails.difference.dtype == torch.float32
    assert torch.allclose(rails.stacked, stacked.float(), rtol=0, atol=1e-6)

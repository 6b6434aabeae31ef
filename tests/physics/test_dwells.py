"""Laws of dwells that a device can show."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from deepfsi.physics.laws import share_out

DWELLS = arrays(np.float64, (3, 7), elements=st.floats(1e-4, 1.0))
SHORTEST = st.floats(1e-6, 0.5)


@settings(max_examples=200, derandomize=True, deadline=None)
@given(DWELLS, SHORTEST)
def test_no_time_is_lost_and_as_many_frames_as_can_be_are_shown(dwell, shortest):
    """None is too short; of one more of those left out, one would be."""
    dwell /= dwell.sum(axis=-1, keepdims=True)
    shares = share_out(torch.from_numpy(dwell), shortest).numpy()
    np.testing.assert_allclose(shares.sum(axis=-1), 1, rtol=1e-12)
    assert ((shares == 0) | (shares >= shortest * (1 - 1e-6))).all()
    for asked, shown in zip(dwell, shares > 0, strict=True):
        assert shown[asked.argmax()]
        if not shown.all():
            longest = np.where(shown, -1, asked).argmax()
            assert asked[shown].min() >= asked[longest]
            more = asked[shown | (np.arange(7) == longest)]
            assert more.min() / more.sum() < shortest


def test_gradients_are_those_of_the_times_shared_out():
    dwell = torch.tensor([0.5, 0.25, 0.15, 0.1], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda d: share_out(d, 0.2), dwell)

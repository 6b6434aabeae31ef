"""No set of masks takes more light than its constraint allows, whatever training does to it."""

import math
import re

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from torch import Tensor

from conftest import FIXED, FLOAT32, OPTICS, every_optics, generator, two_valued
from deepfsi.base.errors import InputError
from deepfsi.jobs.designs import count_allowed, sensing_matrix
from deepfsi.physics.laws import ROUNDING_SLACK, LearnedMasks, frames, light_law, share_out


def signs_for(rails: str, matrix: Tensor) -> Tensor:
    return matrix if rails == "dual" else matrix.abs()


def positive(*shape: int) -> Tensor:
    return torch.rand(shape, generator=generator()) + 0.1


def fixed_matrix(design: str, digits) -> Tensor:
    low, high = count_allowed(design, digits)
    return torch.from_numpy(sensing_matrix(design, min(max(low, 9), high), digits)).float()


def limits(rails: Tensor, light: str) -> Tensor:
    """What the law bounds by 1, written once more from DESIGN.md."""
    if light == "column":
        return rails.sum(dim=(0, 1))
    if light == "dose":
        return rails.sum(dim=(0, 1)).mean().reshape(1)
    if light == "free-dwell":
        return sum(frame.max() for rail in rails for frame in rail).reshape(1)
    if light == "equal-dwell":
        lit = [frame for rail in rails for frame in rail if (frame > 0).any()]
        return torch.stack([frame.max() * len(lit) for frame in lit])
    plus, minus = rails
    time = (plus + minus).amax(dim=-1, keepdim=True)
    assert torch.allclose(plus + minus, time.expand_as(plus), rtol=1e-5, atol=1e-8)
    return time.sum().reshape(1)


@every_optics
@pytest.mark.parametrize("design", FIXED)
def test_fitted_designs_use_all_the_light_they_may(digits, design, light, rails):
    matrix = signs_for(rails, fixed_matrix(design, digits))
    fitted = light_law(light).fit(matrix, rails)
    assert fitted.min() >= 0
    assert limits(fitted, light).max() == pytest.approx(1, rel=FLOAT32)
    if light == "equal-dwell":  # every frame, to its own peak
        assert limits(fitted, light) == pytest.approx(torch.ones(len(frames(fitted))), rel=FLOAT32)
    if light == "two-arm":  # every mask sends all of some pixel's light to one arm
        contrast = (fitted[0] - fitted[1]).abs().amax(dim=-1) * len(matrix)
        assert contrast == pytest.approx(torch.ones(len(matrix)), rel=1e-4)


@every_optics
def test_dark_masks_stay_dark_and_obey(light, rails):
    """Also masks that start dark, but those of a law of the whole matrix, which has no unit."""
    law, dark = light_law(light), torch.zeros(3, 4)
    fitted = law.fit(dark, rails)
    assert not fitted.any()
    assert law.excess(fitted) <= 0
    if light in ("column", "dose"):
        with pytest.raises(InputError, match="0 everywhere"):
            LearnedMasks(dark, light, rails)
    else:
        assert torch.isfinite(LearnedMasks(dark, light, rails)().stacked).all()


@every_optics
def test_gradients_are_those_of_finite_differences(light, rails):
    law, signs = light_law(light), torch.arange(5) % 2 * 2 - 1
    weights = law.weights(signs_for(rails, positive(3, 5).double() * signs), rails)
    free = {k: v for k, v in weights.items() if v.requires_grad}
    with torch.no_grad():
        for tensor in free.values():  # away from the corner where all light is just used
            tensor.mul_(1.2)

    def stacked(*values: Tensor) -> Tensor:
        return law.project({**weights, **dict(zip(free, values, strict=True))}, rails).stacked

    assert torch.autograd.gradcheck(stacked, tuple(free.values()))


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.sampled_from(OPTICS), st.floats(-30, 30), st.integers(0, 999))
def test_any_free_numbers_obey(optics, size, seed):
    law, draws = light_law(optics[0]), generator(seed)
    weights = law.weights(torch.rand(4, 6, generator=draws) + 0.1, optics[1])
    wild = {
        name: 10**size * torch.randn(tensor.shape, generator=draws) * tensor.requires_grad
        + tensor.detach() * (not tensor.requires_grad)
        for name, tensor in weights.items()
    }
    rails = law.project(wild, optics[1]).stacked
    assert torch.isfinite(rails).all()
    assert law.excess(rails) <= ROUNDING_SLACK


def some_rails(light: str, rails: str) -> Tensor:
    """Three replicas of fitted rails, the last mask of them dark but on two arms."""
    start = signs_for(rails, torch.randn(3, 5, 16, generator=generator()))
    start[:, -1] = 0
    return torch.stack([light_law(light).fit(matrix, rails) for matrix in start])


@every_optics
@pytest.mark.parametrize("levels", [2, 3, 6, 769])
def test_quantised_rails_are_whole_steps_of_their_frames_peak_and_obey(light, rails, levels):
    steps = levels - 1
    before = some_rails(light, rails)
    shown = light_law(light).quantise(before, levels)
    peak = before.sum(dim=1, keepdim=True) if light == "two-arm" else shown
    peak = peak.amax(dim=-1, keepdim=True)
    share = steps * shown / torch.where(peak > 0, peak, 1.0)
    assert share == pytest.approx(share.round(), abs=steps * FLOAT32)
    assert share.amax() == pytest.approx(steps)
    for rails_before, rails_shown in zip(before, shown, strict=True):
        assert light_law(light).excess(rails_shown) <= ROUNDING_SLACK
        if light not in ("column", "dose"):  # which may have to be dimmed
            time = (before if light == "two-arm" else rails_before).amax() * (1 + FLOAT32)
            assert (rails_shown - rails_before).abs().max() <= time / (2 * steps)
    if levels == 2:
        assert two_valued(shown)


def test_column_is_mended_where_rounding_up_would_break_it():
    """Two frames at 0.6 of their peaks, which round up to both of them: 1.2 times the light."""
    before = torch.tensor([[[0.6, 1.0, 0.0], [0.6, 0.0, 1.0]]]) / 1.2
    shown = light_law("column").quantise(before, 2)
    assert torch.equal(shown, torch.tensor([[[0.5, 0.5, 0.0], [0.5, 0.0, 0.5]]]))
    with pytest.raises(InputError, match="grey levels are not allowed"):
        light_law("column").quantise(before, 1)


@every_optics
@pytest.mark.parametrize("levels", [2, 5])
def test_gradients_go_straight_through_the_rounding(light, rails, levels):
    """Whatever a loss asks of the quantised masks is asked of the continuous ones."""
    start = torch.rand(2, 4, 9, generator=generator()) - (0.5 if rails == "dual" else 0)
    asked = torch.randn(2, 2, 4, 9, generator=generator(1))
    shown, continuous = (LearnedMasks(start, light, rails, each) for each in (levels, 0))
    for masks in (shown, continuous):
        both = masks()
        (asked[0] * both.difference + asked[1] * both.total).sum().backward()
    for found, wanted in zip(shown.parameters(), continuous.parameters(), strict=True):
        assert found.grad.abs().max() > 0
        assert torch.allclose(found.grad, wanted.grad, rtol=1e-5, atol=1e-6)


@every_optics
def test_check_refuses_more_light_than_there_is_and_gives_the_factor(light, rails):
    law = light_law(light)
    fitted = law.fit(positive(4, 9), rails)
    law.check(fitted)
    with pytest.raises(InputError, match=f"breaks the {light} constraint"):
        law.check(fitted * 1.001)
    with pytest.raises(InputError, match=r"is 7\.3 times as bright") as caught:
        law.check(7.3 * fitted)
    factor = float(re.search("divide it by ([0-9.e+]+)", str(caught.value))[1])
    law.check(7.3 * fitted / factor)
    assert factor < 7.3 * 1.001
    for bad, words in ((-0.001, "negative"), (math.nan, "finite"), (math.inf, "finite")):
        fitted[0, 1, 2] = bad
        with pytest.raises(InputError, match=words):
            law.check(fitted)


@every_optics
@pytest.mark.parametrize("levels", [0, 2, 769])
@pytest.mark.parametrize("rate", [0.03, 3.0])
def test_learned_masks_obey_after_every_step(light, rails, rate, levels):
    """Two replicas chase far more light than there is, with small and absurd steps."""
    start = torch.randn(2, 6, 16, generator=generator())
    learned = LearnedMasks(signs_for(rails, start), light, rails, levels)
    target = 10 * torch.randn(2, 6, 16, generator=generator(1))
    optimiser = torch.optim.Adam(learned.parameters(), lr=rate)
    for _ in range(40):
        loss = (learned().difference - target).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        shown = learned()
        assert levels or torch.allclose(learned.matrix(), shown.difference, atol=1e-9)
        assert levels != 2 or two_valued(shown.stacked)
        for replica in shown.stacked.detach():
            assert torch.isfinite(replica).all()
            assert replica.min() >= 0
            assert limits(replica, light).max() <= 1 + ROUNDING_SLACK
            assert light_law(light).excess(replica) <= ROUNDING_SLACK


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


@every_optics
def test_the_first_masks_use_the_share_of_the_law_that_they_take_alone(light, rails):
    """Of masks none of which is dark; frames of equal dwells are a share of all frames."""
    law, matrix = light_law(light), torch.randn(6, 9, generator=generator())
    fitted = law.fit(signs_for(rails, matrix), rails)
    used = law.used(fitted)
    for count in range(1, 7):
        part = fitted[:, :count]
        whole = len(frames(part)) / len(frames(fitted))
        share = whole if light == "equal-dwell" else limits(part, light).max()
        assert float(used[count - 1]) == pytest.approx(float(share), rel=1e-5)
    assert torch.allclose(law.used(torch.stack([fitted, fitted / 2]))[0], used)

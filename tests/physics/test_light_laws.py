"""No set of masks takes more light than its constraint allows, whatever training does to it."""

import copy
import math
import re

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from torch import Tensor

from conftest import FIXED, FLOAT32, OPTICS, every_optics, generator, quick, two_valued
from deepfsi.base import InputError
from deepfsi.jobs import count_allowed, sensing_matrix
from deepfsi.physics import ROUNDING_SLACK, LearnedMasks, Rails, frames, light_law


def rails_of(masks: torch.nn.Module, rails: str) -> Tensor:
    return masks().stacked


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
    matrix = fixed_matrix(design, digits)
    if rails == "single":
        matrix = matrix.abs()
    fitted = light_law(light).fit(matrix, rails)
    assert fitted.min() >= 0
    assert limits(fitted, light).max() == pytest.approx(1, rel=FLOAT32)
    if light == "equal-dwell":  # every frame, to its own peak
        assert limits(fitted, light) == pytest.approx(torch.ones(len(frames(fitted))), rel=FLOAT32)
    if light == "two-arm":  # every mask sends all of some pixel's light to one arm
        contrast = (fitted[0] - fitted[1]).abs().amax(dim=-1) * len(matrix)
        assert contrast == pytest.approx(torch.ones(len(matrix)), rel=1e-4)


@every_optics
def test_gradients_are_those_of_finite_differences(light, rails):
    law, start = light_law(light), torch.rand(3, 5, generator=generator()).double() + 0.1
    weights = law.weights(
        start * (torch.arange(5) % 2 * 2 - 1) if rails == "dual" else start, rails
    )
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


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.sampled_from(OPTICS), st.integers(1, 40), st.integers(1, 12), st.integers(0, 999))
@example(("two-arm", "dual"), 34, 1, 0)
def test_any_matrix_fits_and_passes_the_check(optics, masks, pixels, seed):
    light, rails = optics
    matrix = torch.randn(masks, pixels, generator=generator(seed))
    light_law(light).check(light_law(light).fit(matrix if rails == "dual" else matrix.abs(), rails))


@every_optics
def test_rails_are_not_negative_and_recombine(digits, light, rails):
    matrix = fixed_matrix("pca", digits)
    fitted = light_law(light).fit(matrix if rails == "dual" else matrix.abs(), rails)
    assert fitted.min() >= 0
    given = Rails.of(fitted)
    again = given.map(torch.clone).stacked  # of difference and total alone
    assert torch.allclose(again, fitted, rtol=0, atol=1e-8)
    assert (given.difference.abs() <= given.total).all()


@every_optics
@pytest.mark.parametrize("levels", [0, 2])
def test_learned_masks_obey_in_every_step_of_a_training(digits, light, rails, levels, monkeypatch):
    snapshots = []

    def spied(take):
        def spy(module: LearnedMasks) -> Rails | Tensor:
            snapshots.append(copy.deepcopy(module))
            return take(module)

        return spy

    for name in ("forward", "matrix"):  # steps take the rails, or their difference alone
        monkeypatch.setattr(LearnedMasks, name, spied(getattr(LearnedMasks, name)))
    quick(digits, masks=5, light=light, rails=rails, mask_lr=0.5, epochs=2, levels=levels)
    monkeypatch.undo()
    assert len(snapshots) > 20
    for module in snapshots:
        split = module().stacked.detach()
        assert split.min() >= 0
        assert max(limits(replica, light).max() for replica in split) <= 1 + ROUNDING_SLACK
        if levels:
            assert two_valued(split)


def some_rails(light: str, rails: str) -> Tensor:
    """Three replicas of fitted rails, the last mask of them dark but on two arms."""
    start = torch.randn(3, 5, 16, generator=generator())
    start = start if rails == "dual" else start.abs()
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


@every_optics
@pytest.mark.parametrize("levels", [2, 8])
def test_replicas_are_quantised_as_if_alone(light, rails, levels):
    before = some_rails(light, rails)
    before[1] *= 0.1
    each = [light_law(light).quantise(one, levels) for one in before]
    assert torch.equal(light_law(light).quantise(before, levels), torch.stack(each))
    nested = light_law(light).quantise(before.view(3, 1, *before.shape[1:]), levels)
    assert torch.equal(nested[:, 0], torch.stack(each))


def test_column_is_mended_where_rounding_up_would_break_it():
    """Two frames at 0.6 of their peaks, which round up to both of them: 1.2 times the light."""
    before = torch.tensor([[[0.6, 1.0, 0.0], [0.6, 0.0, 1.0]]]) / 1.2
    shown = light_law("column").quantise(before, 2)
    assert torch.equal(shown, torch.tensor([[[0.5, 0.5, 0.0], [0.5, 0.0, 0.5]]]))


@pytest.mark.parametrize("levels", [1, 0, -1])
def test_a_device_needs_two_levels(levels):
    with pytest.raises(InputError, match="grey levels are not allowed"):
        light_law("column").quantise(torch.ones(1, 1, 2), levels)


@every_optics
@pytest.mark.parametrize("levels", [2, 5])
def test_gradients_go_straight_through_the_rounding(light, rails, levels):
    """They are those of the continuous masks, for what a loss asks of the quantised ones."""
    start = torch.rand(2, 4, 9, generator=generator()) - (0.5 if rails == "dual" else 0)
    shown, continuous = (LearnedMasks(start, light, rails, each) for each in (levels, 0))
    targets = torch.randn(2, 2, 4, 9, generator=generator(1))

    def sums(masks: LearnedMasks) -> tuple[Tensor, Tensor]:
        both = masks()
        return both.difference, both.total

    def loss(difference: Tensor, total: Tensor) -> Tensor:
        return (difference - targets[0]).pow(4).sum() + (total - targets[1]).pow(4).sum()

    quantised = sums(shown)
    loss(*quantised).backward()
    points = [each.detach().requires_grad_() for each in quantised]
    torch.autograd.backward(sums(continuous), torch.autograd.grad(loss(*points), points))
    elsewhere = [parameter.grad.clone() for parameter in continuous.parameters()]
    continuous.zero_grad()
    loss(*sums(continuous)).backward()
    for found, wanted, other in zip(
        shown.parameters(), elsewhere, continuous.parameters(), strict=True
    ):
        assert found.grad.abs().max() > 0
        assert torch.allclose(found.grad, wanted, rtol=1e-6)
        assert not torch.allclose(found.grad, other.grad, rtol=1e-3)


def test_a_start_without_light_is_refused():
    """Its scale is undefined under `column`, also where it is one of several replicas."""
    start = torch.stack([torch.ones(3, 4), torch.zeros(3, 4)])
    with pytest.raises(InputError, match="0 everywhere"):
        LearnedMasks(start, "column")


@every_optics
@pytest.mark.parametrize("levels", [0, 2])
def test_replicas_do_not_touch_each_other(light, rails, levels):
    start = torch.rand(3, 4, 9, generator=generator()) + 0.1
    together = LearnedMasks(start, light, rails, levels)()
    alone = LearnedMasks(start[1], light, rails, levels)()
    for whole, one in ((together.difference, alone.difference), (together.total, alone.total)):
        assert torch.allclose(whole.expand(3, 4, 9)[1], one, atol=1e-7)


@every_optics
def test_check_refuses_more_light_than_there_is(light, rails):
    matrix = torch.rand(4, 9, generator=generator()) + 0.1
    fitted = light_law(light).fit(matrix, rails)
    light_law(light).check(fitted)
    with pytest.raises(InputError, match=f"breaks the {light} constraint"):
        light_law(light).check(fitted * 1.001)


@every_optics
def test_too_bright_a_matrix_is_told_by_which_factor(light, rails):
    fitted = light_law(light).fit(torch.rand(4, 9, generator=generator()) + 0.1, rails)
    bright = 7.3 * fitted
    with pytest.raises(InputError, match=r"is 7\.3 times as bright") as caught:
        light_law(light).check(bright)
    factor = float(re.search("divide it by ([0-9.e+]+)", str(caught.value))[1])
    light_law(light).check(bright / factor)
    assert factor < 7.3 * 1.001


@every_optics
@pytest.mark.parametrize(
    ("bad", "words"), [(-0.001, "negative"), (math.nan, "finite"), (math.inf, "finite")]
)
def test_check_refuses_what_is_no_share(light, rails, bad, words):
    fitted = light_law(light).fit(torch.rand(4, 9, generator=generator()) + 0.1, rails)
    fitted[0, 1, 2] = bad
    with pytest.raises(InputError, match=words):
        light_law(light).check(fitted)


def test_two_arms_get_what_the_other_does_not():
    uneven = light_law("two-arm").fit(torch.randn(3, 8, generator=generator()))
    uneven[0, 1, 4] *= 0.5
    with pytest.raises(InputError, match="two-arm"):
        light_law("two-arm").check(uneven)


@every_optics
def test_the_first_masks_use_the_share_of_the_law_that_they_take_alone(light, rails):
    """Of masks none of which is dark; frames of equal dwells are a share of all frames."""
    law, matrix = light_law(light), torch.randn(6, 9, generator=generator())
    fitted = law.fit(matrix if rails == "dual" else matrix.abs(), rails)
    used = law.used(fitted)
    for count in range(1, 7):
        part = fitted[:, :count]
        whole = len(frames(part)) / len(frames(fitted))
        share = whole if light == "equal-dwell" else limits(part, light).max()
        assert float(used[count - 1]) == pytest.approx(float(share), rel=1e-5)
    assert torch.allclose(law.used(torch.stack([fitted, fitted / 2]))[0], used)


@every_optics
def test_free_numbers_begin_like_the_start(light, rails):
    """Where the law has one common factor, masks are the fitted start but for it; else patterns."""
    law, start = light_law(light), torch.rand(4, 9, generator=generator()) + 0.1
    weights = law.weights(start, rails)
    matrix = law.project(weights, rails).difference.detach()
    parts = start / start.amax(dim=-1, keepdim=True)
    shape = start if light in ("column", "dose") else parts
    assert torch.allclose(matrix / matrix.max(), shape / shape.max(), atol=1e-6)
    assert all(tensor.shape[-2:] == (4, 9) for name, tensor in weights.items() if name == "weight")


@every_optics
@pytest.mark.parametrize("levels", [0, 2, 769])
@pytest.mark.parametrize("rate", [0.03, 3.0])
def test_learned_masks_obey_after_every_step(light, rails, rate, levels):
    """Two replicas chase far more light than there is, with small and absurd steps."""
    start = torch.randn(2, 6, 16, generator=generator())
    learned = LearnedMasks(start if rails == "dual" else start.abs(), light, rails, levels)
    target = 10 * torch.randn(2, 6, 16, generator=generator(1))
    optimiser = torch.optim.Adam(learned.parameters(), lr=rate)
    for _ in range(40):
        loss = (learned().difference - target).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        for replica in learned().stacked.detach():
            assert torch.isfinite(replica).all()
            assert replica.min() >= 0
            assert limits(replica, light).max() <= 1 + ROUNDING_SLACK
            assert light_law(light).excess(replica) <= ROUNDING_SLACK


def test_learned_column_masks_start_from_the_fitted_matrix(digits):
    matrix = fixed_matrix("pca", digits)
    assert torch.allclose(
        rails_of(LearnedMasks(matrix, "column"), "dual"), light_law("column").fit(matrix)
    )


@every_optics
def test_the_light_of_a_start_does_not_matter(light, rails):
    matrix = torch.rand(4, 9, generator=generator()) + 0.1
    law = light_law(light)
    assert torch.allclose(law.fit(7 * matrix, rails), law.fit(matrix, rails))
    small, large = (law.project(law.weights(k * matrix, rails), rails) for k in (0.01, 100))
    assert torch.allclose(small.stacked, large.stacked, rtol=1e-5)


@pytest.mark.parametrize("factor", [1.5, 10.0])
@pytest.mark.parametrize("kind", ["single", "dual"])
def test_masks_that_learn_under_a_dose_take_all_of_it(kind, factor):
    """From weights that are too bright they are divided until the mean over pixels is 1."""
    start = torch.rand(1, 3, 16, generator=torch.Generator().manual_seed(0)) + 0.1
    masks = LearnedMasks(start, "dose", kind)
    with torch.no_grad():
        for weight in masks.parameters():
            weight *= factor
        sums = masks().total.sum(dim=-2)
    assert float(sums.mean()) == pytest.approx(1, rel=1e-5)

"""Photons, dark counts and read noise together, and a noise of one's own: moments and gradients."""

import math

import pytest
import torch
from torch import Tensor

from conftest import assert_moments, generator, quick
from deepfsi import Scanner
from deepfsi.base import InputError
from deepfsi.physics import LearnedMasks, Rails, detection, noise
from shared.noises import exact, saturating, training_noise

DRAWS = 50_000
SIGMA, DARK = 3.0, 40.0

PLUS = torch.tensor([[0.5, 0.0], [0.25, 0.2], [0.0, 0.0], [0.0, 0.0]], dtype=torch.float64)
MINUS = torch.tensor([[0.0, 0.25], [0.0, 0.0], [0.25, 0.5], [0.0, 0.0]], dtype=torch.float64)
RAILS = torch.stack([PLUS, MINUS])
"""Both rails of a mask are lit, one alone, the other alone, and none."""

TIMES = torch.tensor([[0.5, 0.25, 0.0, 0.0], [0.25, 0.0, 0.5, 0.0]], dtype=torch.float64)
"""Shares of the exposure, by hand."""


@pytest.mark.parametrize("rate", [0, 1e-3, 1, 1e3, 1e7])
@pytest.mark.parametrize("dark", [0.0, 0.3, 50.0])
@pytest.mark.parametrize("sigma", [0.0, 0.5, 7.0])
def test_variance_is_that_of_light_dark_counts_and_read_noise(rate, dark, sigma):
    rates = torch.full((DRAWS,), rate, dtype=torch.float64)
    counts = noise.make_noise("camera", sigma=sigma).draw(rates, generator(), dark)
    assert_moments(counts, rate, rate + dark + sigma**2, poisson=True, rounding=0.5 * (rate > 1e6))


@pytest.mark.parametrize("light", [0.0, 30.0, 1e4])
def test_each_readout_has_dark_counts_for_its_time(light):
    photons = torch.tensor([light, 2 * light], dtype=torch.float64)
    counts = Scanner.from_rails(RAILS, "camera", SIGMA, DARK).counts(
        photons.expand(DRAWS, 2), generator()
    )
    lit = RAILS.amax(dim=-1) > 0
    power = RAILS @ photons + (DARK * TIMES + SIGMA**2) * lit
    for rail in range(2):
        for mask in range(4):
            mean = float(RAILS[rail, mask] @ photons)
            assert_moments(
                counts[:, rail, mask], mean, float(power[rail, mask]), poisson=True, rounding=1e-9
            )


@pytest.mark.parametrize("light", ["column", "free-dwell", "two-arm"])
def test_masks_follow_mean_and_variance(light):
    """E[y²] = μ² + L with L of light, dark counts and read noise: its slope in every weight."""
    start = torch.randn(3, 5, dtype=torch.float64, generator=generator(2))
    masks = LearnedMasks(start, light)
    scene = torch.linspace(1, 5, 5, dtype=torch.float64)
    scanner = Scanner(masks, "camera", SIGMA, DARK)

    shown = masks()
    read = detection.SINGLE_DETECTION.readouts(shown)
    power = shown.total @ scene + DARK * read.time.sum(dim=0) + SIGMA**2 * read.lit
    wanted = torch.autograd.grad(
        ((shown.difference @ scene) ** 2 + power).sum(), list(masks.parameters())
    )

    batches = []
    for seed in range(40):
        features = scanner(scene.expand(2000, 5), generator(seed))
        loss = features.square().sum(dim=1).mean()
        grads = torch.autograd.grad(loss, list(masks.parameters()))
        batches.append(torch.cat([each.flatten() for each in grads]))
    found = torch.stack(batches)
    error = found.std(dim=0) / math.sqrt(len(found))
    exact = torch.cat([each.flatten() for each in wanted])
    # of 40 batches the error itself is known to a ninth; five and a half of them
    assert ((found.mean(dim=0) - exact).abs() <= 5.5 * error + 1e-9).all()
    assert (exact.abs() > 1e-3).any()


@pytest.mark.parametrize("kind", ["poisson", "camera"])
def test_training_draws_what_the_scanner_does(kind):
    """Counted features of a step, two trainings side by side, against the law of each."""
    gains, sigmas, darks = [50.0, 200.0], [2.0, 5.0], [30.0, 10.0]
    drawn = training_noise(kind, gains, sigmas, [0, 1], torch.device("cpu"), darks)
    rails = Rails.of(RAILS.unsqueeze(0))
    scene = torch.tensor([0.4, 0.9], dtype=torch.float64)
    mean, light = (each @ scene for each in (rails.difference, rails.total))  # (1, 4)
    read = detection.SINGLE_DETECTION.readouts(rails)
    features = drawn.counted(mean.expand(DRAWS, 2, 4), light.expand(DRAWS, 2, 4), read)
    lit = (RAILS.amax(dim=-1) > 0).sum(dim=0)
    for job, gain in enumerate(gains):
        besides = darks[job] * TIMES.sum(dim=0) + sigmas[job] ** 2 * lit
        power = light[0] * gain + (besides if kind == "camera" else 0)
        for mask in range(4):
            assert_moments(
                features[:, job, mask] * gain, float(mean[0, mask] * gain), float(power[mask]),
                poisson=True, rounding=1e-4,
            )  # fmt: skip
        assert torch.allclose(
            drawn.variance(mean, light, read)[job], (power / gain**2).float().double()
        )


@pytest.mark.parametrize("kind", ["poisson", "camera"])
def test_training_follows_mean_light_and_time(kind):
    """E[y²] = μ² + (L + σ² / Φ + d / Φ) / Φ a feature: slopes 2 μ in μ, 1 / Φ in L and in d / Φ."""
    gain, dark = 50.0, 30.0
    noisy = training_noise(kind, [gain], [4.0], [0], torch.device("cpu"), [dark])
    rails = Rails.of(RAILS[:, :2].unsqueeze(0))
    read = detection.SINGLE_DETECTION.readouts(rails)
    read = read._replace(time=read.time.clone().requires_grad_())
    scene = torch.tensor([0.4, 0.9], dtype=torch.float64)
    mean, light = (
        (each @ scene).expand(DRAWS, 1, 2).clone().requires_grad_()
        for each in (rails.difference, rails.total)
    )
    noisy.counted(mean, light, read).square().sum().backward()
    for mask in range(2):
        by_mean, by_light = mean.grad[:, 0, mask], light.grad[:, 0, mask]
        for found, wanted in ((by_mean, 2 * mean[0, 0, mask].item()), (by_light, 1 / gain)):
            assert abs(found.mean() - wanted) <= 5 * float(found.std()) / math.sqrt(DRAWS)
        if kind == "camera":
            slope, error = 1 / gain, 5 * float(by_light.std()) / math.sqrt(DRAWS)
            by_time = float(read.time.grad[0, 0, mask]) / DRAWS  # through d = D t
            assert abs(by_time - slope * dark / gain) <= error * dark / gain


def test_a_noise_of_ones_own_is_drawn_for_each_rail():
    scene = torch.tensor([600.0, 900.0], dtype=torch.float64)
    for own in (saturating, "shared.noises:saturating"):
        scanner = Scanner.from_rails(RAILS, own)
        assert scanner.noise.name == "shared.noises:saturating"
        counts = scanner.counts(scene.expand(DRAWS, 2), generator())
        rates = RAILS @ scene
        seen = rates / (1 + rates / 1000)
        for rail in range(2):
            for mask in range(4):
                mean = float(seen[rail, mask])
                assert_moments(counts[:, rail, mask], mean, mean, poisson=False, rounding=1e-9)
    features = scanner(scene.expand(DRAWS, 2), generator())
    assert_moments(
        features[:, 0], float(seen[0, 0] - seen[1, 0]), float(seen[:, 0].sum()),
        poisson=False, rounding=1e-9,
    )  # fmt: skip


def no_tensor(rates: Tensor, generator: torch.Generator | None) -> object:
    return rates.tolist()


def infinite(rates: Tensor, generator: torch.Generator | None) -> Tensor:
    return rates / 0


@pytest.mark.parametrize(
    ("own", "match"),
    [
        (exact, "no gradient in the rates"),
        (lambda rates: rates, "cannot be used"),
        (lambda rates, generator: rates[:, :1], "of the shape of the rates"),
        (infinite, "no finite counts"),
        (no_tensor, "cannot be used"),
        ("shared.noises:no_such", "has no no_such"),
        ("no_such_module:noise", "No module named"),
        ("camrea", "did you mean 'camera'"),
    ],
)
def test_what_is_no_noise_is_refused_in_one_line(digits, own, match):
    with pytest.raises(InputError, match=match) as error:
        quick(digits, noise=own)
    assert "\n" not in str(error.value)

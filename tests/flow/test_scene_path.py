"""Scenes that pass a pattern, held against explicit shifts of the scene."""

import numpy as np
import pytest
import torch

from conftest import FLOAT32, assert_moments, generator
from deepfsi.physics.laws import ROUNDING_SLACK, light_law
from deepfsi_flow.exposure import FixedPattern, LearnedPattern, ScenePath, in_levels

FINE = 4
"""Steps of a pixel at which scenes are shifted explicitly."""

PATHS = [
    ScenePath((3, 5), 11, 6, 1.0),
    ScenePath((3, 5), 11, 7, 0.5),
    ScenePath((3, 5), 4, 6, 1.5),  # a pattern narrower than the scene, which it enters and leaves
    ScenePath((2, 4), 30, 6, 4.5),
    ScenePath((1, 1), 6, 6, 1.0),
]
every_path = pytest.mark.parametrize("path", PATHS, ids=str)


def pattern_of(path: ScenePath, seed: int = 0) -> torch.Tensor:
    size = path.shape[0], path.width
    return torch.rand(size, generator=generator(seed), dtype=torch.float64)


def explicit(path: ScenePath, pattern: torch.Tensor, scene: torch.Tensor, delay: int = 0):
    """Share of a scene's light (T,) in each bin, of a scene moved in steps of 1 / FINE pixels."""
    wide = np.repeat(pattern.numpy(), FINE, axis=1)
    fine = np.repeat(scene.reshape(path.shape).numpy(), FINE, axis=1) / FINE
    height, width = fine.shape
    dark = np.zeros((height, 2 * width + 40 * FINE))
    ground = np.concatenate([dark, wide, dark], axis=1)
    middle = dark.shape[1] + (wide.shape[1] - width) / 2 + delay
    rates = []
    for t in range(path.bins):
        first, last = (middle + FINE * path.speed * (k - path.bins / 2) for k in (t, t + 1))
        assert first.is_integer()
        places = np.arange(int(first), int(last) + 1)
        light = [(ground[:, p : p + width] * fine).sum() for p in places]
        rates.append(np.trapezoid(light) / (len(places) - 1))  # C is linear between
    return np.array(rates) / path.bins


@every_path
def test_the_matrix_is_that_of_explicit_shifts_of_the_scene(path):
    pattern, matrix = pattern_of(path), path.matrix(pattern_of(path)).numpy()
    pixels = path.shape[0] * path.shape[1]
    for seed in range(3):
        scene = torch.rand(pixels, generator=generator(seed + 9), dtype=torch.float64)
        assert matrix @ scene.numpy() == pytest.approx(explicit(path, pattern, scene), abs=1e-6)


@pytest.mark.parametrize("delay", [-9, -1, 3, 40])
def test_a_displaced_scene_counts_as_one_that_is_displaced_explicitly(delay):
    path = PATHS[0]
    pattern = pattern_of(path)
    scene = torch.rand(15, generator=generator(3), dtype=torch.float64)
    edges = path.edges((), None, torch.device("cpu")) + delay / FINE
    found = path.means(path.every_shift(pattern) @ scene, edges) / path.bins
    assert found.numpy() == pytest.approx(explicit(path, pattern, scene, delay), abs=1e-6)


@every_path
def test_photons_are_conserved_at_every_place_and_speed(path):
    shaken = ScenePath(path.shape, path.width, path.bins, path.speed, 3.0, 0.2)
    scene = torch.rand(path.shape[0] * path.shape[1], generator=generator())
    open_, grey = (torch.ones(path.shape[0], path.width), pattern_of(path).float())
    edges = shaken.edges((500,), generator(1), scene.device)
    for pattern in (open_, grey):
        counts = shaken.means((shaken.every_shift(pattern) @ scene).expand(500, -1), edges)
        assert (counts >= 0).all()
        assert (counts.sum(dim=-1) / path.bins).max() <= scene.sum() * (1 + 10 * FLOAT32)
        rails = path.matrix(pattern).unsqueeze(0)
        for law in ("equal-dwell", "free-dwell", "column"):
            assert light_law(law).excess(rails) <= ROUNDING_SLACK


def test_place_and_speed_jitter_as_they_say():
    path = ScenePath((2, 4), 40, 8, 1.5, jitter=2.0, speed_jitter=0.1)
    edges = path.edges((40_000,), generator(), torch.device("cpu"))
    middle, speed = edges[:, 4], edges.diff(dim=-1)
    assert_moments(middle - 22, 0, 4, poisson=False, rounding=1e-4)
    assert_moments(speed[:, 0], 1.5, 0.15**2, poisson=False, rounding=1e-4)
    assert torch.allclose(speed, speed[:, :1].expand_as(speed), atol=1e-4)  # one in an exposure
    independent = ((middle - 22) * (speed[:, 0] - 1.5)).mean().abs()
    assert independent < 5 * 2 * 0.15 / 200


def test_jitter_of_the_place_smooths_the_mean_counts_and_adds_their_variance():
    """On a ramp of the pattern a displacement by d changes a rate by slope · d."""
    path = ScenePath((1, 1), 101, 4, 1.0, jitter=2.0)
    ramp = torch.linspace(0, 1, 101).unsqueeze(0)
    edges = path.edges((40_000,), generator(), ramp.device)
    counts = path.means(path.every_shift(ramp)[:, 0].expand(40_000, -1), edges)
    still = path.matrix(ramp)[:, 0] * 4
    assert_moments(counts[:, 1], float(still[1]), (2 * 0.01) ** 2, poisson=False, rounding=1e-5)


@pytest.mark.parametrize("delay", [0.0, 0.37])
def test_the_gradient_of_the_pattern_is_that_of_finite_differences(delay):
    path = PATHS[1]
    scenes = torch.rand(4, 15, generator=generator(2), dtype=torch.float64)
    edges = path.edges((4,), None, torch.device("cpu")) + delay

    def counts(pattern):
        return path.means(scenes @ path.every_shift(pattern).T, edges)

    assert torch.autograd.gradcheck(counts, (pattern_of(path).requires_grad_(),), eps=1e-5)
    assert torch.autograd.gradcheck(path.matrix, (pattern_of(path).requires_grad_(),), eps=1e-5)


def test_a_learned_pattern_stays_between_dark_and_open_and_learns_through_levels():
    path = PATHS[0]
    start = 4 * torch.randn(2, 3, 11, generator=generator())
    grey, binary = LearnedPattern(start.clone(), path), LearnedPattern(start.clone(), path, 2)
    weights = torch.rand(2, 3, 11, generator=generator(1))
    for pattern in (grey, binary):
        assert ((pattern.pattern >= 0) & (pattern.pattern <= 1)).all()
        (pattern.pattern * weights).sum().backward()
    assert set(binary.pattern.unique().tolist()) == {0.0, 1.0}
    assert torch.equal(binary.weight.grad, grey.weight.grad)
    fixed = FixedPattern(binary.pattern.detach(), path)
    assert torch.allclose(fixed().stacked, binary().stacked)
    assert fixed().stacked.shape == (2, 1, 6, 15)
    assert in_levels(torch.tensor([0.0, 0.2, 0.3, 1.0]), 3).tolist() == [0, 0, 0.5, 1]

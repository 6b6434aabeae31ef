"""Measures of masks: exact values where these are known, and what must not change them."""

import math

import numpy as np
import pytest
import torch

from deepfsi.camera.light import photons_per_pixel, summed_reflectance
from deepfsi.jobs.designs import sensing_matrix
from deepfsi.physics import noise as noise_module
from deepfsi_paper import measures
from deepfsi_paper.measures import matched_similarity


def orthonormal(rows: int, pixels: int, seed: int = 0) -> np.ndarray:
    square = np.random.default_rng(seed).normal(size=(pixels, pixels))
    return np.linalg.qr(square)[0][:rows]


def disguised(masks: np.ndarray, seed: int = 1) -> np.ndarray:
    """Return the same masks in another order, with other signs and another scale each."""
    rng = np.random.default_rng(seed)
    factors = rng.choice([-1.0, 1.0], len(masks)) * rng.uniform(0.1, 10, len(masks))
    return (factors[:, None] * masks)[rng.permutation(len(masks))]


def test_throughput_of_designs_that_are_known(digits):
    scene = digits.x_train.mean(axis=0)
    for name, peak, share in (("impulse", 1, 1), ("raster", 1, 1 / 64), ("hadamard", 64, 1)):
        masks = sensing_matrix(name, 64, digits) / peak
        assert measures.throughput(masks, scene) == pytest.approx(share)


@pytest.mark.parametrize("light", ["column", "free-dwell"])
def test_throughput_is_the_share_that_the_finished_design_counts(made, digits, light):
    design = made("deepfsi", light, "dual")
    counted = float(design.exposure.shares.sum())
    scene = digits.x_train.mean(axis=0, dtype=np.float64)
    assert measures.throughput(design.matrix, scene) == pytest.approx(counted, rel=1e-5)


def test_a_weak_direction_counts_for_part_of_one():
    strengths = np.array([3.0, 1.0])
    expected = math.exp(-(0.75 * math.log(0.75) + 0.25 * math.log(0.25)))
    found = measures.effective_directions(strengths[:, None] * orthonormal(2, 9))
    assert found == pytest.approx(expected)
    assert 1 < found < 2


def test_order_signs_and_scales_do_not_matter_to_similarity():
    masks = np.random.default_rng(3).normal(size=(7, 30))
    assert matched_similarity(masks, disguised(masks)) == pytest.approx(1)
    other = np.random.default_rng(4).normal(size=(9, 30))
    assert matched_similarity(masks, other) < 0.9
    assert matched_similarity(disguised(masks), other) == pytest.approx(
        matched_similarity(masks, other)
    )
    assert matched_similarity(other, masks) == pytest.approx(matched_similarity(masks, other))


def test_similarity_is_the_share_of_masks_in_common():
    basis = orthonormal(12, 12)
    assert matched_similarity(basis[:6], disguised(basis[4:10])) == pytest.approx(2 / 6)
    assert matched_similarity(basis[:3], disguised(basis[:8])) == pytest.approx(1)


@pytest.mark.parametrize(("noise", "sigma"), [("poisson", 1.0), ("gaussian", 1.0), ("gaussian", 4)])
@pytest.mark.parametrize("budget", [1e3, 1e6])
def test_noise_axis_is_the_error_of_impulse_imaging(digits, noise, sigma, budget):
    light = summed_reflectance(digits.x_train)
    x = torch.from_numpy(digits.x_train).double()
    generator = torch.Generator().manual_seed(0)
    counts = noise_module.make_noise(noise, sigma=sigma).draw(
        photons_per_pixel(x, budget, light), generator
    )
    squares = (counts * light / budget - x).square()
    drawn = math.sqrt(squares.mean())
    worth = measures.impulse_imaging_error(budget, light / 64, 64, noise, sigma)
    five_sigma = 5 * float(squares.std()) / math.sqrt(squares.numel()) / (2 * worth)
    assert drawn == pytest.approx(worth, abs=five_sigma)

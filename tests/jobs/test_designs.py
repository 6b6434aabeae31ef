"""Each named design is the matrix that DESIGN.md says."""

import itertools
import math

import numpy as np
import pytest

from conftest import FIXED
from deepfsi.base import InputError
from deepfsi.jobs import (
    DESIGNS,
    check_count,
    count_allowed,
    designs,
    hadamard_masks,
    mask_count,
    sensing_matrix,
)


def sequencies(mask: np.ndarray) -> tuple[int, int]:
    """Sign changes down and across a mask (H, W)."""
    down, across = (np.diff(mask, axis=axis) != 0 for axis in (0, 1))
    return int(down.sum(axis=0).max()), int(across.sum(axis=1).max())


def test_walsh_functions_change_sign_as_often_as_their_number():
    rows = designs.sequency_hadamard(32)
    assert (rows @ rows.T == 32 * np.eye(32)).all()
    assert ((np.diff(rows, axis=1) != 0).sum(axis=1) == np.arange(32)).all()


@pytest.mark.parametrize("shape", [(8, 8), (4, 16), (16, 4)])
def test_truncated_hadamard_has_the_lowest_sequencies_in_order(shape):
    masks = hadamard_masks(shape, math.prod(shape)).reshape(-1, *shape)
    found = [sequencies(mask) for mask in masks]
    every = [(i, j) for i in range(shape[0]) for j in range(shape[1])]
    assert found == sorted(every, key=lambda ij: (ij[0] + ij[1], max(ij), ij[0]))


@pytest.mark.parametrize("shape", [(12, 10), (3, 8), (5, 1)])
def test_padded_hadamard_is_the_whole_basis_seen_through_the_scene(shape):
    padded = tuple(2 ** math.ceil(math.log2(side)) for side in shape)
    assert designs.padded_shape(shape) == padded
    order = math.prod(padded)
    whole = hadamard_masks(padded, order).reshape(-1, *padded)
    seen = whole[:, : shape[0], : shape[1]].reshape(order, -1)
    assert (hadamard_masks(shape, order) == seen).all()


@pytest.mark.parametrize("pixels", [3, 7, 11, 59])
def test_s_matrix_identity(pixels):
    """S Sᵀ = (p + 1)/4 (I + J), with (p + 1)/2 ones in every row."""
    s = designs.s_matrix(pixels)
    quarter = (pixels + 1) // 4
    assert (s @ s.T == quarter * (np.eye(pixels) + 1)).all()
    assert (s.sum(axis=1) == 2 * quarter).all()
    assert set(np.unique(s)) == {0, 1}


@pytest.mark.parametrize(("pixels", "order"), [(1, 3), (4, 7), (8, 11), (64, 67)])
def test_s_matrix_pads_to_a_prime_three_above_a_multiple_of_four(pixels, order):
    assert designs.s_matrix_order(pixels) == order
    s = designs.s_matrix(pixels)
    assert s.shape == (order, pixels)
    assert np.linalg.matrix_rank(s) == pixels
    assert designs.s_matrix_order(1024) == 1031


def test_principal_components_are_orthonormal_and_ordered(digits):
    rows = sensing_matrix("pca", 64, digits)
    assert np.allclose(rows @ rows.T, np.eye(64), atol=1e-10)
    power = np.var(digits.x_train.astype(float) @ rows.T, axis=0)
    assert (np.diff(power) <= 1e-12).all()


@pytest.mark.parametrize("scenes", [1, 2, 5])
def test_principal_components_are_completed_where_data_has_too_few(scenes):
    x = np.random.default_rng(0).random((scenes, 12)).astype(np.float32)
    rows = designs.principal_components(x, 12)
    assert np.allclose(rows @ rows.T, np.eye(12), atol=1e-10)
    centred = x - x.mean(axis=0)
    assert np.allclose(rows[max(scenes - 1, 0) :] @ centred.T, 0, atol=1e-6)
    assert (rows == designs.principal_components(x, 12)).all()
    assert np.allclose(designs.principal_components(x, 7), rows[:7])


def test_discriminants_separate_classes_better_than_components(digits):
    def ratio(rows: np.ndarray) -> float:
        features = digits.x_train.astype(float) @ rows.T
        means = np.stack([features[digits.y_train == c].mean(axis=0) for c in range(10)])
        within = features - means[digits.y_train]
        return float(np.trace(np.linalg.solve(np.cov(within.T), np.cov(means.T))))

    lda = sensing_matrix("lda", 9, digits)
    assert np.allclose(np.linalg.norm(lda, axis=1), 1)
    assert ratio(lda) > ratio(sensing_matrix("pca", 9, digits))


def test_class_pairs_are_differences_of_means_the_nearest_first(digits):
    means = [digits.x_train[digits.y_train == c].mean(axis=0, dtype=float) for c in range(10)]
    gaps = [means[a] - means[b] for a, b in itertools.combinations(range(10), 2)]
    rows = sensing_matrix("class-pairs", 50, digits)
    for row, gap in zip(rows, sorted(gaps, key=np.linalg.norm), strict=False):
        assert np.linalg.norm(row) == pytest.approx(1)
        assert row @ gap == pytest.approx(np.linalg.norm(gap))
    assert np.allclose(rows[45:], sensing_matrix("pca", 5, digits))


@pytest.mark.parametrize(
    ("ratio", "pixels", "masks"),
    [(0.09, 1024, 92), (0.04, 1024, 41), (0.01, 1024, 10), (1, 1024, 1024), (1e-9, 64, 1)],
)
def test_mask_count_is_rounded_and_at_least_one(ratio, pixels, masks):
    assert mask_count(ratio, pixels) == masks


@pytest.mark.parametrize(
    ("design", "masks"),
    [
        ("impulse", 63),
        ("raster", 65),
        ("hadamard", 10),
        ("s-matrix", 64),
        ("truncated-hadamard", 65),
        ("pca", 65),
        ("lda", 10),
        ("random", 0),
        ("deepfsi", -1),
        ("pca", 10.5),
        ("pca", math.nan),
        ("pca", True),
    ],
)
def test_a_design_refuses_a_count_that_it_cannot_have(digits, design, masks):
    with pytest.raises(InputError, match=f"masks are not allowed for {design} on digits: give"):
        check_count(design, masks, digits)


@pytest.mark.parametrize("design", FIXED)
def test_every_allowed_count_gives_that_many_masks(design, digits):
    for masks in count_allowed(design, digits):
        matrix = sensing_matrix(design, masks, digits)
        assert matrix.shape == (masks, 64)
        assert np.isfinite(matrix).all()
        assert DESIGNS[design].rails != "single" or matrix.min() >= 0


def test_principal_components_hold_the_most_variance(digits):
    rows = sensing_matrix("pca", 5, digits)
    centred = digits.x_train.astype(float) - digits.x_train.mean(axis=0, dtype=float)
    best = (np.linalg.svd(centred, compute_uv=False)[:5] ** 2).sum()
    assert ((centred @ rows.T) ** 2).sum() == pytest.approx(best)

"""Each named design is the matrix that DESIGN.md says."""

import itertools
import math

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi.jobs import designs
from deepfsi.jobs.designs import check_count, hadamard_masks, mask_count, sensing_matrix


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


@pytest.mark.parametrize(("pixels", "order"), [(1, 3), (4, 7), (11, 11), (59, 59), (64, 67)])
def test_s_matrix_is_one_of_a_prime_three_above_a_multiple_of_four(pixels, order):
    """S Sᵀ = (p + 1)/4 (I + J), with (p + 1)/2 ones in every row, of all p pixels."""
    assert designs.s_matrix_order(pixels) == order
    s, quarter = designs.s_matrix(order), (order + 1) // 4
    assert (s @ s.T == quarter * (np.eye(order) + 1)).all()
    assert (s.sum(axis=1) == 2 * quarter).all()
    assert set(np.unique(s)) == {0, 1}
    padded = designs.s_matrix(pixels)
    assert padded.shape == (order, pixels)
    assert np.linalg.matrix_rank(padded) == pixels


def test_principal_components_are_orthonormal_and_ordered(digits):
    """Some of them hold the most variance that so many can."""
    rows = sensing_matrix("pca", 64, digits)
    assert np.allclose(rows @ rows.T, np.eye(64), atol=1e-10)
    x = digits.x_train.astype(float)
    power = np.var(x @ rows.T, axis=0)
    assert (np.diff(power) <= 1e-12).all()
    best = np.linalg.svd(x - x.mean(axis=0), compute_uv=False)[:5] ** 2
    few = sensing_matrix("pca", 5, digits)
    assert np.var(x @ few.T, axis=0).sum() * len(x) == pytest.approx(best.sum())


@pytest.mark.parametrize("scenes", [1, 2, 5])
def test_principal_components_are_completed_where_data_has_too_few(scenes):
    x = np.random.default_rng(0).random((scenes, 12)).astype(np.float32)
    rows = designs.principal_components(x, 12)
    assert np.allclose(rows @ rows.T, np.eye(12), atol=1e-10)
    centred = x - x.mean(axis=0)
    assert np.allclose(rows[max(scenes - 1, 0) :] @ centred.T, 0, atol=1e-6)
    assert (rows == designs.principal_components(x, 12)).all()
    assert np.allclose(designs.principal_components(x, 7), rows[:7])


def test_class_pairs_are_differences_of_means_the_nearest_first(digits):
    means = [digits.x_train[digits.y_train == c].mean(axis=0, dtype=float) for c in range(10)]
    gaps = [means[a] - means[b] for a, b in itertools.combinations(range(10), 2)]
    rows = sensing_matrix("class-pairs", 50, digits)
    for row, gap in zip(rows, sorted(gaps, key=np.linalg.norm), strict=False):
        assert np.linalg.norm(row) == pytest.approx(1)
        assert row @ gap == pytest.approx(np.linalg.norm(gap))
    assert np.allclose(rows[45:], sensing_matrix("pca", 5, digits))


def test_mask_count_is_rounded_and_at_least_one():
    counts = [mask_count(ratio, 1024) for ratio in (0.09, 0.04, 0.01, 1, 1e-9)]
    assert counts == [92, 41, 10, 1024, 1]


REFUSED = {"impulse": 63, "raster": 65, "hadamard": 10, "s-matrix": 64, "lda": 10, "deepfsi": -1}
REFUSED |= {"truncated-hadamard": 65, "random": 0, "pca": 65}


@pytest.mark.parametrize("design", REFUSED)
def test_a_design_refuses_a_count_that_it_cannot_have(digits, design):
    with pytest.raises(InputError, match=f"masks are not allowed for {design} on digits"):
        check_count(design, REFUSED[design], digits)

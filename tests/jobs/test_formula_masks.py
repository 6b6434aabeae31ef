"""Masks by the name of their formula."""

import numpy as np
import pytest
from scipy.linalg import hadamard

from deepfsi.base import InputError
from deepfsi.jobs import FORMULAS, formula_masks, hadamard_masks


@pytest.mark.parametrize("name", FORMULAS)
def test_formulas_are_complete_and_orthogonal(name):
    masks = np.asarray(formula_masks(name, (4, 8)), float)
    assert np.allclose(masks @ masks.T, (1 if name == "raster" else 32) * np.eye(32))


def test_orders_are_those_of_their_names():
    natural = hadamard(64)
    assert np.array_equal(formula_masks("hadamard-natural", (8, 8)), natural)
    walsh = formula_masks("hadamard-walsh", (8, 8))
    assert np.array_equal(formula_masks("hadamard-sequency", (8, 8)), walsh)
    assert (np.diff(walsh, axis=1) != 0).sum(axis=1).tolist() == list(range(64))
    assert np.array_equal(formula_masks("hadamard", (8, 8)), hadamard_masks((8, 8), 64))


@pytest.mark.parametrize(
    ("name", "shape", "said"),
    [
        ("hadamrd", (8, 8), "hadamard"),
        ("hadamard-natural", (6, 6), "powers of two"),
        ("hadamard", (6, 6), "powers of two"),
        ("raster", (256, 256), "too large"),
    ],
)
def test_a_formula_without_such_masks_is_refused(name, shape, said):
    with pytest.raises(InputError, match=said):
        formula_masks(name, shape)

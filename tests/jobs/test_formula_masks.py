"""Masks by the name of their formula."""

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi.jobs.designs import FORMULAS, formula_masks


@pytest.mark.parametrize("name", FORMULAS)
def test_formulas_are_complete_and_orthogonal(name):
    masks = np.asarray(formula_masks(name, (4, 8)), float)
    assert np.allclose(masks @ masks.T, (1 if name == "raster" else 32) * np.eye(32))


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

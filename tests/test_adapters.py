"""Operators for deepinv, SciPy and PyLops: their own tests pass, and counts are the design's."""

import numpy as np
import pylops
import pytest
import torch

from conftest import once
from deepfsi import InputError
from deepfsi.adapters import to_deepinv, to_linear_operator

KINDS = [
    {"light": "column", "rails": "dual"},
    {"light": "two-arm", "rails": "dual", "detectors": "2x2"},
    {"light": "dose", "rails": "single"},
]


pytestmark = pytest.mark.usefixtures("deepinv")


@pytest.mark.parametrize("kind", KINDS)
def test_the_tests_of_deepinv_and_pylops_pass(kind, digits):
    """Adjointness, pseudo-inverse and norm; the matrix is the same in both."""
    design = once(digits, "pca", **kind)
    operator, physics = to_linear_operator(design), to_deepinv(design)
    pylops.utils.dottest(pylops.aslinearoperator(operator), *operator.shape)
    x = torch.from_numpy(digits.x_test[:5]).unflatten(1, (1, 8, 8))
    assert abs(physics.adjointness_test(x)) < 1e-4 * physics.A(x).norm()
    y = physics.A(x)
    np.testing.assert_allclose(y.T, operator @ digits.x_test[:5].T, rtol=1e-4, atol=1e-3)
    seen = physics.A(physics.A_dagger(y))
    np.testing.assert_allclose(seen, y, atol=1e-3 * float(y.max()))
    norm = np.linalg.norm(operator @ np.eye(64), 2) ** 2
    found = physics.compute_sqnorm(x[:1], tol=1e-4 * norm, max_iter=1000, verbose=False)
    assert float(found) == pytest.approx(norm, rel=0.02)


@pytest.mark.parametrize("kind", KINDS)
def test_counts_are_those_of_the_design(kind, digits):
    """Means and variances of 4000 Poisson draws of each readout, to five deviations."""
    design, draws = once(digits, "pca", **kind), 4000
    torch.manual_seed(0)
    x = np.repeat(digits.x_test[:1], draws, axis=0)
    expected = to_linear_operator(design, 3e3) @ x[0]
    physics = to_deepinv(design, 3e3)
    for counts in (
        physics(torch.from_numpy(x).unflatten(1, (1, 8, 8))).numpy(),
        design.expose(x, 3e3).reshape(draws, -1),
    ):
        assert counts.shape == (draws, *expected.shape)
        error = np.sqrt(expected / draws)
        assert (abs(counts.mean(axis=0) - expected) <= 5 * error).all()
        # the fourth moment of Poisson counts is 3 λ² + λ
        error = np.sqrt((2 * expected**2 + expected) / draws)
        assert (abs(counts.var(axis=0) - expected) <= 5 * error).all()


def test_noise_of_ones_own_and_masks_that_are_not_known(made, digits):
    design = once(digits, "pca", **KINDS[0])
    physics = to_deepinv(design, 1e3, noise=lambda rates, generator: rates + 1)
    x = torch.rand(2, 1, 8, 8)
    torch.testing.assert_close(physics(x), physics.A(x) + 1)
    with pytest.raises(InputError, match=r"budget -1.0 is not allowed"):
        to_linear_operator(design, -1.0)
    with pytest.raises(InputError, match="adaptive"):
        to_linear_operator(made("adaptive", "free-dwell", "single"))

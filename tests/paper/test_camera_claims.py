"""Numbers and claims of the camera study."""

from dataclasses import asdict

import numpy as np
import pytest

from deepfsi_paper import bootstrap
from deepfsi_paper.camera import claims, laboratory
from shared.results import a_point, some_results

RIVALS = {"pca": "FSI", "truncated-hadamard": "TH", "raster": "RS", "hadamard": "HB"}
NAMES = {**laboratory.LABELS, **RIVALS}


def a_test(name, exposure, level):
    rates = np.random.default_rng(0).uniform(level - 0.05, level + 0.05, (3, 20, 10))
    return laboratory.DigitTest(
        design=name,
        label=NAMES[name],
        specific=name != "hadamard",
        exposure_s=exposure,
        rates=rates.tolist(),
    )


@pytest.fixture(scope="module")
def finding():
    """What is said of designs in the order of their names."""
    tests = {}
    for place, name in enumerate(NAMES):
        for step, exposure in enumerate(sorted(laboratory.EXPOSURES)):
            tests[(name, exposure)] = a_test(name, exposure, 0.85 - 0.1 * place + 0.03 * step)
    measures = laboratory.Measures(tests=[*tests.values()])
    with pytest.MonkeyPatch.context() as patch:  # of 9999 for each of 1440 intervals of a table
        patch.setattr(bootstrap, "RESAMPLES", 99)
        return claims.show(some_results([a_point(0.9, 0.01)], extra=asdict(measures)))


def test_means_are_over_trainings_and_intervals_over_draws():
    test = a_test(laboratory.OURS, 1e-2, 0.5)
    rates = np.array(test.rates)
    assert test.accuracy.mean == pytest.approx(rates.mean())
    assert len(test.by_draw) == 20
    np.testing.assert_allclose(test.by_training, rates.mean(axis=(1, 2)))
    np.testing.assert_allclose(test.by_digit, rates.mean(axis=0))
    assert test.single.shape == (60, 10)
    np.testing.assert_array_equal(test.single[20], rates[1, 0])


def test_claims_are_true_of_numbers_that_make_them_so(finding):
    assert [claim.holds for claim in finding.claims[:2]] == [True, True]

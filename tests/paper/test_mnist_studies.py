"""Claims on MLGauss, on the number of masks and of the camera."""

import itertools
from dataclasses import asdict

import numpy as np
import pytest

from deepfsi_paper import bootstrap, compression, mlgauss
from deepfsi_paper.camera import claims, laboratory
from shared.results import a_point, of_three, some_results


@pytest.mark.parametrize(("loss", "answer"), [(0.0, True), (0.05, False)])
def test_training_on_mlgauss_is_judged_where_readouts_have_many_photons(loss, answer):
    """MLGauss costs 0.3 where 20 rails share 45 photons, and `loss` where they share 4500."""
    place = {"design": "deepfsi", "masks": 10}
    points = [of_three(0.5, noise=noise, **place) for noise in ("ml_gauss", "poisson")]
    for under, photons in itertools.product(("ml_gauss", "poisson"), (1e2, 1e4)):
        lost = (under == "ml_gauss") * (0.3 if photons == 1e2 else loss)
        fields = {"recipe": "exact", "trained_under": under, "photons": photons}
        points.append(of_three(0.9 - lost, **fields, **place))
    assert mlgauss.show(some_results(points)).claims[-1].holds is answer


FALLS = {"truncated-hadamard": 0.1, "pca": 0.2, "deepfsi": 0.05}


@pytest.mark.parametrize(
    ("falls", "answers"),
    [
        ({}, [True, True, True]),
        ({"truncated-hadamard": 0.3}, [True, False, True]),
        ({"deepfsi": 0.22}, [False, True, False]),
    ],
)
def test_the_number_of_masks_matters_to_each_design_by_its_fall(falls, answers):
    """All have 0.9 with 10 masks, and fall with 92."""
    points = [
        of_three(0.9 - (masks == 92) * fall, design=design, label=design, masks=masks,
                 photons=photons, trained_at=1e5)
        for design, fall in (FALLS | falls).items()
        for masks, photons in itertools.product((10, 92), (1e4, 1e5, 1e6))
    ]  # fmt: skip
    finding = compression.show(some_results(points))
    assert [claim.holds for claim in finding.claims[:3]] == answers


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
        patch.setattr(bootstrap, "RESAMPLES", 19)
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

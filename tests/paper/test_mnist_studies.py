"""Claims on MLGauss and on the number of masks."""

import itertools

import pytest

from deepfsi_paper import compression, mlgauss
from shared.results import of_three, some_results


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

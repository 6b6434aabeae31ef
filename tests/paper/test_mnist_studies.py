"""Claims on the control group's read noise, on training, and on the number of scenes."""

import itertools
import math

import pytest

from deepfsi_paper import compression, mlgauss
from deepfsi_paper.mnist import control, images, training
from shared.results import of_three, some_results

BUDGETS = (1e2, 1e4)
MASKS = 41


def test_the_control_group_is_answered_for_each_read_noise():
    """DeepFSI has 0.9."""
    levels = {0.1: 0.8, 1.0: 0.9, 10.0: 0.95}
    points = [of_three(0.9, photons=photons, masks=MASKS) for photons in BUDGETS]
    for factor, photons in itertools.product(levels, BUDGETS):
        place = {"photons": photons, "masks": MASKS, "design": "control"}
        sigma = factor * math.sqrt(photons / 1024)
        points.append(of_three(levels[factor], variant=f"sigma {sigma:.4g}", **place))
    finding = control.show(some_results(points))
    assert [claim.holds for claim in finding.claims] == [True, None, False]
    assert ["0.1" in finding.claims[0].text, "10" in finding.claims[2].text] == [True, True]
    assert "σ = √(Φ / N)" in finding.claims[1].text


@pytest.mark.parametrize(("gain", "answer"), [(0.02, True), (0.0, None), (-0.02, False)])
def test_dropout_is_compared_with_none(gain, answer):
    """Dropout of 0.5 changes every design by so much, and epochs help."""
    place = {"recipe": "dropout", "photons": 1e4}
    points = [
        of_three(0.8 + 0.05 * k, recipe="epochs", variant=f"epochs {epochs}", photons=1e4)
        for k, epochs in enumerate((10, 40))
    ]
    for design in ("pca", "deepfsi"):
        points += [
            of_three(0.7, label=design, variant="dropout 0.0", **place),
            of_three(0.7 + gain, label=design, variant="dropout 0.5", **place),
        ]
    finding = training.show(some_results(points))
    assert [claim.holds for claim in finding.claims] == [True, answer]
    assert "0.850 after 40" in finding.found
    gains = [row[-1] for row in finding.tables[1].rows]
    assert gains.count("") == 2


def test_steps_are_chosen_on_validation_images_and_never_on_test():
    """Too many steps validate worse, and test better."""
    points = []
    for design, scenes in itertools.product(("pca", "deepfsi"), (100, 1000, 60_000)):
        for epochs, worse in ((10, 0.0), (50, 0.03)):
            own = 0.5 - worse
            place = {"recipe": str(scenes), "variant": f"epochs {epochs}", "design": design}
            points.append(of_three(own + 2 * worse, **place).model_copy(update={"validation": own}))
    [table] = images.show(some_results(points)).tables
    assert {row[4] for row in table.rows} == {"10"}
    assert {row[6] for row in table.rows} == {0.5}


def test_every_design_is_answered_under_mlgauss():
    """A design that differs in bright light fails alone."""
    points = []
    for design, noise, photons in itertools.product(
        ("raster", "pca"), ("ml_gauss", "poisson"), (1e2, 1e7)
    ):
        moved = 0.05 if (design, noise, photons) == ("raster", "poisson", 1e7) else 0.0
        place = {"design": design, "noise": noise, "photons": photons, "masks": 1024}
        points.append(of_three(0.5 + moved, label=design, **place))
    finding = mlgauss.show(some_results(points))
    assert [claim.holds for claim in finding.claims] == [False, True]
    assert [row[0] for row in finding.tables[0].rows] == ["raster", "pca"]
    assert finding.tables[0].rows[0][-2:] == (1, 1)


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

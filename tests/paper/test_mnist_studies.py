"""Claims on the control group's read noise, on training, and on the number of scenes."""

import itertools
import math

import pytest

from deepfsi_paper import mlgauss
from deepfsi_paper.mnist import control, images, training
from shared.results import a_point, some_results

FACTORS = (0.1, 1.0, 10.0)
BUDGETS = (1e2, 1e4)
MASKS = 41


def point(accuracy, **fields):
    """A point of three trainings that differ by 0.001."""
    shifted = (accuracy - 0.001, accuracy, accuracy + 0.001)
    return a_point(accuracy, 0.002, accuracies=shifted, **fields)


def control_finding(level):
    """Finding on control groups of accuracy `level(factor, photons)` where DeepFSI has 0.9."""
    points = [point(0.9, photons=photons, masks=MASKS) for photons in BUDGETS]
    for factor, photons in itertools.product(FACTORS, BUDGETS):
        place = {"photons": photons, "masks": MASKS, "design": "control"}
        sigma = factor * math.sqrt(photons / 1024)
        points.append(point(level(factor, photons), variant=f"sigma {sigma:.4g}", **place))
    return control.show(some_results(points))


def test_the_control_group_is_answered_for_each_read_noise():
    finding = control_finding(lambda factor, photons: {0.1: 0.8, 1.0: 0.9, 10.0: 0.95}[factor])
    assert [claim.holds for claim in finding.claims] == [True, None, False]
    assert ["0.1" in finding.claims[0].text, "10" in finding.claims[2].text] == [True, True]
    assert "σ = √(Φ / N)" in finding.claims[1].text


def training_finding(gain):
    """Finding where dropout of 0.5 changes every design by so much, and epochs help."""
    place = {"recipe": "dropout", "photons": 1e4}
    points = [
        point(0.8 + 0.05 * k, recipe="epochs", variant=f"epochs {epochs}", photons=1e4)
        for k, epochs in enumerate((10, 40))
    ]
    for design in ("pca", "deepfsi"):
        points += [
            point(0.7, label=design, variant="dropout 0.0", **place),
            point(0.7 + gain, label=design, variant="dropout 0.5", **place),
        ]
    return training.show(some_results(points))


@pytest.mark.parametrize(("gain", "answer"), [(0.02, True), (0.0, None), (-0.02, False)])
def test_dropout_is_compared_with_none(gain, answer):
    finding = training_finding(gain)
    assert [claim.holds for claim in finding.claims] == [True, answer]
    assert "0.850 after 40" in finding.found
    gains = [row[-1] for row in finding.tables[1].rows]
    assert gains.count("") == 2


def images_finding(accuracy):
    """Finding where accuracy is that of (design, scenes); too many steps validate worse."""
    points = []
    for design, scenes in itertools.product(("pca", "deepfsi"), (100, 1000, 60_000)):
        for epochs, worse in ((10, 0.0), (50, 0.03)):
            own = accuracy(design, scenes) - worse
            place = {"recipe": str(scenes), "variant": f"epochs {epochs}", "design": design}
            points.append(point(own + 2 * worse, **place).model_copy(update={"validation": own}))
    return images.show(some_results(points))


def test_steps_are_chosen_on_validation_images_and_never_on_test():
    finding = images_finding(lambda design, scenes: 0.5)
    [table] = finding.tables
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
        points.append(point(0.5 + moved, label=design, **place))
    finding = mlgauss.show(some_results(points))
    assert [claim.holds for claim in finding.claims] == [False, True]
    assert [row[0] for row in finding.tables[0].rows] == ["raster", "pca"]
    assert finding.tables[0].rows[0][-2:] == (1, 1)

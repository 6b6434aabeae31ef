"""The study of adaptive masks answers to the numbers."""

from dataclasses import asdict

import numpy as np
import pytest

import deepfsi
from deepfsi.base.progress import SILENT
from deepfsi_paper.adaptive import claims as study
from deepfsi_paper.adaptive import clock
from shared.results import of_three, some_results

LIGHTS = (1e2, 1e3, 1e4, 1e5)
KNOWN = {1e2: 0.2, 1e3: 0.5, 1e4: 0.85, 1e5: 0.97}
ADAPTIVE = {1e2: 0.24, 1e3: 0.63, 1e4: 0.965, 1e5: 0.96}
MORE = {1e2: 0.1, 1e3: 0.12, 1e4: 0.02, 1e5: 0.005}
"""What 2 × 2 detectors add."""

DECISION_S, LOAD_S = 5e-3, 3e-3


def point(recipe, photons, accuracy, **fields):
    accuracy = min(accuracy, 0.998)
    optics = {"light": "free-dwell", "rails": "single", "log_loss": (1 - accuracy) * 2.0}
    return of_three(accuracy, recipe=recipe, photons=photons, **{**optics, **fields})


def results(less=0.1, scenes=0.2, **changed):
    """Results; `NAME_PHOTONS` is another accuracy of a kind at a budget with one detector.

    One look reads `less` than 16, and the largest prior `scenes` less than the second.
    """
    points = []
    for photons in LIGHTS:
        levels = {"adaptive": ADAPTIVE, "fixed": KNOWN}
        at = {kind: changed.get(f"{kind}_{photons:g}", levels[kind][photons]) for kind in levels}
        adaptive = {"design": "adaptive", "detectors": "1x1", "masks": 1}
        points.append(point("scenes-1x1", photons, at["adaptive"] - scenes, **adaptive))
        for name, more in (("1x1", 0.0), ("2x2", MORE[photons])):
            adaptive["detectors"] = name
            for looks, off in ((1, less), (16, 0.0)):
                adaptive["masks"] = looks
                accuracy = at["adaptive"] + more - off
                points.append(point(f"adaptive-{name}", photons, accuracy, **adaptive))
            fixed = {"detectors": name, "masks": 24}
            points.append(point(f"fixed-{name}", photons, at["fixed"] + more, **fixed))
        impulse = {"design": "impulse", "light": "column", "masks": 1024, "ratio": 1.0}
        points.append(point("impulse", photons, 0.99, **impulse))
    sizes = {"adaptive-1x1": 3000, "scenes-1x1": 60000, "adaptive-2x2": 3000}
    priors = [clock.Prior(recipe, "", size, DECISION_S) for recipe, size in sizes.items()]
    return some_results(points, extra=asdict(clock.Measures(np.log2(10), LOAD_S, priors)))


def answers(**changed):
    return {claim.text: claim.holds for claim in study.EXPERIMENT.show(results(**changed)).claims}


@pytest.mark.parametrize(
    ("words", "changes", "usual", "changed"),
    [
        ("at least 0.61 at 1000", {"adaptive_1000": 0.6}, True, False),
        ("at least 0.96 at 10⁴", {"adaptive_10000": 0.961}, True, None),
        ("at least 0.98 at 10⁵", {"adaptive_100000": 0.99}, False, True),
        ("2 × 2 detectors read at least 0.72", {"adaptive_1000": 0.59}, True, False),
        ("With one detector adaptive masks read more than learned masks at", {"fixed_1000": 0.7},
         True, False),
        ("learned masks read more than adaptive", {"adaptive_100000": 0.98}, True, False),
        ("16 looks read more than 1,", {"less": -0.02}, True, False),
        ("largest prior reads more than the second", {"scenes": -0.02}, False, True),
        ("exposures of 0.1 s", {"less": 0.2}, True, False),
        ("exposures of 1 s", {"less": 0.2}, True, True),
    ],
)  # fmt: skip
def test_claims_answer_to_the_numbers(words, changes, usual, changed):
    for given, answer in (({}, usual), (changes, changed)):
        [holds] = {holds for text, holds in answers(**given).items() if words in text}
        assert holds is answer


def test_information_is_entropy_less_cross_entropy():
    measures = clock.Measures(np.log2(10), LOAD_S, [])
    sure = point("adaptive-1x1", 1e4, 1.0, log_loss=0.0)
    blind = point("adaptive-1x1", 1e4, 0.1, log_loss=float(np.log(10)))
    worse = point("adaptive-1x1", 1e4, 0.1, log_loss=5.0)
    assert [study.bits(each, measures) for each in (sure, blind, worse)] == pytest.approx(
        [np.log2(10), 0.0, 0.0], abs=1e-9
    )


def test_by_the_clock_light_is_lost_while_masks_are_made():
    points = [point("adaptive-1x1", each, ADAPTIVE[each], masks=10) for each in LIGHTS]
    free, timed = clock.Rival(points), clock.Rival(points, 0.02)
    assert free.at(1e4, 1.0)[1] == ADAPTIVE[1e4]
    assert timed.at(1.25e4, 1.0)[1] == pytest.approx(ADAPTIVE[1e4])  # 0.2 of 1 s is lost
    assert timed.at(1e4, 0.39) is None  # more than half of it
    assert free.at(1e3 * np.sqrt(10), 1.0)[1] == pytest.approx((ADAPTIVE[1e3] + ADAPTIVE[1e4]) / 2)


def test_the_number_of_looks_is_chosen_on_validation_images():
    points = [
        point("adaptive-1x1", each, accuracy, masks=looks, validation=validation)
        for looks, accuracy, validation in ((4, 0.9, 0.8), (16, 0.7, 0.85))
        for each in LIGHTS
    ]
    assert clock.best_at(clock.rivals(points), 1e3, 1.0) == pytest.approx(0.7)
    measures = clock.Measures(3.3, LOAD_S, [clock.Prior("adaptive-1x1", "", 3000, 0.03)])
    assert clock.best_at(clock.rivals(points, measures), 1e3, 1.0) == pytest.approx(0.9)


def test_priors_and_entropy_are_measured(tmp_path, digits):
    settings = {"design": "adaptive", "masks": 2, "photons": 1e3, "camera": "dmd"}
    design = deepfsi.learn(digits, **settings, training={"clusters": 5})
    design.save(tmp_path / "key.safetensors")
    made = some_results([point("adaptive-1x1", 1e3, 0.9, design="adaptive", masks=2)])
    found = clock.measure(made, digits, tmp_path, 1, SILENT)
    [prior] = found["priors"]
    assert prior["scenes"] == 50
    assert prior["decision_s"] > 0
    assert found["entropy"] == pytest.approx(np.log2(10), abs=0.01)
    assert found["load_s"] == 3.3e-3
    assert clock.decision_time(design, 1e3, exposures=1) > 0
